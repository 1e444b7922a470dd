//! Results of a classification for people.

use std::fmt::Write;

use wavex_ground::point::Class;

use super::CloudResult;
use super::files::{ClassCounts, Cloud};

/// Name of a class (LAS 1.4 R15, tables 16 and 17).
fn name(class: u8) -> &'static str {
    match class {
        0 => "never classified",
        1 => "unclassified",
        2 => "ground",
        3 => "low vegetation",
        4 => "medium vegetation",
        5 => "high vegetation",
        6 => "building",
        7 => "low noise",
        8 => "model key point",
        9 => "water",
        10 => "rail",
        11 => "road surface",
        12 => "overlap",
        13 => "wire guard",
        14 => "wire conductor",
        15 => "transmission tower",
        16 => "wire connector",
        17 => "bridge deck",
        18 => "high noise",
        _ => "",
    }
}

/// Part of points in percent; 0 of no points.
pub(super) fn percent(n: u64, of: u64) -> f64 {
    100.0 * n as f64 / of.max(1) as f64
}

fn plural(n: u64) -> &'static str {
    if n == 1 { "" } else { "s" }
}

pub(super) fn n_ground(counts: &ClassCounts) -> u64 {
    counts[usize::from(Class::Ground as u8)]
}

/// Points of each cloud by class, before and after.
pub(super) fn table(rows: &[(&Cloud, CloudResult)]) -> String {
    let mut text = String::new();
    for (cloud, result) in rows {
        let (n, ground, left) = (result.copy.n_points, n_ground(&result.after), result.left.total());
        // Writing to a text cannot fail.
        let _ = writeln!(
            text,
            "{}: {n} point{}, {:.1} % ground, {left} left alone",
            cloud.path.display(),
            plural(n),
            percent(ground, n)
        );
        for (class, (before, after)) in (0..=u8::MAX).zip(result.before.iter().zip(&result.after)) {
            if before + after > 0 {
                let label = format!("{class} {}", name(class));
                let _ = writeln!(text, "  {:<22} {before:>12} -> {after:>12}", label.trim_end());
            }
        }
    }
    text
}

/// What a user should know of a cloud.
pub(super) fn notes(cloud: &Cloud, result: &CloudResult) -> Vec<String> {
    let mut notes = Vec::new();
    let n = result.copy.n_points;
    let mut note = |text: String| notes.push(format!("{}: {text}", cloud.path.display()));
    if n == 0 {
        note("it has no points; the copy is the same".into());
    } else if result.left.total() == n {
        let why = match result.left {
            left if left.n_withheld == n => "withheld or synthetic",
            left if left.n_noise == n => "noise according to the file",
            left if left.n_kept == n => "of classes to keep",
            _ => "withheld, noise, or of classes to keep",
        };
        note(format!("all points are {why}; no class changes"));
    } else if n_ground(&result.after) == 0 {
        note(
            "no ground is found: the points may be a water surface, noise, or only vegetation; check the heights and units of \
             the cloud"
                .into(),
        );
    }
    if result.copy.lost_octree {
        note("its COPC octree is damaged; the copy is LAZ without octree: make one with `wavex copc`".into());
    }
    let waveforms = ["wdp", "WDP", "wdz"].map(|extension| cloud.path.with_extension(extension));
    if let Some(waveforms) = waveforms.iter().find(|path| result.copy.has_waveform_file && path.exists()) {
        note(format!(
            "its waveforms are in {}; copy this file next to the classified cloud",
            waveforms.display()
        ));
    }
    notes
}
