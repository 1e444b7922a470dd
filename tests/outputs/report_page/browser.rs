//! Shows a page in headless Chromium: console messages, loaded resources, readability.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::Value;

/// Appearance settings.
#[derive(Clone, Copy, Debug)]
pub enum Look {
    Light,
    Dark,
}

/// Finds the browser; prints a notice if there is none.
pub fn find() -> Option<PathBuf> {
    let named = std::env::var_os("WAVEX_CHROMIUM").map(PathBuf::from);
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders: Vec<PathBuf> = std::env::split_paths(&path).collect();
    let installed = names.iter().flat_map(|name| folders.iter().map(move |folder| folder.join(name)));
    let found = named.or_else(|| installed.into_iter().find(|path| path.is_file()));
    if found.is_none() {
        println!("skipped: no Chromium on the PATH or in WAVEX_CHROMIUM");
    }
    found
}

/// Loads a page; returns its final elements and console messages.
pub fn show(browser: &Path, page: &Path, look: Look) -> (String, Vec<String>) {
    let profile = tempfile::tempdir().unwrap();
    let scheme = match look {
        Look::Dark => 0,
        Look::Light => 1,
    };
    let mut command = Command::new(browser);
    command
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--hide-scrollbars"])
        .args(["--disable-background-networking", "--disable-component-update", "--disable-sync"])
        .args(["--disable-extensions", "--disable-dev-shm-usage", "--window-size=1280,1600"])
        // Blocks all network requests of the page.
        .arg("--host-resolver-rules=MAP * ~NOTFOUND")
        .args(["--virtual-time-budget=4000", "--enable-logging=stderr", "--log-level=0"])
        .arg(format!("--blink-settings=preferredColorScheme={scheme}"))
        .arg(format!("--user-data-dir={}", profile.path().display()))
        .arg("--dump-dom")
        .arg(page)
        .stdin(Stdio::null());
    let output = command.output().unwrap();
    let log = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{log}");
    let said = log.lines().filter(|line| line.contains(":CONSOLE")).map(str::to_owned).collect();
    (String::from_utf8(output.stdout).unwrap(), said)
}

/// Measurements of a page by `measure.js`, which is inserted into it.
pub fn measured(browser: &Path, page: &str, look: Look) -> Value {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("measured.html");
    let from = page.find("<meta http-equiv=").unwrap();
    let until = from + page[from..].find('>').unwrap() + 1;
    let script = include_str!("measure.js");
    let page = format!("{}{}", &page[..from], &page[until..])
        .replace("</body>", &format!("<script>\n{script}</script>\n</body>"));
    std::fs::write(&path, page).unwrap();
    let (dom, said) = show(browser, &path, look);
    assert_eq!(said, [] as [&str; 0], "the script fails");
    let (_, rest) = dom.split_once("<script type=\"application/json\">").expect("nothing was measured");
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}
