//! Errors and speed of the ground classification: lines `x y z class` (0 ground) from the standard input.
//!
//! `zcat samp11.txt.gz | cargo run --release -p wavex-ground --example ground_errors`; set `RAYON_NUM_THREADS=1` for the
//! speed of one core.
#![expect(clippy::print_stdout, reason = "prints the result")]

use std::io::Read;
use std::time::Instant;

use wavex_ground::filter::{GroundSettings, classify_ground};
use wavex_ground::point::{Class, CloudPoint};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut text = String::new();
    std::io::stdin().read_to_string(&mut text)?;
    let (mut points, mut truth) = (Vec::new(), Vec::new());
    for line in text.lines() {
        let values: Vec<f64> = line.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
        let &[x, y, z, class] = values.as_slice() else {
            return Err(format!("not four numbers: {line}").into());
        };
        points.push(CloudPoint::at([x, y, z]));
        truth.push(class < 0.5);
    }
    let start = Instant::now();
    let classes = classify_ground(&points, &GroundSettings::default());
    let seconds = start.elapsed().as_secs_f64();
    let count = |is_ground: bool, found: Class| {
        truth.iter().zip(&classes).filter(|&(&truth, &class)| truth == is_ground && class == found).count()
            as f64
    };
    let (right_ground, lost) = (count(true, Class::Ground), count(true, Class::Unclassified));
    let (accepted, right_object) = (count(false, Class::Ground), count(false, Class::Unclassified));
    let all = truth.len() as f64;
    let observed = (right_ground + right_object) / all;
    let chance = ((right_ground + lost) * (right_ground + accepted)
        + (accepted + right_object) * (lost + right_object))
        / (all * all);
    println!(
        "type I {:.2} %, type II {:.2} %, total {:.2} %, kappa {:.1} %, {:.0} points/s",
        100.0 * lost / (right_ground + lost),
        100.0 * accepted / (accepted + right_object),
        100.0 * (1.0 - observed),
        100.0 * (observed - chance) / (1.0 - chance),
        all / seconds
    );
    Ok(())
}
