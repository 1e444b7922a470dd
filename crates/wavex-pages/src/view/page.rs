//! Files of the page, which are part of the program.

/// Kind and content of a file of the page; the empty name is the page itself.
pub(super) fn file(name: &str) -> Option<(&'static str, &'static [u8])> {
    let name = if name.is_empty() { "index.html" } else { name };
    let (name, body) = FILES.iter().find(|(known, _)| *known == name)?;
    let kind = match name.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        _ => "text/plain; charset=utf-8",
    };
    Some((kind, body))
}

macro_rules! files {
    ($($name:literal),* $(,)?) => {
        [$(($name, include_bytes!(concat!("page/", $name)).as_slice())),*]
    };
}

/// All files.
const FILES: [(&str, &[u8]); 37] = files![
    "api.js",
    "axes.js",
    "camera.js",
    "clip.js",
    "clip_region.js",
    "cloud.js",
    "colours.js",
    "dock.js",
    "draw_software.js",
    "draw_webgl.js",
    "elements.js",
    "find.js",
    "find_columns.js",
    "format.js",
    "index.html",
    "interaction.js",
    "keyboard.js",
    "layers.js",
    "legend.js",
    "main.js",
    "map_legend.js",
    "marks.js",
    "measure.js",
    "overlay.js",
    "picture.js",
    "point.js",
    "profile.js",
    "shade_software.js",
    "shade_webgl.js",
    "shot.js",
    "stage.js",
    "state.js",
    "style.css",
    "symbols.js",
    "tools.js",
    "waterfall.js",
    "what_if.js",
];

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn all_files_of_the_folder_are_served() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/view/page");
        let mut names: Vec<String> = folder
            .read_dir()
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .filter(|name| name != "README.md")
            .collect();
        names.sort();
        assert_eq!(names, FILES.map(|(name, _)| name));
        assert!(FILES.iter().map(|(_, body)| body.len()).sum::<usize>() < 1_000_000);
        assert_eq!(file("").unwrap().0, "text/html; charset=utf-8");
        assert_eq!(file("../Cargo.toml"), None);
    }

    #[test]
    fn modules_import_only_each_other() {
        for (name, body) in FILES.iter().filter(|(name, _)| name.ends_with(".js")) {
            let text = std::str::from_utf8(body).unwrap();
            for imported in text.split(" from \"").skip(1) {
                let path = imported.split('"').next().unwrap();
                let file = path.strip_prefix("./").unwrap_or_else(|| panic!("{name}: {path}"));
                assert!(FILES.iter().any(|(known, _)| *known == file), "{name} imports {path}");
            }
        }
    }
}
