//! Inputs from which fuzzing starts, made by the project's own writers and simulator.

use std::fs;
use std::io::Cursor;
use std::path::Path;

use serde_json::Value;
use wavex::classic::options::Takes;
use wavex::classic::versions::VERSIONS;
use wavex::job::example_job;
use wavex::registry::STAGES;
use wavex_formats::container::{Compression, ContainerWriter, EmissionReference, channel};
use wavex_formats::geokeys;
use wavex_formats::geotiff::{RasterGrid, RasterWriter, empty_tile};
use wavex_formats::trajectory::pof::{PofHeader, PofRecord};
use wavex_formats::trajectory::sbet::SbetRecord;
use wavex_geodesy::crs::wkt_of_epsg;
use wavex_signal::noise::ArNoise;
use wavex_signal::sensor_model::{ChannelModel, SensorModel};

use super::texts::MARKUP;
use super::{SEPARATOR, joined};
use crate::container::{Shot, compressed, container, line_of, of_fractions, of_shots};
use crate::flight::{STAGES as FLIGHT_STAGES, flight};
use crate::las::Las;
use crate::pulsewaves::PulseWaves;
use crate::sdf::{flight as sdf_flight, header as sdf_header};
use crate::shots::{echo, waveform};
use crate::{Outcome, TestFolder, root};

/// An input: target, name and content.
pub type Seed = (&'static str, String, Vec<u8>);

/// Requests for points.
const VIEWED_POINTS: &str = "\
info
tree?generation=1
points?generation=1&first=0&count=50
values?generation=1&first=3&count=4&attribute=deviation_ratio
point?generation=1&index=7
profile?generation=1&from=50,-1&to=500,1&width_m=9&attribute=range_sd_m
find?generation=1&sort=amplitude_dn&descending=true&where=amplitude_dn%3E20,range_sd_m%3C1&flag=overlap&limit=9
";
/// Requests for shots and files.
const VIEWED_SHOTS: &str = "\
shot?input=0&shot=17&set=decompose.detection_sigma%3D9&set=decompose.mode%3Dslow
line?input=0&shot=70
compare?input=0&shot=17&set=decompose.detection_sigma%3D9
compare?generation=1&from=-1e3,-1e3&to=1e3,1e3&set=decompose.split_evidence%3Dfalse
job?set=decompose.width_ratio%3D[0.8,1.5]
layer?name=density
main.js

";

/// All inputs. The program must have been built.
pub fn seeds() -> Vec<Seed> {
    let mut seeds = Vec::new();
    let mut add = |target, name: &str, bytes: Vec<u8>| seeds.push((target, name.to_owned(), bytes));
    recordings(&mut add);
    outputs(&mut add);
    surveys(&mut add);
    patches(&mut add);
    trajectories(&mut add);
    maps(&mut add);
    granules(&mut add);
    texts(&mut add);
    add("sdf", "two_records", any_values());
    add("view", "points", VIEWED_POINTS.into());
    add("view", "shots", VIEWED_SHOTS.into());
    seeds
}

/// Granules that `tests/python/make_hdf5.py` makes: one for each kind of structure.
fn granules(add: &mut Add) {
    let names = [
        "gedi_compact_fill.h5",
        "gedi_extensible.h5",
        "gedi_latest.h5",
        "gedi_product.h5",
        "gedi_v110.h5",
        "lvis_432.h5",
        "lvis_528.h5",
        "spd_3_latest.spd",
        "spd_4_latest.spd",
        "spd_bad.spd",
    ];
    for name in names {
        let path = root().join(format!("crates/wavex-hdf5/tests/data/{name}"));
        add("hdf5", name.split('.').next().unwrap_or(name), fs::read(path).unwrap());
    }
}

type Add<'a> = dyn FnMut(&'static str, &str, Vec<u8>) + 'a;

/// Recordings in each format: small ones, and larger ones with enough waveforms for a calibration.
fn recordings(add: &mut Add) {
    let model = sensor_model();
    for (size, pulses) in [("small", 3), ("large", 210)] {
        let las = Las::new(pulses).with_crs(&wkt_of_epsg(32633).unwrap());
        let pls = PulseWaves::new(pulses);
        let shot = |k: usize| Shot {
            clock_ps: k as i64 * 10_000_000,
            blocks: vec![
                (channel::REFERENCE, -5.0, samples(waveform(k + 100_000, 20.0, 150.0))),
                (channel::LOW_POWER, 4000.0, samples(echo(k))),
            ],
        };
        let shots: Vec<Shot> = (0..pulses).map(shot).collect();
        let container = of_shots(&shots, EmissionReference::OutgoingPulse, true);
        let formats = [
            ("las", las.las(), las.packets.clone()),
            ("laz", las.laz(), las.packets.clone()),
            ("pulsewaves", pls.pls(), pls.waves.clone()),
            ("container", container, Vec::new()),
        ];
        for (format, recording, companion) in formats {
            let name = format!("{size}_{format}");
            let both = joined(&[&recording, &companion]);
            if size == "small" {
                if format.starts_with("la") {
                    add("las", &name, both.clone());
                }
                add("recording", &name, both);
                add("run", &name, joined(&[&recording, &companion, &model]));
            } else if format != "laz" {
                add("run", &name, both);
            }
        }
    }
    let compressed_las = Las::new(3).with_compressed_packets();
    add("compressed_packets", "three_points", joined(&[&compressed_las.las(), &compressed_las.packets]));
    add("compressed_packets", "laz", joined(&[&compressed_las.laz(), &compressed_las.packets]));
    let compressed_pulses = PulseWaves::new(7).with_compressed_waves();
    add("compressed_pulses", "two_chunks", joined(&[&compressed_pulses.plz(4), &compressed_pulses.waves]));
    add(
        "compressed_pulses",
        "compressed_waves",
        joined(&[&compressed_pulses.pls(), &compressed_pulses.waves]),
    );
    let las = Las::new(2).without_locations();
    add("las", "without_locations", joined(&[&las.las(), &las.packets]));
    let pls = PulseWaves::new(3);
    add("pulsewaves", "three_pulses", joined(&[&pls.pls(), &pls.waves]));
    let lines: Vec<_> = sdf_flight().iter().take(2).map(|rows| rows[..4].to_vec()).collect();
    let header = sdf_header();
    add("container", "uncompressed", container(&header, &lines));
    add("container", "lz4", compressed(&header, &lines, Compression::Lz4));
    add("container", "zstd", compressed(&header, &lines, Compression::Zstd));
    let stream = ContainerWriter::stream(Vec::new(), Path::new("made"), &header, Compression::None);
    let mut stream = stream.unwrap();
    lines.iter().for_each(|rows| stream.write(line_of(rows)).unwrap());
    add("container", "stream", stream.finish().unwrap());
    let profiles = of_fractions();
    add("container", "fractions", profiles.clone());
    add("recording", "container_of_profiles", joined(&[&profiles, b""]));
    add("table", "container", container(&header, &lines[..1]));
    let flown = [sdf_flight()[0][..12].to_vec()];
    add("run", "two_receivers", joined(&[&container(&header, &flown), b"", &model]));
}

fn samples(bytes: Vec<u8>) -> Vec<u16> {
    bytes.into_iter().map(u16::from).collect()
}

/// Short sensor model of both receivers: Gaussian pulses as in [`crate::shots`].
fn sensor_model() -> Vec<u8> {
    let channel = ChannelModel {
        pulse_fwhm_ns: 4.5,
        response: None,
        ..crate::waveforms::model(&ArNoise::new(&[0.2], 1.0).unwrap())
    };
    let model =
        SensorModel { low_power: Some(channel.clone()), high_power: Some(channel), ..SensorModel::default() };
    serde_json::to_vec(&model).unwrap()
}

/// Outputs of a small run: points, tables, report and plan.
fn outputs(add: &mut Add) {
    add("sensor_model", "gaussian", sensor_model());
    let place = flight();
    let model: SensorModel = serde_json::from_str(&place.text("in/model.json")).unwrap();
    add("sensor_model", "flight", serde_json::to_vec(&model).unwrap());
    let job = format!("[job]\noutput_dir = 'out'\nreport_page = true\n{FLIGHT_STAGES}");
    place.write("job.toml", job.as_bytes());
    assert_eq!(place.wavex(&["--quiet", "run", "job.toml", "--threads", "1"]), Outcome::success());
    let read = |name: &str| fs::read(place.path(name)).unwrap();
    add("table", "points", read("out/a_points.arrow"));
    let mut report: Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    report["host"] = "machine".into();
    let report = serde_json::to_string(&report).unwrap();
    add("report", "flight", report.clone().into());
    // Text where numbers and names are expected.
    add("report", "markup", report.replace("\"a\"", &format!("\"{MARKUP}\"")).into_bytes());
    let arguments = ["--quiet", "plan", "job.toml", "-o", "plan"];
    assert_eq!(place.wavex(&arguments), Outcome::success());
    add("plan", "one_task", read("plan/plan.json"));
    archives(add);
    points(add);
}

/// Archives of a run that copies four shots.
fn archives(add: &mut Add) {
    let lines = [sdf_flight()[0][..4].to_vec()];
    let recording = compressed(&sdf_header(), &lines, Compression::Lz4);
    let place = TestFolder::with(&[("in/a.arrow", &recording)]);
    let job = "[job]\noutput_dir = 'out'\n[[stage]]\ntype = 'read_arrow'\npath = 'in/*.arrow'\n\
               [[stage]]\ntype = 'write_arrow'\npath = '*_copy.arrow'\n";
    place.write("job.toml", job.as_bytes());
    assert_eq!(place.wavex(&["--quiet", "run", "job.toml", "--archive", "a"]), Outcome::success());
    // The list of libraries is long, and the folder is of this machine.
    let mut archive: Value = serde_json::from_str(&place.text("a/archive.json")).unwrap();
    archive["program"]["crates"].as_array_mut().unwrap().truncate(2);
    for files in ["inputs", "outputs"] {
        archive[files]["folder_was"] = "/flight".into();
    }
    place.write("a/archive.json", &serde_json::to_vec_pretty(&archive).unwrap());
    let read = |name: &str| fs::read(place.path(name)).unwrap();
    let names = ["a/archive.json", "a/job.toml", "a/job.resolved.toml", "a/results.b3"];
    let part = |name: &&str| [format!("{name}\n").into_bytes(), read(name)].concat();
    let all = |names: &[&str]| names.iter().map(part).collect::<Vec<_>>().join(SEPARATOR);
    add("archive_folder", "without_inputs", all(&names));
    add("archive_folder", "with_files", all(&[&names[..], &["in/a.arrow", "out/a_copy.arrow"]].concat()));
    let packed = names.map(|name| (name.trim_start_matches("a/").to_owned(), read(name)));
    add("archive_tar", "tar", tar(&packed));
    let long = (format!("{}/long.txt", "folder/".repeat(20)), b"a long name".to_vec());
    add("archive_tar", "long_name", tar(&[("archive.json".into(), b"{}".to_vec()), long]));
}

/// A tar of these files.
fn tar(files: &[(String, Vec<u8>)]) -> Vec<u8> {
    let mut tar = tar::Builder::new(Vec::new());
    for (name, bytes) in files {
        let mut header = tar::Header::new_gnu();
        header.set_size(bytes.len() as u64);
        header.set_mode(0o644);
        tar.append_data(&mut header, name, bytes.as_slice()).unwrap();
    }
    tar.into_inner().unwrap()
}

/// Points of a simulated flight in several formats.
fn points(add: &mut Add) {
    let place = flight();
    let mut job = "[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 1\nshots_per_line = 12\n\
                   [[stage]]\ntype = 'calibrate'\nload = 'in/model.json'\n[[stage]]\ntype = 'decompose'\n\
                   [[stage]]\ntype = 'georeference'\n"
        .to_owned();
    let outputs = [
        ("plain", "las", "version = '1.4'"),
        ("attributes", "laz", "version = '1.4'\nattribute_layout = '1.1'"),
        ("waveforms", "laz", "version = '1.4'\nwave_packets = 'internal'"),
    ];
    for (name, extension, keys) in outputs {
        job +=
            &format!("[[stage]]\ntype = 'write_las'\nid = '{name}'\npath = '{name}.{extension}'\n{keys}\n");
    }
    assert_eq!(place.run(&job), Outcome::success());
    for (name, extension, _) in outputs {
        let bytes = fs::read(place.path(&format!("out/{name}.{extension}"))).unwrap();
        add("copc", name, bytes.clone());
        add("las", name, bytes);
    }
}

/// Decomposed lines of a small flight in its map, and cells of two strips that overlap.
fn surveys(add: &mut Add) {
    let place = TestFolder::new();
    let job = "[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 4\nshots_per_line = 60\nhigh_power = true\n\
               [[stage]]\ntype = 'fuse_channels'\ngain_ratio = 0.1\ndelay_ns = 0.0\n\
               [[stage]]\ntype = 'calibrate'\nwaveforms = 200\nresponse = 'gaussian'\n\
               [[stage]]\ntype = 'decompose'\n[[stage]]\ntype = 'write_returns'\n";
    assert_eq!(place.run(job), Outcome::success());
    add("returns", "flight", fs::read(place.path("out/a_decomposed.arrow")).unwrap());
    let cells = |seed: u32| {
        let place = TestFolder::new();
        let job = format!(
            "survey_page = 'survey.html'\n[[stage]]\ntype = 'simulate'\nstem = 'a'\nseed = {seed}\n\
             scene_seed = 7\nflying_height_m = 200.0\nlines = 20\nshots_per_line = 60\n\
             [[stage]]\ntype = 'calibrate'\nwaveforms = 300\n[[stage]]\ntype = 'decompose'\n\
             [[stage]]\ntype = 'georeference'\n[[stage]]\ntype = 'write_table'\npath = '*.csv'\n"
        );
        assert_eq!(place.run(&job), Outcome::success());
        fs::read(place.path("out/a_cells.arrow")).unwrap()
    };
    add("survey_cells", "two_strips", joined(&[&cells(1), &cells(2)]));
}

/// Patches of a strip.
fn patches(add: &mut Add) {
    let place = TestFolder::new();
    let reader = "[[stage]]\ntype = 'read_arrow'\npath = '../in/a.arrow'\n";
    let make = "[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 20\nshots_per_line = 60\nflying_height_m = 120\n\
                speed_mps = 25\npulse_rate_hz = 3500\nsbet = '../in/*.out'\n\
                [[stage]]\ntype = 'write_arrow'\npath = '../in/*.arrow'\n";
    assert_eq!(place.run(make), Outcome::success());
    let job = format!(
        "geometry.trajectory = '../in/a.out'\n{reader}[[stage]]\ntype = 'calibrate'\nwaveforms = 300\n\
         [[stage]]\ntype = 'decompose'\n[[stage]]\ntype = 'georeference'\n[[stage]]\ntype = 'write_patches'\n"
    );
    assert_eq!(place.run(&job), Outcome::success());
    let strip = fs::read(place.path("out/a_patches.arrow")).unwrap();
    add("patches", "cut_off", strip[..strip.len() / 2].to_vec());
    add("patches", "strip", strip);
}

fn trajectories(add: &mut Add) {
    let time_s = |k: usize| 300_000.0 + k as f64 * 0.1;
    let sbet = |k: usize| SbetRecord {
        time_s: time_s(k),
        latitude_rad: 0.84 + k as f64 * 1e-6,
        longitude_rad: 0.26,
        height_m: 900.0,
        ..SbetRecord::default()
    };
    let of_sbet: Vec<u8> = (0..5).flat_map(|k| sbet(k).encode()).collect();
    let doubles = |values: &[f64]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let smrmsg: Vec<u8> = (0..5)
        .flat_map(|k| doubles(&[time_s(k), 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.6, 1.2, 6.0]))
        .collect();
    add("sbet", "alone", of_sbet.clone());
    add("sbet", "accuracies", joined(&[&of_sbet, &smrmsg]));
    add("accuracy", "smrmsg", smrmsg);
    let record = |k: usize| PofRecord {
        time_s: time_s(k),
        longitude_deg: 15.0 + k as f64 * 1e-5,
        latitude_deg: 48.0,
        altitude_m: 900.0,
        ..PofRecord::default()
    };
    let header = PofHeader { date: [2025, 5, 7], records: 5, ..PofHeader::default() };
    let pof = [header.encode(), (0..5).flat_map(|k| record(k).encode()).collect()].concat();
    let mut poq = b"RIEGL POSITION&ORIENTATION QUALITY\0".to_vec();
    poq.extend([1, 0, 1, 0]);
    poq.extend(67u32.to_le_bytes());
    poq.resize(67, 0);
    for k in 0..5 {
        poq.extend(doubles(&[time_s(k), 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 1.5]));
        poq.extend([8, 0, 6, 0]);
    }
    add("pof", "alone", pof.clone());
    add("pof", "accuracies", joined(&[&pof, &poq]));
    add("accuracy", "poq", poq);
    // Layouts: `crates/wavex-formats/src/trajectory`.
    let mut trj = b"TSCANTRJ".to_vec();
    [20_010_715, 32, 3, 64].iter().for_each(|field: &i32| trj.extend(field.to_le_bytes()));
    trj.resize(32, 0);
    for k in 0..3 {
        trj.extend(doubles(&[time_s(k), 500_000.0, 5_300_000.0, 900.0, 90.0, 0.5, -0.5]));
        trj.extend([0; 8]);
    }
    add("trj", "three_records", trj);
    let mut sol = Vec::new();
    for k in 0..3 {
        let mut record = vec![0xa5; 184];
        record[16..18].copy_from_slice(&2365u16.to_le_bytes());
        let fields =
            [(18, time_s(k)), (42, 0.84), (50, 0.26), (58, 900.0), (78, 0.01), (86, 0.02), (94, 1.5)];
        for (at, value) in fields {
            record[at..at + 8].copy_from_slice(&value.to_le_bytes());
        }
        record[34] = record[..34].iter().fold(0, |check, byte| check ^ byte);
        sol.extend(record);
    }
    add("sol", "three_records", sol);
    for (name, columns, text) in [
        (
            "blanks",
            "txyzwpk",
            "# time lon lat z roll pitch heading\n1 15 48 900 0.5 -0.5 90\n2 15.1 48 900 0 0 91\n",
        ),
        ("commas", "tyxzpks", "t,y,x,z,p,k,s\n1,48,15,900,0,90,x\n2,48,15.1,900,.1,91e0,y\n"),
    ] {
        add("trajectory_text", name, joined(&[columns.as_bytes(), text.as_bytes()]));
    }
}

/// Geoids, terrain models and coordinate reference systems.
fn maps(add: &mut Add) {
    let (mut big, mut little) = (Vec::new(), Vec::new());
    for degrees in [47.0f64, 15.0, 0.5, 0.5] {
        big.extend(degrees.to_be_bytes());
        little.extend(degrees.to_le_bytes());
    }
    for count in [2i32, 3] {
        big.extend(count.to_be_bytes());
        little.extend(count.to_le_bytes());
    }
    little.extend(1i32.to_le_bytes());
    for height_m in [44.0f32, 44.5, 45.0, 45.5, -88.8888, 46.5] {
        big.extend(height_m.to_be_bytes());
        little.extend(height_m.to_le_bytes());
    }
    add("geoid", "gtx", big);
    add("geoid", "ngs", little);
    let crs_wkt = wkt_of_epsg(32633);
    let bands = vec!["heights".to_owned()];
    let grid = RasterGrid { columns: 5, rows: 4, west: 0.0, north: 0.0, cell: 1.0, crs_wkt, bands };
    let mut writer = RasterWriter::new(grid, Vec::new());
    let mut tile = empty_tile();
    tile.iter_mut().step_by(256).take(4).for_each(|value| *value = 100.0);
    writer.tile(0, 0, tile).unwrap();
    let (spool, raster) = writer.finish().unwrap();
    let mut file = Vec::new();
    raster.assemble(&mut Cursor::new(spool), &mut file).unwrap();
    add("terrain_geotiff", "tiles", file);
    add("terrain_geotiff", "strips_i16", tiff(&[100, 101, 102, 103, 104, 105]));
    let rings = "[[[0, 0], [4, 0, 9.5], [4, 4], [0, 4], [0, 0]], [[1, 1], [2, 1], [2, 2], [1, 1]]]";
    let polygon = format!("{{\"type\": \"Polygon\", \"coordinates\": {rings}}}");
    let parts = format!("{{\"type\": \"MultiPolygon\", \"coordinates\": [{rings}]}}");
    let feature = format!("{{\"type\": \"Feature\", \"crs\": null, \"geometry\": {parts}}}");
    add(
        "geojson",
        "features",
        format!("{{\"type\": \"FeatureCollection\", \"features\": [{feature}]}}").into_bytes(),
    );
    add("geojson", "polygon", polygon.into_bytes());
    let ascii =
        "ncols 3\nnrows 2\nxllcorner 0\nyllcorner -4\ncellsize 2\nNODATA_value -9999\n1 2 3\n4 -9999 6\n";
    add("terrain_ascii", "corner", ascii.into());
    let centre = ascii.replace("corner", "center").replace("cellsize 2", "dx 2\ndy 1");
    add("terrain_ascii", "centre", centre.into_bytes());
    for code in [2056, 2154, 2263, 3035, 3857, 4326, 4978, 5514, 26918, 31256, 32633, 28992] {
        let Some(wkt) = wkt_of_epsg(code) else { continue };
        if let Some(keys) = geokeys::from_wkt(&wkt) {
            add("geokeys", &format!("epsg_{code}"), keys.directory);
        }
        add("wkt", &format!("epsg_{code}"), wkt.into_bytes());
    }
    for name in ["utm", "utm:33N", "EPSG:2154", "geodetic", "ecef"] {
        add("wkt", &name.replace(':', "_"), name.into());
    }
    add("wkt", "wkt2", WKT2.into());
}

const WKT2: &str = r#"PROJCRS["ETRS89 / UTM zone 33N",BASEGEOGCRS["ETRS89",DATUM["European Terrestrial Reference System 1989",ELLIPSOID["GRS 1980",6378137,298.257222101,LENGTHUNIT["metre",1]]],PRIMEM["Greenwich",0,ANGLEUNIT["degree",0.0174532925199433]],ID["EPSG",4258]],CONVERSION["UTM zone 33N",METHOD["Transverse Mercator",ID["EPSG",9807]],PARAMETER["Latitude of natural origin",0,ANGLEUNIT["degree",0.0174532925199433]],PARAMETER["Longitude of natural origin",15,ANGLEUNIT["degree",0.0174532925199433]],PARAMETER["Scale factor at natural origin",0.9996,SCALEUNIT["unity",1]],PARAMETER["False easting",500000,LENGTHUNIT["metre",1]],PARAMETER["False northing",0,LENGTHUNIT["metre",1]]],CS[Cartesian,2],AXIS["(E)",east,ORDER[1],LENGTHUNIT["metre",1]],AXIS["(N)",north,ORDER[2],LENGTHUNIT["metre",1]],ID["EPSG",25833]]"#;

/// A GeoTIFF of 3 by 2 heights of 16 bits in one strip, little-endian.
fn tiff(heights: &[i16; 6]) -> Vec<u8> {
    let keys: [u16; 16] = [1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 2, 3072, 0, 1, 32633];
    // Tag, type, count, value or offset of the values after the directory.
    let mut outside: Vec<u8> = Vec::new();
    let n_entries = 13u16;
    let first = 8 + 2 + 12 * u32::from(n_entries) + 4;
    let mut place = |bytes: Vec<u8>| {
        let at = first + outside.len() as u32;
        outside.extend(bytes);
        at
    };
    let doubles = |values: &[f64]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let strip = place(heights.iter().flat_map(|height| height.to_le_bytes()).collect());
    let scale = place(doubles(&[1.0, 1.0, 0.0]));
    let tie = place(doubles(&[0.0; 6]));
    let directory = place(keys.iter().flat_map(|key| key.to_le_bytes()).collect());
    let entries: [(u16, u16, u32, u32); 13] = [
        (256, 3, 1, 3),
        (257, 3, 1, 2),
        (258, 3, 1, 16),
        (259, 3, 1, 1),
        (262, 3, 1, 1),
        (273, 4, 1, strip),
        (277, 3, 1, 1),
        (278, 3, 1, 2),
        (279, 4, 1, 12),
        (339, 3, 1, 2),
        (33550, 12, 3, scale),
        (33922, 12, 6, tie),
        (34735, 3, 16, directory),
    ];
    let mut bytes = b"II\x2a\0\x08\0\0\0".to_vec();
    bytes.extend(n_entries.to_le_bytes());
    for (tag, kind, count, value) in entries {
        bytes.extend(tag.to_le_bytes());
        bytes.extend(kind.to_le_bytes());
        bytes.extend(count.to_le_bytes());
        bytes.extend(value.to_le_bytes());
    }
    bytes.extend([0; 4]);
    bytes.extend(outside);
    bytes
}

fn texts(add: &mut Add) {
    add("job", "example", example_job(STAGES).into_bytes());
    add(
        "job",
        "overrides",
        joined(&[FLIGHT_STAGES.as_bytes(), b"", b"decompose.mode='fast'\njob.threads=2\n"]),
    );
    let including = format!("[job]\ninclude = 'included.toml'\n{FLIGHT_STAGES}");
    let included = b"[job]\nsimd = 'auto'\n[decompose]\nmode = 'fastest'\n";
    add("job", "include", joined(&[including.as_bytes(), included]));
    for entry in fs::read_dir(root().join("jobs")).unwrap().map(Result::unwrap) {
        let name = entry.path().file_stem().unwrap().to_string_lossy().into_owned();
        add("job", &name, fs::read(entry.path()).unwrap());
    }
    for version in VERSIONS {
        let word = |takes: Takes| match takes {
            Takes::Switch => "1".to_owned(),
            Takes::Number => "0.5".to_owned(),
            Takes::Whole(least, _) => (least + 1).to_string(),
            Takes::Date => "2018-11-14".to_owned(),
            Takes::Text(_) => "txyzwpk".to_owned(),
            Takes::Texts(_) => "a.las\nb.las".to_owned(),
        };
        let options: Vec<String> =
            version.options.iter().map(|o| format!("-{}\n{}\n", o.name(), word(o.takes))).collect();
        add("import", &format!("all_{}", version.name), options.concat().into_bytes());
        for (number, some) in options.chunks(6).enumerate() {
            let line = format!("wavex\n-i\na.las\n-o\nb.laz\n{}", some.concat());
            add("import", &format!("some_{}_{number}", version.name), line.into_bytes());
        }
    }
    add("import", "file", joined(&[b"-i\na.sdf\n", b"det=6\n# comment\nodir out\n"]));
    add("lookup_tables", "columns", b"steps,low,high\n9,0.0,10.5\n68,9.75,\n255,19.7,39.7\n".to_vec());
    add("lookup_tables", "json", br#"{"low":[[9,0],[255,19.7,0.5]],"high":[[3,10.5],[255,39.7]]}"#.to_vec());
    let calibration =
        "lever_arm_m = [0.1, -0.2, 0.3]\nboresight_deg = [0.01, 0.02, 0.03]\ne0 = 0.1\ne5 = 1.0\n";
    add("calibration", "toml", calibration.into());
    add(
        "calibration",
        "numbers",
        b"# lever arm\n0.1 -0.2 0.3, 0.01 0.02 0.03\ne0: 0.1 0 0 0 0 0 0 0\n".to_vec(),
    );
    add("corrections", "two_strips", CORRECTIONS.into());
}

/// Corrections of two strips: a line, and a constant.
const CORRECTIONS: &str = "\
version = 1
time = \"week\"

[[strip]]
recording = \"a\"
first_s = 208800.0
last_s = 208860.5
knots = [
  { time_s = 208800.0, north_east_down_m = [0.01, -0.02, 0.005], roll_pitch_heading_deg = [0.001, 0.0, -0.002] },
  { time_s = 208860.5, north_east_down_m = [0.02, -0.01, 0.0] },
]

[[strip]]
recording = \"b\"
first_s = 209100.0
last_s = 209160.0
knots = [{ time_s = 209130.0, roll_pitch_heading_deg = [0.0, 0.003, 0.0] }]
";

/// Values of two records with two blocks each, as `examples/sdf_any_values` takes them.
fn any_values() -> Vec<u8> {
    let mut bytes = vec![0, 0];
    for text in ["LMS-Q680i", "9997", "WEEKSEC"] {
        bytes.push(text.len() as u8);
        bytes.extend(text.as_bytes());
    }
    bytes.extend(299_707_502.0f64.to_le_bytes());
    bytes.extend(1e-9f64.to_le_bytes());
    bytes.extend([1, 0, 4, 0]);
    for _ in 0..4 {
        bytes.extend([0, 2, 0]);
        [9.0f64, 255.0, 0.0, 19.7].iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    }
    for record in 0..2 {
        bytes.push(0);
        let time_s = 5.0 + f64::from(record) * 0.1;
        [time_s, 208_800.0 + time_s, 0.0, 0.0, 0.0, 0.0, 0.6, -0.8]
            .iter()
            .for_each(|value| bytes.extend(value.to_le_bytes()));
        bytes.extend([3, 0, 0, 0, 2, 0, 0]);
        for (start_s, channel) in [(-5e-9f64, 3), (4e-6, 1)] {
            bytes.extend(start_s.to_le_bytes());
            bytes.extend([channel, 40, 0, 7, 2, 0]);
        }
    }
    bytes
}
