//! Writes a scene as files: recording, trajectory and truth.
//!
//! The recording is a container with the waveforms of an instrument without zone resolution, in the
//! frame of a level scanner. The truth contains every isolated echo.

use std::io::{BufWriter, Write};
use std::path::Path;

use wavex::scan_line::emission_flags::{SYNCHRONISED, SYNCHRONISED_WITHIN_LAST_SECOND};
use wavex_formats::container::{
    Compression, ContainerBlock, ContainerHeader, ContainerShot, ContainerWriter, EmissionReference,
    LineBuilder, TimeScale, channel,
};
use wavex_formats::trajectory::sbet::SbetRecord;

use wavex_simulation::mta_scenes::{EchoScene, METRES_PER_NS, RecordedEcho, RecordedLine, TargetClass, hash};

/// Name of a recording that began on 6 May 2025, a Tuesday, at 10:00:00.
pub const NAME: &str = "250506_100000.sdf";
/// Start of the clock, seconds of GPS week 2365.
const START_S: f64 = 208_800.0;
const SPEED_MPS: f64 = 90.0;
const START_RAD: [f64; 2] = [0.83, 0.22];
const HEIGHT_M: f64 = 3400.0;
/// WGS 84: semi-major axis, and the square of the eccentricity.
const SEMI_MAJOR_M: f64 = 6_378_137.0;
const ECCENTRICITY_SQUARED: f64 = 6.694_379_990_141_317e-3;
/// SD of Gaussian pulses of 4.5 ns full width at half maximum.
const PULSE_SD_NS: f64 = 4.5 / 2.354_820_045;
const BACKGROUND_DN: f64 = 2.3;
const NOISE_SD_DN: f64 = 0.8;
const OUTGOING_DN: f64 = 180.0;
/// Margins of a block before its first and after its last echo.
const BEFORE_NS: f64 = 10.0;
const AFTER_NS: f64 = 20.0;
/// Minimum distance of an isolated echo from other echoes.
///
/// Overlapping echoes are not a test of zone resolution.
const ALONE_NS: f64 = 15.0;

/// Isolated echo with its ideal evaluation.
pub struct Truth {
    /// Number of the emission that caused it.
    pub shot: u64,
    /// Number of emissions between cause and reception.
    pub zone: u64,
    /// True range.
    pub range_m: f64,
    /// True position, earth-centred, earth-fixed.
    pub ecef_m: [f64; 3],
}

/// Creates metadata that SDF can also represent.
fn header() -> ContainerHeader {
    ContainerHeader {
        instrument: Some("LMS-Q680i".into()),
        serial: Some("9997".into()),
        time_scale: TimeScale::Week,
        gps_week: Some(2365),
        amplitude_low: Some(vec![(9.0, 0.0), (68.0, 9.75), (255.0, 19.7)]),
        recorded: Some((126, 2025)),
        full_scale_dn: Some(255),
        emission_reference: Some(EmissionReference::OutgoingPulse),
        ..ContainerHeader::new(1.0, 2e9 * METRES_PER_NS)
    }
}

/// Writes the recording as [`NAME`] and the trajectory as `flight.sbet` into `folder`.
///
/// Returns the truth in order of reception.
pub fn write(scene: &EchoScene, lines: &[RecordedLine], folder: &Path) -> Vec<Truth> {
    let path = folder.join(NAME);
    let file = BufWriter::new(std::fs::File::create(&path).expect("a new file"));
    let mut writer = ContainerWriter::file(file, &path, &header(), Compression::None).expect("a header");
    let first_shot = |line: u32| u64::from(line) * scene.angles_rad.len() as u64;
    for (number, line) in (0u32..).zip(lines) {
        let mut rows = LineBuilder::new();
        let mut echoes = line.echoes.iter().peekable();
        for (index, (&clock_ps, &angle_rad)) in line.clocks_ps.iter().zip(&scene.angles_rad).enumerate() {
            let shot = first_shot(number) + index as u64;
            rows.shot(&shot_of(shot, number, clock_ps, angle_rad));
            let mut pulses = Vec::new();
            while let Some(echo) = echoes.next_if(|echo| echo.emission as usize == index) {
                let cause = first_shot(echo.cause.0) + u64::from(echo.cause.1);
                pulses.push(Pulse {
                    time_ns: echo.time_ns + leaves_ns(scene.seed, cause),
                    height_dn: height_dn([scene.seed, shot, pulses.len() as u64], echo.class),
                });
            }
            blocks(&mut rows, [scene.seed, shot], &pulses);
        }
        writer.write(rows).expect("a line");
    }
    writer.finish().expect("a whole file").flush().expect("a whole file");
    std::fs::write(folder.join("flight.sbet"), trajectory(lines)).expect("a trajectory");
    truth(scene, lines)
}

/// Pulse at the receiver.
///
/// Its time is relative to the clock of its record.
struct Pulse {
    time_ns: f64,
    height_dn: f64,
}

/// Returns a number in [0, 1).
fn unit(key: [u64; 4]) -> f64 {
    (hash(key) >> 11) as f64 / (1u64 << 53) as f64
}

/// Returns the emission time of a shot relative to its clock, ns.
fn leaves_ns(seed: u64, shot: u64) -> f64 {
    unit([seed, 21, shot, 0])
}

/// Returns the height of an echo, DN: lowest for wires.
///
/// False alarms barely trigger a block.
fn height_dn([seed, shot, echo]: [u64; 3], class: TargetClass) -> f64 {
    let (least, most) = match class {
        TargetClass::Ground | TargetClass::Building => (40.0, 160.0),
        TargetClass::Vegetation => (25.0, 90.0),
        TargetClass::Wire => (15.0, 40.0),
        TargetClass::FalseAlarm => (6.0, 9.0),
    };
    least + (most - least) * unit([seed, 22, shot, echo])
}

fn shot_of(shot: u64, line: u32, clock_ps: i64, angle_rad: f64) -> ContainerShot {
    ContainerShot {
        shot,
        line,
        gps_time_s: Some(gps_time_s(clock_ps)),
        clock_ps,
        origin_m: [0.0; 3],
        direction: direction(angle_rad),
        facet: 0,
        flags: SYNCHRONISED | SYNCHRONISED_WITHIN_LAST_SECOND,
        mta_zone: None,
        scan_angle_deg: None,
        frame_scale: None,
    }
}

fn gps_time_s(clock_ps: i64) -> f64 {
    START_S + clock_ps as f64 * 1e-12
}

/// Forward, right, down.
fn direction(angle_rad: f64) -> [f64; 3] {
    [0.0, angle_rad.sin(), angle_rad.cos()]
}

/// Writes the outgoing pulse and the echo blocks.
///
/// Echoes with overlapping margins share a block.
fn blocks(rows: &mut LineBuilder, [seed, shot]: [u64; 2], pulses: &[Pulse]) {
    let mut random = [seed, 23, shot, 0];
    let outgoing = Pulse { time_ns: leaves_ns(seed, shot), height_dn: OUTGOING_DN };
    block(rows, channel::REFERENCE, &[outgoing], &mut random);
    for pulses in pulses.chunk_by(|before, after| after.time_ns - before.time_ns < BEFORE_NS + AFTER_NS) {
        block(rows, channel::LOW_POWER, pulses, &mut random);
    }
}

fn block(rows: &mut LineBuilder, channel: u8, pulses: &[Pulse], random: &mut [u64; 4]) {
    let [Some(first), Some(last)] = [pulses.first(), pulses.last()] else {
        return;
    };
    let start_ns = (first.time_ns - BEFORE_NS).floor();
    let samples: Vec<u16> = (0..(last.time_ns + AFTER_NS - start_ns) as u32)
        .map(|k| {
            let time_ns = start_ns + f64::from(k);
            let height_dn = |pulse: &Pulse| {
                pulse.height_dn * (-0.5 * ((time_ns - pulse.time_ns) / PULSE_SD_NS).powi(2)).exp()
            };
            let signal_dn: f64 = pulses.iter().map(height_dn).sum();
            (BACKGROUND_DN + signal_dn + noise_dn(random)).round().clamp(0.0, 255.0) as u16
        })
        .collect();
    rows.block(&ContainerBlock {
        channel,
        start_ns,
        interval_ns: None,
        zone: None,
        gain: None,
        samples: &samples,
    });
}

/// Approximates normal noise by the sum of the eight bytes of a random number.
fn noise_dn(random: &mut [u64; 4]) -> f64 {
    const MEAN: f64 = 8.0 * 127.5;
    const SD: f64 = 209.023;
    random[3] += 1;
    let sum: u32 = hash(*random).to_le_bytes().into_iter().map(u32::from).sum();
    NOISE_SD_DN * (f64::from(sum) - MEAN) / SD
}

/// Returns the latitude at a time.
///
/// The aircraft flies north, level, at constant height.
fn latitude_rad(time_s: f64) -> f64 {
    START_RAD[0] + SPEED_MPS * (time_s - START_S) / 6.4e6
}

/// Encodes the trajectory, every 5 ms.
///
/// From a second before the first line to a second after the last.
fn trajectory(lines: &[RecordedLine]) -> Vec<u8> {
    let last = lines.iter().rev().find_map(|line| line.clocks_ps.last());
    let length_s = last.map_or(0.0, |&clock_ps| clock_ps as f64 * 1e-12);
    let record = |index: u32| {
        let time_s = START_S - 1.0 + f64::from(index) * 0.005;
        SbetRecord {
            time_s,
            latitude_rad: latitude_rad(time_s),
            longitude_rad: START_RAD[1],
            height_m: HEIGHT_M,
            velocity_mps: [SPEED_MPS, 0.0, 0.0],
            ..SbetRecord::default()
        }
        .encode()
    };
    (0..((length_s + 2.0) / 0.005) as u32).flat_map(record).collect()
}

/// Returns the position of a target.
///
/// The aircraft's position plus range along the beam.
fn ecef_m(clock_ps: i64, angle_rad: f64, range_m: f64) -> [f64; 3] {
    let (sin_lat, cos_lat) = latitude_rad(gps_time_s(clock_ps)).sin_cos();
    let (sin_lon, cos_lon) = START_RAD[1].sin_cos();
    let normal_m = SEMI_MAJOR_M / (1.0 - ECCENTRICITY_SQUARED * sin_lat * sin_lat).sqrt();
    let from_axis_m = (normal_m + HEIGHT_M) * cos_lat;
    let height_m = (normal_m * (1.0 - ECCENTRICITY_SQUARED) + HEIGHT_M) * sin_lat;
    let [_, east_m, down_m] = direction(angle_rad).map(|part| part * range_m);
    [
        from_axis_m * cos_lon - east_m * sin_lon - down_m * cos_lat * cos_lon,
        from_axis_m * sin_lon + east_m * cos_lon - down_m * cos_lat * sin_lon,
        height_m - down_m * sin_lat,
    ]
}

/// Returns the isolated echoes, in order of reception.
fn truth(scene: &EchoScene, lines: &[RecordedLine]) -> Vec<Truth> {
    let shots = scene.angles_rad.len() as u64;
    let mut found = Vec::new();
    for (number, line) in (0u64..).zip(lines) {
        let of = |echo: &RecordedEcho| {
            let (cause_line, cause) = (echo.cause.0 as usize, echo.cause.1 as usize);
            let emitted_ps = lines.get(cause_line)?.clocks_ps.get(cause)?;
            let received_ps = line.clocks_ps.get(echo.emission as usize)?;
            let flight_ns = (received_ps - emitted_ps) as f64 * 1e-3 + echo.time_ns;
            let range_m = flight_ns * METRES_PER_NS;
            let shot = cause_line as u64 * shots + cause as u64;
            let zone = number * shots + u64::from(echo.emission) - shot;
            let angle_rad = *scene.angles_rad.get(cause)?;
            Some(Truth { shot, zone, range_m, ecef_m: ecef_m(*emitted_ps, angle_rad, range_m) })
        };
        let apart = |a: &RecordedEcho, b: &RecordedEcho| {
            a.emission != b.emission || (a.time_ns - b.time_ns).abs() > ALONE_NS
        };
        for (index, echo) in line.echoes.iter().enumerate() {
            let beside = [index.checked_sub(1), Some(index + 1)].into_iter().flatten();
            let alone = beside.filter_map(|beside| line.echoes.get(beside)).all(|other| apart(echo, other));
            if alone && echo.class != TargetClass::FalseAlarm {
                found.extend(of(echo));
            }
        }
    }
    found
}
