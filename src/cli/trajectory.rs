//! `wavex trajectory`: projects, decimates and corrects a trajectory.

use std::io::Write;
use std::path::Path;

use super::{Failure, TrajectoryArgs, terminal};
use map::TrajectoryMap;
use summary::About;
use wavex_formats::trajectory::{self, Angles, FileTime, Options, Unproject};
use wavex_formats::{Error, RecordingFormat};
use wavex_geodesy::time_axis::TimeSpan;
use wavex_geodesy::trajectory::plausibility::{MotionLimits, contradiction};
use wavex_geodesy::trajectory::{Accuracy, Trajectory};
use wavex_line::georef::applied_corrections::CORRECTED_BY;
use wavex_line::georef::corrections::CorrectionsFile;
use wavex_line::georef::trajectory_file::{remedy, without_outliers};
use wavex_line::stage::{FinishedFile, OutputFile};

mod map;
mod picture;
mod summary;

/// Size at which buffered rows are written, bytes.
const CHUNK: usize = 1 << 16;

/// Reads the trajectory, writes the requested files, and prints the summary.
pub(super) fn trajectory(args: &TrajectoryArgs, quiet: bool) -> Result<(), Failure> {
    let failed = |error: Error| Failure::Run(error.to_string());
    if RecordingFormat::of(&args.file).is_some() {
        let name = args.file.display();
        let problem =
            format!("{name}: it is a recording, not a trajectory; `wavex scan {name}` describes it");
        return Err(Failure::Wrong(problem));
    }
    let options = args.options();
    let recorded = trajectory::read(&args.file, &options).map_err(failed)?;
    let map = TrajectoryMap::of(&args.crs, None).map_err(Failure::Wrong)?;
    let (format, counts, clock) = (recorded.format.clone(), recorded.counts.clone(), recorded.clock);
    let times = recorded.times();
    let accuracies: Vec<Accuracy> = recorded.accuracies.iter().map(|sample| sample.accuracy).collect();
    let (mut notes, is_text, speeds_mps) =
        (recorded.notes.clone(), recorded.is_text(), recorded.speeds_mps.clone());
    let trajectory = {
        let unproject = map.as_ref().and_then(TrajectoryMap::unproject);
        let unproject = unproject.as_ref().map(|unproject| unproject as &Unproject);
        recorded.into_trajectory(unproject).map_err(failed)?
    };
    let limits = &MotionLimits::AIRPLANE;
    if let Some(found) = contradiction(trajectory.samples(), &speeds_mps, limits) {
        notes.push(format!("{}; {}", found.problem, remedy(&found, is_text, options.angles)));
    }
    let (trajectory, note) = without_outliers(&args.file, trajectory, Some(limits)).map_err(failed)?;
    notes.extend(note);
    let trajectory = match &args.corrections {
        Some(file) => corrected(&trajectory, file, args.strip.as_deref(), times).map_err(failed)?,
        None => trajectory,
    };
    let corrections = args.corrections.as_ref().map(|file| file.display().to_string());
    let map = match map {
        Some(map) => map,
        // `utm` is the zone of the first position.
        None => {
            let first = trajectory.samples().first().map(|sample| sample.place);
            let map = TrajectoryMap::of(&args.crs, first).map_err(Failure::Wrong)?;
            map.map_or_else(TrajectoryMap::geodetic, Ok).map_err(Failure::Run)?
        }
    };
    map.covers(trajectory.samples()).map_err(Failure::Run)?;
    let map = &map;
    let file = args.file.display().to_string();
    let about = About {
        file,
        format: &format,
        counts: &counts,
        clock,
        accuracies: &accuracies,
        notes: &notes,
        corrections,
    };
    let written = write(args, &about, &trajectory, map).map_err(failed)?;
    if !quiet {
        let mut text = summary::text(&about, &trajectory, map);
        if !written.is_empty() {
            text += &format!("\nwrote {}\n", written.join(", "));
        }
        terminal::print(&text)?;
    }
    Ok(())
}

impl TrajectoryArgs {
    fn options(&self) -> Options {
        Options {
            time: self.time.map(FileTime::from),
            angles: self.angles.map(Angles::from),
            columns: self.columns.clone(),
            accuracy: self.accuracy.clone(),
        }
    }
}

/// The trajectory with the corrections of a strip, or of all strips in their time.
fn corrected(
    trajectory: &Trajectory,
    file: &Path,
    strip: Option<&str>,
    times: TimeSpan,
) -> Result<Trajectory, Error> {
    let corrections = CorrectionsFile::read(file)?
        .on_trajectory(strip, times)
        .map_err(|(problem, remedy)| Error::unusable(file, problem, remedy))?;
    let samples = trajectory.samples().iter();
    let samples = samples.map(|sample| corrections.at(sample.time_s).applied_to_sample(sample)).collect();
    Trajectory::new(samples).map_err(|problem| Error::unusable(file, problem.to_string(), problem.remedy()))
}

/// Writes table and picture; they get their final names when both are complete.
fn write(
    args: &TrajectoryArgs,
    about: &About,
    trajectory: &Trajectory,
    map: &TrajectoryMap,
) -> Result<Vec<String>, Error> {
    let mut whole: Vec<FinishedFile> = Vec::new();
    if let Some(path) = &args.out {
        whole.push(table(path, args.every, about, trajectory, map)?);
    }
    if let Some(path) = &args.svg {
        let name = args.file.file_name().unwrap_or_default().to_string_lossy();
        let note = format!("{}, {} records, {}", about.format, trajectory.samples().len(), map.name());
        let mut file = OutputFile::create(path)?;
        let picture = picture::draw(&name, &note, trajectory, map);
        file.write_all(picture.as_bytes()).map_err(Error::io(path, "write"))?;
        whole.push(file.finish()?);
    }
    whole.into_iter().map(|file| file.publish().map(|path| path.display().to_string())).collect()
}

/// Writes every n-th record as a row.
///
/// Columns: time, longitude, latitude, height, x, y, z, roll, pitch, heading.
fn table(
    path: &Path,
    every: usize,
    about: &About,
    trajectory: &Trajectory,
    map: &TrajectoryMap,
) -> Result<FinishedFile, Error> {
    let mut file = OutputFile::create(path)?;
    let mut rows = format!(
        "# t lon lat h x y z w p k: {}; degrees; m; {}; roll, pitch and heading in degrees{}\n",
        about.clock.name(),
        map.name(),
        about.corrections.as_ref().map_or(String::new(), |file| format!("{CORRECTED_BY}{file}"))
    )
    .into_bytes();
    let mut samples = trajectory.samples().iter().step_by(every.max(1)).peekable();
    while let Some(sample) = samples.next() {
        let (place, attitude, digits) = (sample.place, sample.attitude, map.digits());
        let [x, y, z] = map.project(place);
        let [longitude, latitude] = [place.longitude_rad, place.latitude_rad].map(f64::to_degrees);
        let angles = [attitude.roll_rad, attitude.pitch_rad, attitude.heading_rad].map(f64::to_degrees);
        let [roll, pitch, heading] = angles;
        // Writing to a vector cannot fail.
        let _ = writeln!(
            rows,
            "{:.6} {longitude:.10} {latitude:.10} {:.5} {x:.digits$} {y:.digits$} {z:.5} {roll:.7} {pitch:.7} {heading:.7}",
            sample.time_s, place.height_m
        );
        if rows.len() >= CHUNK || samples.peek().is_none() {
            file.write_all(&rows).map_err(Error::io(path, "write"))?;
            rows.clear();
        }
    }
    file.finish()
}
