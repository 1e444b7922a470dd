//! `write_dem`: terrain, surface and canopy of a flight line.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use tiff::decoder::{Decoder, DecodingResult};
use tiff::tags::Tag;
use wavex::registry;
use wavex::scan_line::{Blocks, Content, Emission, Frame, InputInfo, Return, ScanLine};
use wavex::stage::{Context, Plan, RunContext};
use wavex_geodesy::crs::wkt_of_epsg;
use wavex_testkit::TestFolder;
use wavex_testkit::engine_stages::stage;

const LINES: u32 = 60;
const SHOTS: u32 = 60;

/// A raster of less than 256 by 256 cells.
struct Raster {
    columns: usize,
    rows: usize,
    bands: usize,
    /// Edge of a cell, and west and north edge.
    cell: f64,
    corner: [f64; 2],
    values: Vec<f32>,
}

impl Raster {
    fn read(path: &Path) -> Raster {
        let mut decoder = Decoder::new(File::open(path).unwrap()).unwrap();
        let (columns, rows) = decoder.dimensions().unwrap();
        let cell = decoder.get_tag_f64_vec(Tag::ModelPixelScaleTag).unwrap()[0];
        let place = decoder.get_tag_f64_vec(Tag::ModelTiepointTag).unwrap();
        let (columns, rows) = (columns as usize, rows as usize);
        let bands = decoder.get_tag_u32(Tag::SamplesPerPixel).unwrap() as usize;
        // A tile without data is not stored.
        let values = match decoder.get_tag_u32_vec(Tag::TileByteCounts).unwrap()[..] {
            [0] => vec![-9999.0; columns * rows * bands],
            _ => match decoder.read_chunk(0).unwrap() {
                DecodingResult::F32(values) => values,
                _ => panic!(),
            },
        };
        Raster { columns, rows, bands, cell, corner: [place[3], place[4]], values }
    }

    /// Values of the cell of a position.
    fn at(&self, x: f64, y: f64) -> &[f32] {
        let column = ((x - self.corner[0]) / self.cell) as usize;
        let row = ((self.corner[1] - y) / self.cell) as usize;
        assert!(column < self.columns && row < self.rows);
        &self.values[(row * self.columns + column) * self.bands..][..self.bands]
    }

    fn has_data(&self) -> bool {
        self.values.iter().any(|value| *value != -9999.0)
    }
}

/// Whether a house 8 m high is here.
fn is_house(x: f64, y: f64) -> bool {
    (25.0..35.0).contains(&x) && (20.0..35.0).contains(&y)
}

/// Lines over a slope with a house, four returns per shot position in m², and a bird that is withheld; units of `info`.
fn lines(info: InputInfo, unit: f64) -> Vec<ScanLine> {
    let input = Arc::new(info);
    let line = |at: u32| {
        let (mut emissions, mut returns, mut points) = (Vec::new(), Vec::new(), Vec::new());
        for shot in 0..SHOTS {
            // Not on the edges of cells, and not on a raster.
            let wave = 0.2 * f64::from((at * 7 + shot * 13) % 10) / 10.0;
            let (x, y) = (f64::from(shot) + 0.3 + wave, f64::from(at) + 0.6 - wave);
            let is_bird = (at, shot) == (50, 10);
            let (z, class) = match is_house(x, y) {
                true => (8.0, 1),
                false if is_bird => (60.0, 18),
                false => (0.0, 2),
            };
            let noise = 0.02 * (f64::from((at * 31 + shot * 17) % 13) / 6.0 - 1.0);
            let z = z + 0.1 * x + if is_house(x, y) { 0.0 } else { noise };
            emissions.push(Emission {
                origin_m: [x, y, 500.0],
                direction: [0.0, 0.0, -1.0],
                ..Emission::default()
            });
            points.push([x, y, z].map(|value| value / unit));
            returns.push(Return {
                emission: shot,
                range_m: 500.0 - z,
                range_sd_m: 0.01,
                return_number: 1,
                number_of_returns: 1,
                withheld: is_bird,
                class,
                ..Return::default()
            });
        }
        let mut scan_line = ScanLine::of_shots(Arc::clone(&input), at, emissions, Blocks::default());
        scan_line.content = Content::Points(returns, points);
        scan_line
    };
    (0..LINES).map(line).collect()
}

fn map() -> InputInfo {
    InputInfo { frame: Frame::Map, ..InputInfo::default() }
}

fn change(lines: &mut [ScanLine], mut change: impl FnMut(&mut Return, &mut [f64; 3])) {
    for line in lines {
        if let Content::Points(returns, points) = &mut line.content {
            returns.iter_mut().zip(points).for_each(|(r, point)| change(r, point));
        }
    }
}

const ALL: &str = "path = 'terrain.tif'\nsurface = 'surface.tif'\ncanopy = 'canopy.tif'";

/// Runs the stage; rasters get their names in the folder.
fn written(place: &TestFolder, keys: &str, lines: &[ScanLine]) -> Result<Vec<String>, String> {
    let planned = stage(registry::find("write_dem").unwrap(), keys).planned;
    let Plan::Sink(sink) = planned.plan else { panic!() };
    let run = RunContext { output_dir: place.path(""), ..RunContext::alone("a.las".as_ref()) };
    let mut sink = sink.make(&run).map_err(|error| error.to_string())?;
    let mut cx = Context::default();
    for line in lines {
        sink.write(line, &mut cx).map_err(|error| error.to_string())?;
    }
    sink.finish(&mut cx).map_err(|error| error.to_string())?;
    let notes = cx.counters().notes.clone();
    for file in cx.take_files() {
        file.publish().unwrap();
    }
    Ok(notes)
}

#[test]
fn terrain_surface_and_canopy_have_the_same_cells() {
    let place = TestFolder::new();
    let mut known = lines(map(), 1.0);
    change(&mut known, |r, _| r.total_sd_m = 0.05);
    assert_eq!(written(&place, ALL, &known).unwrap(), [""; 0]);
    let [terrain, surface, canopy] =
        ["terrain.tif", "surface.tif", "canopy.tif"].map(|name| Raster::read(&place.path(name)));
    for raster in [&terrain, &surface, &canopy] {
        assert_eq!((raster.columns, raster.rows, raster.cell), (60, 60, 1.0));
        assert_eq!(raster.corner, [0.0, 60.0]);
    }
    assert_eq!([terrain.bands, surface.bands, canopy.bands], [4, 1, 1]);
    let &[height, sd, n, distance] = terrain.at(10.5, 40.5) else { panic!() };
    // The error that all points share is that of the points, not that of their mean.
    assert!((height - 1.05).abs() < 0.03 && (0.04..0.06).contains(&sd), "{height} {sd}");
    assert!(n == 1.0 && distance < 0.5, "{n} {distance}");
    let &[height, under_house_sd, n, distance] = terrain.at(30.5, 27.5) else { panic!() };
    assert!((height - 3.05).abs() < 0.2 && under_house_sd >= sd, "{height} {under_house_sd}");
    assert!(n == 0.0 && distance > 3.0);
    assert!((surface.at(30.5, 27.5)[0] - 11.05).abs() < 0.1);
    assert!((canopy.at(30.5, 27.5)[0] - 8.0).abs() < 0.2);
    // The bird is withheld: its cell has no first return.
    assert_eq!((surface.at(10.5, 50.5), canopy.at(10.5, 50.5)), (&[-9999.0][..], &[-9999.0][..]));
    assert!((1.0..1.2).contains(&terrain.at(10.5, 50.5)[0]));
    assert!(canopy.at(50.5, 50.5)[0].abs() < 0.1);

    // Without total uncertainties, the shared error is assumed.
    let notes = written(&place, "path = 'other.tif'", &lines(map(), 1.0)).unwrap();
    assert!(notes.len() == 1 && notes[0].contains("is assumed to be 5 cm"), "{notes:?}");
    assert!(!place.path("other_surface.tif").exists());
}

#[test]
fn heights_in_feet_stay_in_feet() {
    let place = TestFolder::new();
    let foot_m = 1200.0 / 3937.0;
    // NAD83 / California zone 5 (ftUS).
    let info = InputInfo { crs_wkt: wkt_of_epsg(2229), ..map() };
    written(&place, &format!("cell_m = 2.0\n{ALL}"), &lines(info, foot_m)).unwrap();
    let terrain = Raster::read(&place.path("terrain.tif"));
    assert!((terrain.cell - 2.0 / foot_m).abs() < 1e-9, "{}", terrain.cell);
    let &[height, sd, _, distance] = terrain.at(10.5 / foot_m, 40.5 / foot_m) else { panic!() };
    assert!((f64::from(height) - 1.1 / foot_m).abs() < 0.2, "{height}");
    assert!(f64::from(sd) > 0.04 / foot_m && distance < 1.0, "{sd} {distance}");
    let canopy = Raster::read(&place.path("canopy.tif")).at(30.5 / foot_m, 27.5 / foot_m)[0];
    assert!((f64::from(canopy) - 8.0 / foot_m).abs() < 1.0, "{canopy}");
}

#[test]
fn lines_without_ground_have_no_data_and_a_warning() {
    let place = TestFolder::new();
    let without = |class: u8| {
        let mut lines = lines(map(), 1.0);
        change(&mut lines, |r, _| (r.withheld, r.class) = (class == 18, class));
        lines
    };
    let expected = "no cell of the terrain model has data: there are no ground points";
    for class in [1, 18] {
        let notes = written(&place, ALL, &without(class)).unwrap();
        assert!(notes.len() == 1 && notes[0].contains(expected), "{notes:?}");
        let terrain = Raster::read(&place.path("terrain.tif"));
        assert!(!terrain.has_data() && !Raster::read(&place.path("canopy.tif")).has_data());
        let size = if class == 1 { (60, 60) } else { (1, 1) };
        assert_eq!((terrain.columns, terrain.rows), size);
        assert_eq!(Raster::read(&place.path("surface.tif")).has_data(), class == 1);
    }
    let notes = written(&place, ALL, &[]).unwrap();
    assert!(notes[0].contains(expected) && !Raster::read(&place.path("terrain.tif")).has_data());
    // One ground point: its cell alone, with an SD that is assumed.
    let mut one = without(1);
    change(&mut one[30..31], |r, _| r.class = if r.emission == 30 { 2 } else { 1 });
    let notes = written(&place, ALL, &one).unwrap();
    assert!(
        notes.iter().any(|note| note.contains("too few ground points to learn the roughness")),
        "{notes:?}"
    );
    let terrain = Raster::read(&place.path("terrain.tif"));
    let n = terrain.values.chunks_exact(4).filter(|cell| cell[0] != -9999.0).count();
    assert!(n == 1 && terrain.at(30.5, 30.5)[1] > 0.05, "{n}: {:?}", terrain.at(30.5, 30.5));
}

#[test]
fn points_outside_a_projected_map_are_refused() {
    let place = TestFolder::new();
    let message = |info: InputInfo| written(&place, ALL, &lines(info, 1.0)).unwrap_err();
    let degrees = message(InputInfo { crs_wkt: wkt_of_epsg(4326), ..map() });
    assert!(degrees.contains("these are in degrees; give [job.geometry] a projected `crs`"), "{degrees}");
    let scanner = message(InputInfo::default());
    assert!(scanner.contains("needs points in a map; give [job.geometry] a `trajectory`"), "{scanner}");
    // Absurd coordinates need too large a raster.
    let mut far = lines(map(), 1.0);
    change(&mut far[..1], |_, point| point[0] += 1e10);
    let message = written(&place, ALL, &far).unwrap_err();
    assert!(message.contains("cells are too many; set a larger `cell_m`"), "{message}");
    assert!(!place.path("terrain.tif").exists());
}

/// A run and `wavex classify --dem` of its points make the same model.
#[test]
fn a_run_writes_the_terrain_of_its_points() {
    let place = TestFolder::new();
    let job = |classify: &str| {
        format!(
            "[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 60\nshots_per_line = 250\nflying_height_m = 100.0\n\
             speed_mps = 240.0\n[[stage]]\ntype = 'calibrate'\nwaveforms = 300\n[[stage]]\ntype = 'decompose'\n\
             [[stage]]\ntype = 'georeference'\n[[stage]]\ntype = 'classify'\n{classify}\n\
             [[stage]]\ntype = 'write_las'\npath = '*.laz'\n[[stage]]\ntype = 'write_dem'\n{ALL}\n"
        )
    };
    let outcome = place.run(&job(""));
    assert_eq!(outcome.code, Some(0), "{}", outcome.err);
    let words = "classify out/a.laz -o b.laz --keep 1,2,7,18 --dem b.tif --surface c.tif --canopy d.tif";
    let outcome = place.wavex(&words.split(' ').collect::<Vec<_>>());
    assert_eq!(outcome.code, Some(0), "{}", outcome.err);
    let pairs = [("out/terrain.tif", "b.tif"), ("out/surface.tif", "c.tif"), ("out/canopy.tif", "d.tif")];
    for (of_run, of_cloud) in pairs {
        let [one, other] = [of_run, of_cloud].map(|name| Raster::read(&place.path(name)));
        assert!(one.has_data() && one.corner == other.corner && one.values.len() == other.values.len());
        let cells = one.values.chunks_exact(one.bands).zip(other.values.chunks_exact(one.bands));
        // Points of the cloud are rounded to millimetres, and so may be in the next cell.
        let differ = cells.filter(|(one, other)| (one[0] - other[0]).abs() > 0.02);
        let n = differ.count();
        println!("{of_run}: {n} of {} cells differ", one.values.len() / one.bands);
        assert!(n * 25 < one.values.len() / one.bands, "{of_run}: {n}");
    }
    let outcome = place.run(&job("ground = false"));
    assert!(
        outcome.code == Some(1)
            && outcome.err.contains("but `classify` has `ground = false`; remove that key"),
        "{}",
        outcome.err
    );
}
