//! Applies poses to the shots of a source.

use std::sync::Arc;

use crate::georef::scan_angles::{ScanAngles, are_unknown, set_directions};
use crate::georef::transform::{scan_angle_deg, to_earth};
use crate::georef::{self, Geometry};
use crate::plausibility::Check;
use crate::scan_line::{
    Content, Emission, FirstShot, Frame, InputInfo, RecordedShots, ScanLine, emission_flags,
};
use crate::stage::{Context, Reason, Result, Source, StageError};
use wavex_geodesy::time::day_of_year;
use wavex_geodesy::time_axis::{Alignment, Clock, Misaligned, TimeSpan, Unwrap, utc_hint};
use wavex_geodesy::trajectory::Pose;
use wavex_geodesy::vertical::down_at;

/// A source whose shots are converted to the earth-centred frame, given a trajectory.
///
/// Only shots in the scanner or body frame are converted. Georeferenced shots get scan angles and
/// directions.
pub struct PoseSource {
    source: Box<dyn Source>,
    geometry: Arc<Geometry>,
    times: Option<Unwrap>,
    alignment: Option<Alignment>,
    first_shot: Option<FirstShot>,
    coverage: Coverage,
    /// Metadata from the source, and as emitted.
    input: Option<[Arc<InputInfo>; 2]>,
    angles: ScanAngles,
    has_ended: bool,
    /// Whether lines keep their shots as recorded.
    keeps_recorded: bool,
}

impl PoseSource {
    /// Wraps a source with a georeferencing context.
    pub fn new(source: Box<dyn Source>, geometry: Arc<Geometry>) -> PoseSource {
        PoseSource {
            source,
            geometry,
            times: None,
            alignment: None,
            first_shot: None,
            coverage: Coverage::default(),
            input: None,
            angles: ScanAngles::default(),
            has_ended: false,
            keeps_recorded: false,
        }
    }

    /// Keeps the shots of each line as recorded, see [`ScanLine::recorded`].
    pub fn keeping_recorded(self, keeps_recorded: bool) -> PoseSource {
        PoseSource { keeps_recorded, ..self }
    }
}

const OTHER_ANGLES: &str = "the scan angles in the file contradict its beams";

/// The checks of beams and scan angles.
pub fn checks() -> Vec<Check> {
    vec![Check::warning(
        "scan angles and beams, median of a line",
        format!("at most {} degrees more than the angle from nadir", georef::scan_angles::MOST_EXCESS_DEG),
        "the angle across the flight is a part of that from nadir; some files lack the roll",
        OTHER_ANGLES,
    )]
}

impl Source for PoseSource {
    fn next(&mut self, cx: &mut Context) -> Result<Option<ScanLine>> {
        loop {
            if let Some(line) = self.angles.pop() {
                return Ok(Some(line));
            }
            if self.has_ended {
                return self.finish(cx).map(|()| None);
            }
            match self.source.next(cx)? {
                Some(line) => {
                    let line = self.place(line, cx)?;
                    self.angles.push(line);
                }
                None => {
                    self.has_ended = true;
                    self.angles.finish();
                }
            }
        }
    }

    fn progress(&self) -> Option<f64> {
        self.source.progress()
    }
}

impl PoseSource {
    fn finish(&self, cx: &mut Context) -> Result<()> {
        if let Some([recorded_deg, beam_deg]) = self.angles.contradiction() {
            cx.warn(format!(
                "{OTHER_ANGLES} (medians {recorded_deg:.1} and {beam_deg:.1} degrees from nadir): they are computed from \
                 the beams"
            ));
        }
        if self.angles.gave_up() {
            cx.warn(
                "scan angles are unknown, and are 0 in outputs: the recording has none, and its beams do not define the \
                 direction of flight",
            );
        }
        self.coverage.finish(self.alignment.as_ref(), cx)?;
        if let (Some(span_s), Some([input, _])) = (self.coverage.span_s, &self.input) {
            self.geometry.judge_corrections(input, span_s)?.into_iter().for_each(|warning| cx.warn(warning));
        }
        Ok(())
    }

    fn place(&mut self, mut scan_line: ScanLine, cx: &mut Context) -> Result<ScanLine> {
        let mut frame = scan_line.input.frame;
        scan_line.recorded = self.keeps_recorded.then(|| {
            let (input, emissions) = (Arc::clone(&scan_line.input), scan_line.emissions.clone());
            Box::new(RecordedShots { input, emissions })
        });
        match frame {
            Frame::Map | Frame::Earth => {
                self.geometry.keys().unused_in(frame).into_iter().for_each(|problem| cx.warn(problem));
            }
            Frame::Scanner | Frame::Body if self.geometry.has_trajectory() => {
                self.check_frame(frame)?;
                self.pose(&mut scan_line, cx)?;
                frame = Frame::Earth;
            }
            Frame::Scanner | Frame::Body if !self.geometry.installation().is_plain() => {
                self.check_frame(frame)?;
                let installation = *self.geometry.installation();
                scan_line.emissions.iter_mut().for_each(|emission| installation.to_body(emission));
                frame = Frame::Body;
            }
            _ => {}
        }
        // Of other lines, the flag has the meaning that their file gives it.
        if matches!(scan_line.content, Content::Returns(_))
            && let Some(shot) = scan_line.emissions.iter().find(|shot| is_not_decomposed(shot))
        {
            return Err(decomposed_otherwise(shot));
        }
        if let (None, Some(first)) = (self.first_shot, scan_line.emissions.first()) {
            self.first_shot = Some(FirstShot { alignment: self.alignment, ..FirstShot::of(first) });
            self.input = None;
        }
        scan_line.input = self.info(&scan_line.input, frame);
        Ok(scan_line)
    }

    /// Rejects a `mount` for a recording already in body axes.
    fn check_frame(&self, frame: Frame) -> Result<()> {
        if frame == Frame::Body && self.geometry.keys().turns_scanners() {
            return Err(StageError::failed(
                "the beams of this recording are already in body axes, but `[job.geometry]` has a `mount`",
                "remove `mount`",
            ));
        }
        Ok(())
    }

    /// Applies the pose to every shot of a line; shots without a pose are rejected.
    fn pose(&mut self, scan_line: &mut ScanLine, cx: &mut Context) -> Result<()> {
        unwrap_times(&mut self.times, scan_line)?;
        let Some(first) = scan_line.emissions.first() else { return Ok(()) };
        if self.alignment.is_none() {
            self.alignment = self.geometry.align(&scan_line.input, first.gps_time_s)?;
        }
        if self.coverage.span_s.is_none() {
            self.geometry.notes().for_each(|note| cx.warn(note));
        }
        let without_angles = are_unknown(&scan_line.emissions);
        let mut down = None;
        let mut place = Vec::with_capacity(scan_line.emissions.len());
        let mut kept = 0;
        let mut lost = None;
        let has_returns = matches!(scan_line.content, Content::Returns(_));
        let geometry = Arc::clone(&self.geometry);
        let mut poses = self.alignment.and_then(|alignment| geometry.poses(alignment));
        scan_line.emissions.retain_mut(|emission| {
            let pose = poses.as_mut().and_then(|poses| poses.at(emission.gps_time_s));
            self.coverage.add(emission.gps_time_s, pose.is_some());
            place.push(pose.is_some().then_some(kept));
            if let Some(pose) = &pose {
                kept += 1;
                pose_one(&geometry, emission, pose, &mut down);
            } else if has_returns && !is_not_decomposed(emission) {
                lost.get_or_insert(*emission);
            }
            pose.is_some()
        });
        if let Some(shot) = lost {
            return Err(decomposed_otherwise(&shot));
        }
        if (kept as usize) < place.len() {
            self.coverage.check(self.alignment.as_ref())?;
            reject(scan_line, &place, cx);
        }
        if without_angles {
            set_directions(&mut scan_line.emissions);
        }
        scan_line.stats.gps_time_s = scan_line.emissions.first().map_or(f64::NAN, |first| first.gps_time_s);
        Ok(())
    }

    /// Metadata of the recording in this frame, with its first shot, and its week by the date of the
    /// trajectory if it has none.
    fn info(&mut self, of_source: &Arc<InputInfo>, frame: Frame) -> Arc<InputInfo> {
        if let Some([from, to]) = &self.input
            && Arc::ptr_eq(from, of_source)
        {
            return Arc::clone(to);
        }
        let mut info = InputInfo { frame, first_shot: self.first_shot, ..InputInfo::clone(of_source) };
        let of_trajectory = self
            .first_shot
            .and_then(|first| Some((first.alignment?, first.time_s)))
            .filter(|_| info.gps_week.is_none())
            .and_then(|(alignment, time_s)| {
                Some((alignment.gps_week(time_s)?, alignment.on_trajectory(time_s)))
            });
        if let Some((week, adjusted_s)) = of_trajectory {
            info.gps_week = Some(week);
            if let Some((year, day)) = day_of_year(adjusted_s) {
                (info.recorded, info.is_file_date) = (Some((day, year)), false);
            }
        }
        if frame != of_source.frame {
            (info.crs_wkt, info.coordinate_grid) = (None, None);
        }
        let [_, to] = self.input.insert([Arc::clone(of_source), Arc::new(info)]);
        Arc::clone(to)
    }
}

/// Applies the pose to one shot; `down` is the vertical at the start of the line, valid for all of
/// it.
fn pose_one(geometry: &Geometry, emission: &mut Emission, pose: &Pose, down: &mut Option<[f64; 3]>) {
    geometry.installation().to_body(emission);
    to_earth(emission, pose);
    if emission.scan_angle_deg.is_nan() {
        let origin_m = emission.origin_m;
        let down = down.get_or_insert_with(|| down_at(Frame::Earth, origin_m).unwrap_or_default());
        emission.scan_angle_deg = scan_angle_deg(emission.direction, pose, *down) as f32;
    }
}

/// Whether the returns of a shot are unknown.
fn is_not_decomposed(shot: &Emission) -> bool {
    shot.flags & emission_flags::NOT_DECOMPOSED != 0
}

/// Error for a shot that has a pose only before or only after its decomposition.
fn decomposed_otherwise(shot: &Emission) -> StageError {
    let [now, then] = match is_not_decomposed(shot) {
        true => ["has a pose", "had none"],
        false => ["has no pose", "had one"],
    };
    StageError::failed(
        format!(
            "shot {} at {:.6} s {now} with this trajectory and calibration, but {then} when its line was decomposed",
            shot.shot, shot.gps_time_s
        ),
        "run the job again without `--from-returns`",
    )
}

/// Removes the shots without a pose and their blocks; `place` gives the new indices of the others.
fn reject(scan_line: &mut ScanLine, place: &[Option<u32>], cx: &mut Context) {
    let shots = place.iter().filter(|place| place.is_none()).count() as u64;
    let mut n_blocks = 0;
    let keep = |emission: &mut u32| match place.get(*emission as usize).copied().flatten() {
        Some(place) => {
            *emission = place;
            true
        }
        None => false,
    };
    match &mut scan_line.content {
        Content::Shots(blocks) => {
            let before = blocks.len();
            blocks.keep(place);
            n_blocks = (before - blocks.len()) as u64;
            scan_line.stats.nw = blocks.waveforms() as u64;
        }
        Content::Returns(returns) | Content::Points(returns, _) => {
            returns.retain_mut(|found| keep(&mut found.emission));
        }
    }
    scan_line.profiles.retain_mut(|profile| keep(&mut profile.emission));
    cx.reject_with_blocks(Reason::OutsideTrajectory, shots, n_blocks);
}

/// Unwraps the times of a line, continuing from earlier lines.
fn unwrap_times(times: &mut Option<Unwrap>, scan_line: &mut ScanLine) -> Result<()> {
    let clock = Clock::of(scan_line.input.time_scale).unwrap_or(Clock::Adjusted);
    let times = times.get_or_insert(Unwrap::new(clock));
    for emission in &mut scan_line.emissions {
        if !emission.gps_time_s.is_finite() {
            return Err(StageError::failed(
                format!("shot {} has no GPS time and cannot be located on the trajectory", emission.shot),
                "use a recording with GPS times, or remove `trajectory` from `[job.geometry]`",
            ));
        }
        emission.gps_time_s = times.next(emission.gps_time_s);
    }
    Ok(())
}

/// Coverage of the recording by the trajectory.
#[derive(Debug, Default)]
struct Coverage {
    /// First and last time of all shots, s.
    span_s: Option<[f64; 2]>,
    /// First and last time of shots without a pose, s.
    missing_s: Option<[f64; 2]>,
    covered: u64,
    missing: u64,
}

impl Coverage {
    fn add(&mut self, time_s: f64, is_covered: bool) {
        extend(&mut self.span_s, time_s);
        if is_covered {
            self.covered += 1;
        } else {
            self.missing += 1;
            extend(&mut self.missing_s, time_s);
        }
    }

    /// Fails if the trajectory has ended without covering any shot.
    fn check(&self, alignment: Option<&Alignment>) -> Result<()> {
        let has_ended_before =
            |time_s| alignment.is_some_and(|found| found.trajectory.last_s < found.on_trajectory(time_s));
        match self.span_s {
            Some(span_s) if self.covered == 0 && has_ended_before(span_s[0]) => {
                // The recording goes on.
                Err(no_overlap(alignment, [span_s[0], f64::INFINITY]))
            }
            _ => Ok(()),
        }
    }

    /// Notes shots that were not covered.
    fn finish(&self, alignment: Option<&Alignment>, cx: &mut Context) -> Result<()> {
        if let (0, Some(span_s)) = (self.covered, self.span_s) {
            return Err(no_overlap(alignment, span_s));
        }
        if let (Some([first_s, last_s]), Some(Alignment { recording, trajectory, .. })) =
            (self.missing_s, alignment)
        {
            let (n, missing) = (self.missing, TimeSpan { first_s, last_s, ..*recording });
            cx.warn(format!(
                "{n} shots are rejected, because the trajectory has no pose for them: they last from {missing}, the \
                 trajectory from {trajectory}{}",
                utc_hint(missing, *trajectory)
            ));
        }
        Ok(())
    }
}

/// Error if the trajectory covers none of the shots, which span `shots_s`.
fn no_overlap(alignment: Option<&Alignment>, [first_s, last_s]: [f64; 2]) -> StageError {
    let Some(Alignment { recording, trajectory, .. }) = alignment else {
        return StageError::failed("there is no trajectory", "set `trajectory` in `[job.geometry]`");
    };
    let (recording, trajectory) = (TimeSpan { first_s, last_s, ..*recording }, *trajectory);
    georef::Error::from(Misaligned::NoOverlap { recording, trajectory }).into()
}

fn extend(span_s: &mut Option<[f64; 2]>, time_s: f64) {
    let [first, last] = span_s.get_or_insert([time_s; 2]);
    (*first, *last) = (first.min(time_s), last.max(time_s));
}
