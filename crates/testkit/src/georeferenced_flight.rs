//! Simulated flights with a trajectory, and `georeference` run on their true returns.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use wavex::registry::STAGES;

use wavex::engine::{self, Options, RunSummary};
use wavex::georef::{GeometryKeys, Loader};
use wavex::job::Job;
use wavex::registry;
use wavex::scan_line::{Content, Emission, Frame, InputInfo, LineStats, Return, ScanLine, TimeScale};
use wavex::stage::pose_source::PoseSource;
use wavex::stage::{Context, Map, Plan, RunContext, Source};
use wavex_formats::trajectory::sbet::{RECORD_BYTES, SbetRecord};
use wavex_geodesy::frames::{IDENTITY, Rotation, rotate};
use wavex_simd::SimdLevel;

/// A folder with a recording, its trajectory and its truth.
pub struct Flight {
    folder: tempfile::TempDir,
    /// True returns, in the order of the recording.
    pub truth: Vec<Truth>,
    /// Rotation from the recording's frame to the frame of a scanner with another mounting.
    turned: Rotation,
    /// Information missing from the recording.
    unsaid: Unsaid,
}

/// Information missing from a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Unsaid {
    Nothing,
    /// Times of its shots.
    Times,
    /// Time scale.
    Scale,
    /// GPS week.
    Week,
    /// Whether its frame is the scanner's or the aircraft's.
    Scanner,
}

/// A true return.
#[derive(Clone, Copy, Debug)]
pub struct Truth {
    /// Number of its shot.
    pub shot: u64,
    /// True range.
    pub range_m: f64,
    /// Easting, northing (UTM zone of the start) and ellipsoidal height, m.
    pub point_m: [f64; 3],
}

/// Runs a job stored in `folder`.
#[track_caller]
pub fn run(folder: &Path, text: &str) -> Result<RunSummary, String> {
    let job = Job::parse(STAGES, "job.toml", text, &[]).unwrap_or_else(|errors| panic!("{errors}"));
    engine::run(&job, &Options::of_job(&job, folder, folder)).map_err(|error| error.to_string())
}

/// Simulates a flight with these keys: `a.arrow`, `a.out` (SBET), `a.pof` and its truth.
#[track_caller]
pub fn fly(keys: &str) -> Flight {
    let folder = tempfile::tempdir().unwrap();
    let job = format!(
        "[[stage]]\ntype = 'simulate'\nstem = 'a'\ntruth = '*.csv'\nsbet = '*.out'\npof = '*.pof'\n{keys}\n\
         [[stage]]\ntype = 'write_arrow'\npath = '*.arrow'\n"
    );
    run(folder.path(), &job).unwrap();
    let truth = std::fs::read_to_string(folder.path().join("a.csv")).unwrap();
    Flight {
        folder,
        truth: truth.lines().skip(1).map(truth_of).collect(),
        turned: IDENTITY,
        unsaid: Unsaid::Nothing,
    }
}

fn truth_of(row: &str) -> Truth {
    let fields: Vec<&str> = row.split(',').collect();
    let number = |k: usize| fields[k].parse::<f64>().unwrap();
    Truth { shot: number(0) as u64, range_m: number(5), point_m: [number(8), number(9), number(10)] }
}

/// Output of the stage for a flight: points in the order of the truth, and lines.
pub struct Placed {
    /// Points, in the order of the truth.
    pub points: Vec<[f64; 3]>,
    /// Returns, in the same order.
    pub returns: Vec<Return>,
    /// Statistics of each line.
    pub stats: Vec<LineStats>,
    /// Coordinate reference system of the points.
    pub wkt: Option<String>,
    /// GPS week of the last line.
    pub gps_week: Option<u32>,
    /// Rejections and notes.
    pub cx: Context,
}

impl Flight {
    /// Path of a file of the flight.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Folder of the flight.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// The same flight in a scanner frame rotated by `turned`.
    pub fn turned(self, turned: Rotation) -> Flight {
        Flight { turned, ..self }
    }

    /// The same flight, without GPS times of shots.
    pub fn without_times(self) -> Flight {
        Flight { unsaid: Unsaid::Times, ..self }
    }

    /// The same flight, with an unknown time scale.
    pub fn of_no_scale(self) -> Flight {
        Flight { unsaid: Unsaid::Scale, ..self }
    }

    /// The same flight, with an unknown GPS week.
    pub fn of_no_week(self) -> Flight {
        Flight { unsaid: Unsaid::Week, ..self }
    }

    /// The same flight in the aircraft's axes, which are parallel to the scanner's.
    pub fn in_body(self) -> Flight {
        Flight { unsaid: Unsaid::Scanner, ..self }
    }

    /// Runs the stage on the recording with poses and with true ranges instead of those of
    /// `decompose`.
    ///
    /// The errors are therefore caused by georeferencing only. `measured` converts a true to a
    /// measured range.
    pub fn place(&self, geometry: &str, measured: impl Fn(&Truth) -> f64) -> Result<Placed, String> {
        let text = |error: &dyn std::fmt::Display| error.to_string();
        let run = run_context(self, geometry)?;
        let (source, mut stage) = (source(&run), georeference(&run, ""));
        let source = Box::new(Changed { source, turned: self.turned, unsaid: self.unsaid });
        let mut source = PoseSource::new(source, Arc::clone(&run.geometry));
        let mut by_shot: BTreeMap<u64, Vec<&Truth>> = BTreeMap::new();
        self.truth.iter().for_each(|truth| by_shot.entry(truth.shot).or_default().push(truth));
        let mut cx = Context::default();
        let (mut points, mut returns, mut stats) = (Vec::new(), Vec::new(), Vec::new());
        let (mut wkt, mut gps_week) = (None, None);
        while let Some(mut scan_line) = source.next(&mut cx).map_err(|e| text(&e))? {
            scan_line.content = Content::Returns(true_returns(&scan_line, &by_shot, &measured));
            let placed = stage.map(scan_line, &mut cx).map_err(|e| text(&e))?;
            points.extend(placed.points().unwrap());
            returns.extend(placed.returns().unwrap());
            stats.push(placed.stats);
            (wkt, gps_week) = (placed.input.crs_wkt.clone(), placed.input.gps_week);
        }
        if let Plan::Map(plan) = plan("georeference", "") {
            plan.conclude(&mut cx);
        }
        Ok(Placed { points, returns, stats, wkt, gps_week, cx })
    }
}

/// A recording in another frame, with information missing.
struct Changed {
    source: Box<dyn Source>,
    turned: Rotation,
    unsaid: Unsaid,
}

impl Source for Changed {
    fn next(&mut self, cx: &mut Context) -> wavex::stage::Result<Option<ScanLine>> {
        let mut next = self.source.next(cx)?;
        for emission in next.iter_mut().flat_map(|scan_line| &mut scan_line.emissions) {
            emission.origin_m = rotate(&self.turned, emission.origin_m);
            emission.direction = rotate(&self.turned, emission.direction);
            if self.unsaid == Unsaid::Times {
                emission.gps_time_s = f64::NAN;
            }
        }
        if let Some(scan_line) = &mut next {
            let mut input = InputInfo::clone(&scan_line.input);
            match self.unsaid {
                Unsaid::Week => input.gps_week = None,
                Unsaid::Scale => input.time_scale = TimeScale::Unknown,
                Unsaid::Scanner => input.frame = Frame::Body,
                Unsaid::Nothing | Unsaid::Times => return Ok(next),
            }
            scan_line.input = Arc::new(input);
        }
        Ok(next)
    }
}

fn true_returns(
    scan_line: &ScanLine,
    truth: &BTreeMap<u64, Vec<&Truth>>,
    measured: &impl Fn(&Truth) -> f64,
) -> Vec<Return> {
    let of_shot = |(index, emission): (usize, &Emission)| {
        let of_shot = truth.get(&emission.shot).map(Vec::as_slice).unwrap_or_default();
        let n = of_shot.len() as u8;
        of_shot
            .iter()
            .zip(1..)
            .map(move |(truth, number)| return_of(index as u32, [number, n], measured(truth)))
            .collect::<Vec<_>>()
    };
    scan_line.emissions.iter().enumerate().flat_map(of_shot).collect()
}

/// A return with a position only.
pub fn return_of(emission: u32, [number, of]: [u8; 2], range_m: f64) -> Return {
    Return {
        emission,
        return_number: number,
        number_of_returns: of,
        range_m,
        range_sd_m: 0.0,
        amplitude_dn: 100.0,
        intensity: 100.0,
        ..Return::default()
    }
}

/// Run context for the flight, with its geometry files loaded.
pub fn run_context(flight: &Flight, geometry: &str) -> Result<RunContext, String> {
    let keys: GeometryKeys = toml::from_str(geometry).unwrap();
    keys.check().unwrap();
    let loaded = Loader::new(&keys, flight.folder()).and_then(|mut loader| loader.load("a", || false));
    Ok(RunContext {
        input: flight.path("a.arrow"),
        stem: "a".into(),
        input_dir: flight.folder().into(),
        output_dir: flight.folder().into(),
        simd: SimdLevel::best(),
        geometry: Arc::new(loaded.map_err(|error| error.to_string())?),
        ..RunContext::alone("".as_ref())
    })
}

/// Reader of the recording.
pub fn source(run: &RunContext) -> Box<dyn Source> {
    match plan("read_arrow", "path = 'a.arrow'") {
        Plan::Source(plan) => plan.make(run).unwrap(),
        other => panic!("{other:?}"),
    }
}

/// The stage with these keys.
pub fn georeference(run: &RunContext, keys: &str) -> Box<dyn Map> {
    match plan("georeference", keys) {
        Plan::Map(plan) => plan.make(run).unwrap(),
        other => panic!("{other:?}"),
    }
}

fn plan(name: &str, keys: &str) -> Plan {
    let table = toml::de::DeTable::parse(keys).unwrap();
    (registry::find(name).unwrap().parse)(table).unwrap().plan
}

/// Distance of two points, m.
pub fn distance_m(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

/// Writes a geoid in VDatum format: 5 by 5 steps of half a degree, north and east from a corner.
pub fn write_geoid(path: &Path, [south, west]: [f64; 2], height_m: impl Fn(f64, f64) -> f64) {
    let (step, n) = (0.5, 5);
    let mut bytes: Vec<u8> = [south, west, step, step].iter().flat_map(|v: &f64| v.to_be_bytes()).collect();
    bytes.extend([n, n].iter().flat_map(|n: &i32| n.to_be_bytes()));
    for row in 0..n {
        for column in 0..n {
            let (latitude, longitude) = (south + step * f64::from(row), west + step * f64::from(column));
            bytes.extend((height_m(latitude, longitude) as f32).to_be_bytes());
        }
    }
    std::fs::write(path, bytes).unwrap();
}

/// Writes the accuracies as `smrmsg_a.out`: north, east, down, m; roll, pitch, heading, degrees.
pub fn write_accuracy(flight: &Flight, position_sd_m: [f64; 3], attitude_sd_deg: [f64; 3]) {
    let bytes = std::fs::read(flight.path("a.out")).unwrap();
    let (records, _) = bytes.as_chunks::<RECORD_BYTES>();
    let mut accuracy = Vec::new();
    for record in records.iter().map(SbetRecord::decode) {
        let [n, e, d] = position_sd_m;
        let [r, p, h] = attitude_sd_deg.map(|sd| 60.0 * sd);
        let fields = [record.time_s, n, e, d, 0.01, 0.01, 0.01, r, p, h];
        accuracy.extend(fields.iter().flat_map(|field| field.to_le_bytes()));
    }
    std::fs::write(flight.path("smrmsg_a.out"), accuracy).unwrap();
}
