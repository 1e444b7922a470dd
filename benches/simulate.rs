//! Speed of the simulator.
//!
//! Shots per second and core, for scenes and receivers of increasing complexity. `cargo bench
//! --bench simulate` prints a table; the goal for the first row is 300 000.
#![allow(clippy::print_stdout, clippy::panic, reason = "a bench prints its figures and panics on failure")]

use wavex::registry;
use wavex::stage::{Context, Plan, RunContext};
use wavex_simd::SimdLevel;
use wavex_testkit::clock::cpu_s;
use wavex_testkit::engine_stages::{COUNT, WORK, WRITE_NUMBERS, job};

/// Name and `simulate` keys of each case.
const CASES: &[(&str, &str)] = &[
    ("level ground, building and forest; one receiver", ""),
    ("level ground alone; one receiver", "building_height_m = 0.0\ncanopy_height_m = 0.0"),
    (
        "the same in the scanner frame, with attitude variation",
        "sbet = 'bench.sbet'\nroll_deg = 2.0\npitch_deg = 1.0\nyaw_deg = 1.0",
    ),
    ("the same, in recorded order", "as_recorded = true"),
    ("country; one receiver", "landscape = 'country'"),
    (
        "country; two receivers, modulation, blind gap, as recorded",
        "landscape = 'country'\nhigh_power = true\nmodulation_ns = 17.0\npulse_rate_hz = 400000.0\nblind_gap_ns = 15.0\n\
         flying_height_m = 1500.0\nas_recorded = true\nscanner = 'oscillating'",
    ),
];

/// Returns the median of five flights, shots per second.
fn shots_per_second(keys: &str) -> f64 {
    let spec = registry::find("simulate").unwrap_or_else(|| panic!("there is a simulator"));
    let job = job(&[(spec, keys)]);
    let Plan::Source(source) = &job.stages[0].planned.plan else { panic!("simulate is a source") };
    let run = RunContext {
        input: "".into(),
        stem: "simulated".into(),
        input_dir: std::env::temp_dir(),
        output_dir: std::env::temp_dir(),
        simd: SimdLevel::best(),
        ..RunContext::alone("".as_ref())
    };
    let mut rates: Vec<f64> = (0..5)
        .map(|_| {
            let before = cpu_s();
            let mut lines = source.make(&run).unwrap_or_else(|error| panic!("{error}"));
            let mut shots = 0;
            while let Some(line) =
                lines.next(&mut Context::default()).unwrap_or_else(|error| panic!("{error}"))
            {
                shots += line.emissions.len();
            }
            shots as f64 / (cpu_s() - before)
        })
        .collect();
    rates.sort_by(f64::total_cmp);
    rates[2]
}

fn main() {
    let _ = (&COUNT, &WORK, &WRITE_NUMBERS);
    println!("{:<52} {:>22}   goal", "simulate, one thread", "shots per core-second");
    for (row, (name, keys)) in CASES.iter().enumerate() {
        let goal = if row == 0 { "300000" } else { "" };
        println!("{name:<52} {:>22.0}   {goal}", shots_per_second(keys));
    }
}
