//! Aligns a survey of plain files and prints the result as JSON: `align_points FOLDER`.
//!
//! `FOLDER/survey.json` names the files and holds start values and SDs; tests/python/make_alignment.py writes all of
//! them. Files of points hold rows of 8 little-endian doubles: time (s), direction in the scanner frame (3), range (m),
//! SD of the range (m), number of returns of the shot, 1 for the low-power receiver. Trajectories hold rows of 7: time (s),
//! latitude, longitude (rad), height (m), roll, pitch, heading (rad).

#![allow(clippy::print_stdout)]

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use serde_json::{Value, json};
use wavex_align::adjust::{AlignSettings, Constraints, align_with};
use wavex_align::control::ControlPoint;
use wavex_align::parameters::{GlobalPriors, TrajectoryModel};
use wavex_align::patch::{Horizon, PatchBudget, PatchMaker, PatchReturn, PatchSettings};
use wavex_align::result::{Alignment, ParameterResult};
use wavex_align::scanner::{BeamSource, Scanner, ScannerBeam};
use wavex_align::survey::{Installation, Strip, Survey};
use wavex_geodesy::calibration::Calibration;
use wavex_geodesy::ellipsoid::Geodetic;
use wavex_geodesy::frames::{Attitude, Vector, rotation_of_angles};
use wavex_geodesy::trajectory::{Sample, Trajectory};

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).ok_or("usage: align_points FOLDER")?;
    let folder = Path::new(&folder);
    let given: Value = serde_json::from_slice(&std::fs::read(folder.join("survey.json"))?)?;
    let installations = given["installations"].as_array().ok_or("`installations` is missing")?;
    let installations = installations.iter().map(installation).collect::<Result<Vec<_>, _>>()?;
    let mut settings = AlignSettings::default();
    if let Some(sds) = given.get("trajectory_sds") {
        settings.trajectory_priors.sd = serde_json::from_value(sds.clone())?;
    }
    if let Some(times) = given.get("correlation_s") {
        settings.trajectory_priors.correlation_s = serde_json::from_value(times.clone())?;
    }
    if let Some(cell_m) = given["cell_m"].as_f64() {
        settings.cell_m = cell_m;
    }
    if let Some(most_pairs) = given["most_pairs"].as_u64() {
        settings.most_pairs = usize::try_from(most_pairs)?;
    }
    if let Some(fits) = given["fits_trajectory_sds"].as_bool() {
        settings.fits_trajectory_sds = fits;
    }
    if let Some(fits) = given["fits_time_errors"].as_bool() {
        settings.fits_time_errors = fits;
    }
    let control = given["control"].as_array().map_or(&[][..], Vec::as_slice).iter().map(control_point);
    let control = control.collect::<Result<Vec<_>, _>>()?;
    settings.trajectory_model = match given["model"].as_str().unwrap_or("constant") {
        "none" => TrajectoryModel::None,
        "constant" => TrajectoryModel::Constant,
        "linear" => TrajectoryModel::Linear,
        "spline" => TrajectoryModel::Spline(given["knots_s"].as_f64().ok_or("`knots_s` is missing")?),
        other => return Err(format!("unknown model `{other}`").into()),
    };
    let files = given["strips"].as_array().ok_or("`strips` is missing")?;
    let (mut trajectories, mut strips) = (Vec::new(), Vec::new());
    let most_patches = given["most_patches"].as_u64().map(usize::try_from).transpose()?;
    let mut budget = most_patches.map_or_else(PatchBudget::default, PatchBudget::new);
    let mut horizon = None;
    let mut counts = Vec::new();
    let started = Instant::now();
    for (index, files) in files.iter().enumerate() {
        let name = |key: &str| files[key].as_str().ok_or(format!("strip {index} lacks `{key}`"));
        let trajectory = read_trajectory(&folder.join(name("trajectory")?))?;
        let horizon = *horizon.get_or_insert_with(|| Horizon::at(trajectory.samples()[0].place));
        let patch_settings = PatchSettings { cell_m: settings.cell_m, ..PatchSettings::default() };
        let installation = usize::try_from(files["installation"].as_u64().unwrap_or_default())?;
        let scanner = installations.get(installation).ok_or("unknown installation")?.scanner;
        let mut maker = PatchMaker::new(u32::try_from(index)?, horizon, patch_settings);
        for row in rows::<8>(&folder.join(name("points")?))? {
            if let Some(made) = located(&scanner, &trajectory, row) {
                maker.add(&made);
            }
        }
        let (made, of_strip) = maker.finish();
        counts.push(format!("{} patches; {of_strip:?}", made.len()));
        budget.add(made);
        strips.push(Strip { trajectory: index, installation });
        trajectories.push(trajectory);
    }
    let (patches, kept) = budget.finish();
    let patches_s = started.elapsed().as_secs_f64();
    let survey = Survey {
        trajectories: &trajectories,
        installations: &installations,
        strips: &strips,
        patches: &patches,
        horizon: horizon.ok_or("there are no strips")?,
    };
    let started = Instant::now();
    let result = align_with(&survey, &settings, &Constraints { control: &control, references: &[] })?;
    let align_s = started.elapsed().as_secs_f64();
    let mut report = report(&result);
    report["patches"] = json!(counts);
    report["kept"] = json!(kept);
    report["seconds"] = json!([patches_s, align_s]);
    println!("{report:#}");
    Ok(())
}

fn installation(given: &Value) -> Result<Installation, serde_json::Error> {
    let calibration: Calibration = serde_json::from_value(given["calibration"].clone())?;
    let mount_deg: [f64; 3] = serde_json::from_value(given["mount_deg"].clone())?;
    let body_from_mount = rotation_of_angles(mount_deg.map(f64::to_radians));
    let priors = match given.get("prior_sds") {
        Some(sds) => GlobalPriors(serde_json::from_value(sds.clone())?),
        None => GlobalPriors::default(),
    };
    Ok(Installation { scanner: Scanner { body_from_mount, calibration }, priors })
}

fn control_point(given: &Value) -> Result<ControlPoint, serde_json::Error> {
    let position_in_ecef_m = serde_json::from_value(given["ecef_m"].clone())?;
    Ok(ControlPoint {
        position_in_ecef_m,
        sd_m: serde_json::from_value(given["sd_m"].clone())?,
        normal: None,
    })
}

fn located(scanner: &Scanner, trajectory: &Trajectory, row: [f64; 8]) -> Option<PatchReturn> {
    let [time_s, x, y, z, range_m, range_sd_m, n_returns, low] = row;
    let beam = ScannerBeam { time_s, direction: [x, y, z], range_m };
    let source = BeamSource { origin_m: [0.0; 3], on_low_power_scale: low > 0.5 };
    let mut poses = trajectory.poses();
    let end = scanner.locate(&source, &beam, &mut poses, None)?;
    let start = scanner.locate(&source, &ScannerBeam { range_m: range_m - 1.0, ..beam }, &mut poses, None)?;
    let step: Vector = std::array::from_fn(|axis| end[axis] - start[axis]);
    let length = step.iter().map(|part| part * part).sum::<f64>().sqrt();
    Some(PatchReturn {
        beam,
        source,
        range_sd_m,
        n_returns: n_returns as u8,
        point_in_ecef_m: end,
        direction_in_ecef: step.map(|part| part / length),
    })
}

fn read_trajectory(path: &Path) -> Result<Trajectory, Box<dyn Error>> {
    let samples = rows::<7>(path)?.into_iter().map(|row| {
        let [time_s, latitude_rad, longitude_rad, height_m, roll_rad, pitch_rad, heading_rad] = row;
        Sample {
            time_s,
            place: Geodetic { latitude_rad, longitude_rad, height_m },
            attitude: Attitude { roll_rad, pitch_rad, heading_rad },
        }
    });
    Ok(Trajectory::new(samples.collect())?)
}

fn rows<const N: usize>(path: &Path) -> Result<Vec<[f64; N]>, Box<dyn Error>> {
    let bytes = std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))?;
    let (numbers, _) = bytes.as_chunks::<8>();
    let numbers: Vec<f64> = numbers.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
    Ok(numbers.as_chunks::<N>().0.to_vec())
}

fn report(result: &Alignment) -> Value {
    let parameter = |p: &ParameterResult| {
        json!({
            "name": p.parameter.name(), "start": p.start, "value": p.value, "sd": p.sd, "formal_sd": p.formal_sd,
            "jackknife_sd": p.jackknife_sd, "prior_sd": p.prior_sd, "treatment": format!("{:?}", p.treatment),
            "reasons": wavex_align::estimable::reasons(p.parameter, &result.facts),
        })
    };
    let parameters: Vec<Vec<Value>> =
        result.parameters.iter().map(|own| own.iter().map(parameter).collect()).collect();
    let strips: Vec<Value> = result
        .strips
        .iter()
        .map(|strip| {
            let knots: Vec<Value> = strip
                .corrections
                .iter()
                .flat_map(|corrections| corrections.knots())
                .zip(&strip.knot_sds)
                .map(|(knot, sds)| {
                    json!({"time_s": knot.time_s, "position_m": knot.offset.north_east_down_m,
                           "attitude_rad": knot.offset.roll_pitch_heading_rad, "sds": sds})
                })
                .collect();
            json!({"knots": knots, "n_pairs": strip.n_pairs, "n_unlocated": strip.n_unlocated})
        })
        .collect();
    let overlaps: Vec<Value> = result
        .overlaps
        .iter()
        .map(|o| {
            json!({"strips": o.strips, "n_pairs": o.n_pairs, "n_rejected": o.n_rejected, "median_m": o.median_m,
                   "spread_m": o.spread_m})
        })
        .collect();
    let correlations: Vec<Value> = result
        .correlations
        .iter()
        .map(|c| json!([c.first.1.name(), c.second.1.name(), c.correlation]))
        .collect();
    let control: Vec<Value> = result
        .control
        .differences
        .iter()
        .map(|own| {
            own.iter().map(|d| json!([d.strip, d.before_m, d.after_m, d.sd_m, d.is_used])).collect::<Value>()
        })
        .collect();
    let sd_factors =
        result.trajectory_sds.map(|both| both.map(|own| json!([own.factor, own.shown, own.is_used])));
    json!({
        "control": control, "control_scale": result.control.scale, "sd_factors": sd_factors,
        "time_errors": result.time_errors.map(|own| json!([own.factor, own.intervals, own.interval_s, own.ratios])),
        "parameters": parameters, "strips": strips, "overlaps": overlaps, "correlations": correlations,
        "scale": result.scale, "n_unknowns": result.n_unknowns, "n_pairs": result.n_pairs,
        "n_rejected": result.n_rejected, "spread_m": result.spread_m, "verdict": format!("{:?}", result.verdict),
        "facts": format!("{:?}", result.facts),
    })
}
