//! Outputs of a classic line: sinks of the job, and additional commands.

use super::draft::toml_text;
use super::line::Value;
use super::options::Part;
use super::problem::Problem;
use super::translate::Translation;
use wavex_formats::extensions::{LAS, LAZ};

/// Extensions of point outputs, for `-o` and `-olas`.
const EXTENSIONS: [&str; 3] = [LAS, LAZ, "txt"];

impl Translation<'_> {
    /// Sets the keys of the requested sinks and returns their names.
    pub(super) fn sinks(&mut self) -> Vec<&'static str> {
        let mut sinks = Vec::new();
        let (file, why) = self.output();
        let base = file.rsplit_once('.').map_or(file.clone(), |(base, _)| base.to_owned());
        let is_text = file.ends_with(".txt");
        if self.on(Part::NoPoints) {
            self.note(self.written(Part::NoPoints), "the job writes no points");
        } else {
            let sink = if is_text { "write_ascii" } else { "write_las" };
            self.draft.set(sink, "path", toml_text(&file), &why, false);
            sinks.push(sink);
        }
        self.columns();
        self.index(&file);
        if self.writes_trajectory() {
            let why = self.why_text(Part::Trajectory);
            let is_asked = self.on(Part::Trajectory) || self.on(Part::AllTexts);
            self.draft.set(
                "write_trajectory",
                "path",
                toml_text(&format!("{base}_traj.txt")),
                &why,
                is_asked,
            );
            sinks.push("write_trajectory");
        }
        if self.on(Part::LineStats) || self.on(Part::AllTexts) {
            let why = self.why_text(Part::LineStats);
            let path = toml_text(&format!("{base}{}", self.version.line_stats));
            self.draft.set("write_lstat", "path", path, &why, true);
            sinks.push("write_lstat");
        }
        if self.version.has_stat_log {
            // Each input has its own statistics file, whatever the name of the output.
            let base = if base.contains('*') || self.has_one_input() { base.as_str() } else { "*" };
            let path = toml_text(&format!("{base}_stat.log"));
            let why = format!("always written by {}", self.version.name);
            self.draft.set("job", "stat_log", path, &why, false);
        }
        sinks
    }

    /// Name of the point file and source of the name.
    fn output(&mut self) -> (String, String) {
        let on = |part: &Part| self.on(*part);
        let asked: Vec<Part> = EXTENSIONS.map(Part::Extension).into_iter().filter(on).collect();
        if let [first, second, ..] = asked.as_slice() {
            let what =
                format!("`{}` and `{}` exclude each other", self.written(*first), self.written(*second));
            self.problems.extend(self.part(*second).map(|given| Problem::at(&given.place, what)));
        }
        let asked = asked.first().map(|part| (*part, self.written(*part)));
        let default = (self.version.output.to_owned(), format!("default of {}", self.version.name));
        let named = self.text(Part::Output).map(str::to_owned).map(|name| (name, self.written(Part::Output)));
        let is_default = named.is_none();
        let (name, why) = named.unwrap_or(default);
        let file = name.rsplit(['/', '\\']).next().unwrap_or_default();
        let (stem, extension) = match file.rsplit_once('.') {
            Some((_, extension)) => (&name[..name.len() - extension.len() - 1], extension.to_lowercase()),
            None => (name.as_str(), String::new()),
        };
        match asked {
            Some((Part::Extension(asked), of))
                if is_default || extension.is_empty() || extension == asked =>
            {
                let why = if is_default { of } else { format!("{why} {of}") };
                (format!("{stem}.{asked}"), why)
            }
            Some((_, of)) => {
                self.wrong_output(format!("`{why}` and `{of}` exclude each other"));
                (name, why)
            }
            None if extension.is_empty() => (format!("{stem}.laz"), why),
            None if self.extensions().contains(&extension.as_str()) => (format!("{stem}.{extension}"), why),
            None => {
                let known: Vec<String> = self.extensions().iter().map(|known| format!(".{known}")).collect();
                self.wrong_output(format!("an output must end in {}, got `{name}`", known.join(" or ")));
                (name, why)
            }
        }
    }

    /// Extensions of points that the version writes.
    fn extensions(&self) -> &'static [&'static str] {
        let writes_text = self
            .version
            .options
            .iter()
            .any(|option| option.becomes == super::options::Becomes::Part(Part::Columns));
        if writes_text { &EXTENSIONS } else { &[LAS, LAZ] }
    }

    fn wrong_output(&mut self, what: String) {
        self.problems.extend(self.part(Part::Output).map(|given| Problem::at(&given.place, what)));
    }

    fn columns(&mut self) {
        if let Some(letters) = self.text(Part::Columns).map(toml_text) {
            self.draft.set("write_ascii", "columns", letters, &self.written(Part::Columns), true);
        }
    }

    /// Sets the index of the points in `file`; only LAZ can contain one.
    fn index(&mut self, file: &str) {
        let (beside, within) = (self.on(Part::Index), self.on(Part::IndexWithin));
        let why: Vec<String> = [(beside, Part::Index), (within, Part::IndexWithin)]
            .into_iter()
            .filter(|(is_on, _)| *is_on)
            .map(|(_, part)| self.written(part))
            .collect();
        let fits = file.ends_with(".laz");
        let place = if within && fits { "\"appended\"" } else { "\"file\"" };
        if beside || within {
            self.draft.set("write_las", "index", place.to_owned(), &why.join(" "), true);
        }
        if within && !fits {
            self.draft.remark("write_las", "index", "separate file, because only LAZ can contain an index");
        }
    }

    /// Returns whether the line names exactly one file without a pattern.
    fn has_one_input(&self) -> bool {
        matches!(self.inputs().as_slice(), [file] if !file.contains(['*', '?', '[']))
    }

    /// Returns whether the job writes the trajectory; notes why not.
    fn writes_trajectory(&mut self) -> bool {
        let has_file = self.of_key("geometry", "trajectory").is_some();
        let asked = self.part(Part::Trajectory).map(|given| given.value.clone());
        match asked {
            Some(Value::Switch(false)) => {
                self.note(self.written(Part::Trajectory), "the job does not write the trajectory");
                false
            }
            Some(_) if self.reader == "read_sdf" && !has_file => {
                self.note(self.written(Part::Trajectory), "no effect: `-po` is not given");
                false
            }
            Some(_) => true,
            None => has_file && (self.version.writes_trajectory || self.on(Part::AllTexts)),
        }
    }

    /// Source of a text output: its own option, the option for all, or the version.
    fn why_text(&self, part: Part) -> String {
        if self.on(part) {
            self.written(part)
        } else if self.on(Part::AllTexts) {
            self.written(Part::AllTexts)
        } else {
            format!("default of {}", self.version.name)
        }
    }

    /// Adds the command for recording statistics.
    pub(super) fn scans(&mut self) {
        if self.on(Part::Scan) || self.on(Part::AllTexts) {
            self.scan(false);
        } else if self.part(Part::ScanName).is_some() {
            self.note(self.written(Part::ScanName), "no effect: `-osdfstat` is not given");
        }
    }

    fn scan(&mut self, is_fast: bool) {
        let name = self.text(Part::ScanName).unwrap_or("out").to_owned();
        let mut words = vec!["scan".to_owned()];
        words.extend(self.inputs().iter().map(|file| self.paths.here(file)));
        words.extend(["--name".to_owned(), self.paths.output(&name)]);
        words.extend(is_fast.then(|| "--fast".to_owned()));
        self.command(words);
    }

    /// Adds the command that projects and decimates the trajectory.
    pub(super) fn plots(&mut self) {
        let Some(out) = self.text(Part::PlotTrajectory).map(str::to_owned) else {
            if self.part(Part::PlotEvery).is_some() {
                self.note(self.written(Part::PlotEvery), "no effect: `-plot_po` is not given");
            }
            return;
        };
        let Some(Value::Text(file)) = self.of_key("geometry", "trajectory").map(|given| given.value.clone())
        else {
            let place = self.part(Part::PlotTrajectory).map(|given| given.place.clone());
            let what = "`-plot_po` requires a trajectory".to_owned();
            self.problems.extend(place.map(|place| Problem::at(&place, what).help("give one with `-po`")));
            return;
        };
        let file = self.paths.here(&self.paths.input(&file));
        let mut words = vec!["trajectory".to_owned(), file];
        for (key, option) in [
            ("crs", "--crs"),
            ("trajectory_columns", "--columns"),
            ("trajectory_time", "--time"),
            ("trajectory_angles", "--angles"),
        ] {
            let text =
                self.draft.asked("geometry", key).map(|(toml, _)| toml.trim_matches(['"', '\'']).to_owned());
            words.extend(text.into_iter().flat_map(|text| [option.to_owned(), text]));
        }
        if let Some(Value::Whole(every)) = self.part(Part::PlotEvery).map(|given| given.value.clone()) {
            words.extend(["--every".to_owned(), every.to_string()]);
        }
        words.extend(["-o".to_owned(), self.paths.output(&out)]);
        self.command(words);
    }

    fn command(&mut self, mut words: Vec<String>) {
        words.insert(0, "wavex".to_owned());
        self.result.commands.push(words);
    }

    /// Translates a line without points into commands.
    pub(super) fn without_job(&mut self) {
        let is_fast = self.on(Part::OnlyScanFast);
        let is_scan = is_fast || self.on(Part::OnlyScan);
        let has_plot = self.part(Part::PlotTrajectory).is_some();
        if self.inputs().is_empty() && (is_scan || self.has_nothing_else_to_do(has_plot)) {
            let help = "add one with `-i`, such as `-i data.sdf`";
            self.problems.push(Problem::of_line("the line has no input", help));
            return;
        }
        if is_scan {
            self.scan(is_fast);
        }
        if has_plot {
            // The keys select the coordinates of the table.
            self.keys();
            self.plots();
        }
        self.not_needed(is_scan, has_plot);
    }

    fn has_nothing_else_to_do(&self, has_plot: bool) -> bool {
        !has_plot && self.result.commands.is_empty() && self.result.notes.is_empty()
    }

    /// Notes options that only a job would use.
    fn not_needed(&mut self, is_scan: bool, has_plot: bool) {
        use super::options::Becomes;
        let is_used = |becomes: Becomes| match becomes {
            Becomes::Key("geometry", key, _) => has_plot && (key.starts_with("trajectory") || key == "crs"),
            Becomes::Key(..) | Becomes::End(..) => false,
            Becomes::Part(Part::Input | Part::ScanName) => is_scan,
            Becomes::Part(Part::OnlyScan | Part::OnlyScanFast | Part::InputDir | Part::OutputDir) => true,
            Becomes::Part(Part::PlotTrajectory | Part::PlotEvery) => has_plot,
            Becomes::Part(_) => false,
            Becomes::Flag(..) | Becomes::Command(_) | Becomes::Nothing(_) => true,
        };
        let unused: Vec<String> = self
            .given
            .iter()
            .filter(|given| !is_used(given.option.becomes))
            .map(|given| given.written.clone())
            .collect();
        for written in unused {
            self.note(written, "no effect: this command line writes no points");
        }
    }
}
