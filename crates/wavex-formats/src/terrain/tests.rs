use std::io::Cursor;

use tiff::encoder::{TiffEncoder, colortype};
use tiff::tags::Tag;

use super::*;
use crate::geotiff::{RasterGrid, RasterWriter, TILE};

fn open(bytes: &[u8]) -> std::result::Result<Terrain, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("dtm");
    std::fs::write(&path, bytes).unwrap();
    Terrain::open(&path).map_err(|error| error.to_string().replace(&path.display().to_string(), "dtm"))
}

const GRID: &str = "ncols 3\nNROWS 2\nxllcorner 100\nyllcorner 200.0\ncellsize 10\nnodata_value -9999\n\
                    1 2 3\n4 5 -9999\n";

#[test]
fn an_ascii_grid_is_bilinear_between_the_middles_of_cells() {
    let terrain = open(GRID.as_bytes()).unwrap();
    // Cell centres: eastings 105, 115, 125; northings 215 (upper row), 205 (lower row).
    assert_eq!(terrain.height_m(105.0, 215.0), 1.0);
    assert_eq!(terrain.height_m(115.0, 205.0), 5.0);
    assert_eq!(terrain.height_m(110.0, 210.0), 3.0);
    assert_eq!(terrain.height_m(101.0, 219.0), 1.0, "the outer half of a cell");
    for (east, north) in [(99.0, 215.0), (131.0, 215.0), (115.0, 221.0), (115.0, 199.0), (f64::NAN, 205.0)] {
        assert!(terrain.height_m(east, north).is_nan(), "{east} {north}");
    }
    assert!(terrain.height_m(120.0, 208.0).is_nan(), "next to a cell without a height");
    assert_eq!((terrain.heights_m(), terrain.epsg()), ([1.0, 5.0], None));
    assert_eq!((terrain.size(), terrain.corners_m()), ([3, 2], [[100.0, 200.0], [130.0, 220.0]]));
    assert_eq!(terrain.values()[..5], [1.0, 2.0, 3.0, 4.0, 5.0]);
    assert!(terrain.values()[5].is_nan());
}

#[test]
fn a_grid_may_say_the_middle_of_its_corner_cell_and_two_steps() {
    let text = "ncols 2 nrows 2 xllcenter 0 yllcenter 0 dx 10 dy 20 1 2 3 4";
    let terrain = open(text.as_bytes()).unwrap();
    assert_eq!((terrain.height_m(0.0, 0.0), terrain.height_m(10.0, 20.0)), (3.0, 2.0));
}

#[test]
fn each_fault_of_a_grid_has_its_message() {
    let form = "give a GeoTIFF or an ESRI ASCII grid";
    let cut = "the file is cut off: copy it again from its source";
    let area = "crop it to the area of the recording, or resample it to a coarser grid";
    let long = "9".repeat(70);
    for (text, message) in [
        ("".to_owned(), format!("dtm: byte 0: header: the file ends before the first height; {form}")),
        (
            "hello 1".to_owned(),
            format!("dtm: byte 0: header: `hello` is not a header keyword of an ASCII grid; {form}"),
        ),
        ("ncols x".to_owned(), format!("dtm: byte 5: ncols: `x` is not a number; {form}")),
        (
            GRID.replace("cellsize 10\n", ""),
            format!("dtm: the header of the ASCII grid has no `cellsize`; {form}"),
        ),
        (GRID.replace("cellsize 10", "cellsize 0"), format!("dtm: invalid cell size 0 by 0 m; {form}")),
        (
            GRID.replace("ncols 3", "ncols 2.5"),
            format!(
                "dtm: the terrain model has 0 by 2 cells, but only 1 to 100000000 are \
                     supported; {area}"
            ),
        ),
        (
            GRID.replace("ncols 3", "ncols 4000000000"),
            format!(
                "dtm: the terrain model has 4000000000 by 2 cells, but only 1 to 100000000 are \
                 supported; {area}"
            ),
        ),
        (
            GRID.replace("ncols 3", "ncols 3000"),
            format!("dtm: the file is too short for 3000 by 2 cells; {cut}"),
        ),
        (
            GRID.replace("4 5 -9999\n", "4 5"),
            format!("dtm: byte 86: heights: the file ends after 5 of 6 heights; {cut}"),
        ),
        (GRID.replace("2 3", "2 three"), format!("dtm: byte 81: heights: `three` is not a number; {form}")),
        (
            GRID.replace("2 3", &format!("2 {long}")),
            format!("dtm: byte 80: text: a word longer than 64 bytes; {form}"),
        ),
        (
            "ncols 1 nrows 1 xllcorner 0 yllcorner 0 cellsize 5 NODATA_value 1 1".to_owned(),
            "dtm: the terrain model has no heights; give the terrain model of this area".to_owned(),
        ),
    ] {
        assert_eq!(open(text.as_bytes()).unwrap_err(), message, "{text}");
    }
}

/// Georeferencing tags of a GeoTIFF.
struct Tags {
    scale: Vec<f64>,
    tie: Vec<f64>,
    keys: Vec<u16>,
    nodata: Option<&'static str>,
}

impl Default for Tags {
    fn default() -> Tags {
        Tags {
            scale: vec![10.0, 10.0, 0.0],
            tie: vec![0.0, 0.0, 0.0, 100.0, 220.0, 0.0],
            keys: vec![1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 32633],
            nodata: Some("-9999"),
        }
    }
}

fn tiff_of<C: colortype::ColorType<Inner = T>, T>(heights: &[T], width: u32, tags: &Tags) -> Vec<u8>
where
    [T]: tiff::encoder::TiffValue,
{
    let mut bytes = Cursor::new(Vec::new());
    let mut tiff = TiffEncoder::new(&mut bytes).unwrap();
    let mut image = tiff.new_image::<C>(width, 2).unwrap();
    let directory = image.encoder();
    if !tags.scale.is_empty() {
        directory.write_tag(Tag::ModelPixelScaleTag, &tags.scale[..]).unwrap();
    }
    if !tags.tie.is_empty() {
        directory.write_tag(Tag::ModelTiepointTag, &tags.tie[..]).unwrap();
    }
    directory.write_tag(Tag::GeoKeyDirectoryTag, &tags.keys[..]).unwrap();
    if let Some(nodata) = tags.nodata {
        directory.write_tag(Tag::GdalNodata, nodata).unwrap();
    }
    image.write_data(heights).unwrap();
    bytes.into_inner()
}

const HEIGHTS: [f32; 6] = [1.0, 2.0, 3.0, 4.0, 5.0, -9999.0];

#[test]
fn a_geotiff_is_the_same_as_the_grid() {
    let grid = open(GRID.as_bytes()).unwrap();
    let tiff = open(&tiff_of::<colortype::Gray32Float, _>(&HEIGHTS, 3, &Tags::default())).unwrap();
    assert_eq!(tiff.epsg(), Some(32633));
    for (east, north) in [(105.0, 215.0), (111.0, 209.0), (101.0, 219.0)] {
        assert_eq!(tiff.height_m(east, north), grid.height_m(east, north));
    }
    assert!(tiff.height_m(125.0, 205.0).is_nan());
    let point = Tags { keys: vec![1, 1, 0, 1, 1025, 0, 1, 2], ..Tags::default() };
    let tiff = open(&tiff_of::<colortype::Gray32Float, _>(&HEIGHTS, 3, &point)).unwrap();
    assert_eq!((tiff.height_m(100.0, 220.0), tiff.epsg()), (1.0, None));
    let whole = [1i16, 2, 3, 4, 5, -9999];
    let tiff = open(&tiff_of::<colortype::GrayI16, _>(&whole, 3, &Tags::default())).unwrap();
    assert_eq!(tiff.heights_m(), [1.0, 5.0]);
}

#[test]
fn each_fault_of_a_geotiff_has_its_message() {
    let remedy = "convert it to a north-up GeoTIFF with one band of heights";
    let gray = |tags: &Tags| open(&tiff_of::<colortype::Gray32Float, _>(&HEIGHTS, 3, tags)).unwrap_err();
    let no_scale = Tags { scale: Vec::new(), ..Tags::default() };
    assert_eq!(gray(&no_scale), format!("dtm: the GeoTIFF has no cell size (ModelPixelScale); {remedy}"));
    let no_tie = Tags { tie: Vec::new(), ..Tags::default() };
    assert_eq!(gray(&no_tie), format!("dtm: the GeoTIFF has no tie point (ModelTiepoint); {remedy}"));
    let flat = Tags { scale: vec![10.0, -10.0, 0.0], ..Tags::default() };
    assert_eq!(gray(&flat), format!("dtm: invalid cell size 10 by -10 m; {remedy}"));
    let rgb = tiff_of::<colortype::RGB8, u8>(&[7; 18], 3, &Tags::default());
    assert_eq!(open(&rgb).unwrap_err(), format!("dtm: the GeoTIFF has more than one band; {remedy}"));
    let long = tiff_of::<colortype::Gray64, u64>(&[7; 6], 3, &Tags::default());
    assert_eq!(
        open(&long).unwrap_err(),
        format!("dtm: the sample type of the GeoTIFF is not supported for heights; {remedy}")
    );
    let error = open(b"II*\0\x08\0").unwrap_err();
    assert!(error.starts_with("dtm: cannot read the GeoTIFF: ") && error.ends_with(remedy), "{error}");
}

/// Tiles of 256 cells: three by three, the outer ones incomplete.
#[test]
fn a_tiled_geotiff_has_its_heights_in_place() {
    let grid = RasterGrid {
        columns: 600,
        rows: 530,
        west: 100.0,
        north: 220.0,
        cell: 10.0,
        crs_wkt: None,
        bands: vec![String::new()],
    };
    let height = |column: usize, row: usize| (column + 1000 * row) as f32 / 128.0;
    let mut writer = RasterWriter::new(grid, Cursor::new(Vec::new()));
    for (row, column) in (0..3).flat_map(|row| (0..3).map(move |column| (row, column))) {
        let cell = |at: usize| height(column * TILE + at % TILE, row * TILE + at / TILE);
        let tile = (0..TILE * TILE).map(cell).collect();
        writer.tile(row as u32, column as u32, tile).unwrap();
    }
    let (mut spool, raster) = writer.finish().unwrap();
    let mut bytes = Vec::new();
    raster.assemble(&mut spool, &mut bytes).unwrap();
    let terrain = open(&bytes).unwrap();
    for (column, row) in [(0, 0), (599, 0), (255, 256), (512, 512), (599, 529), (3, 529)] {
        let (east, north) = (105.0 + 10.0 * column as f64, 215.0 - 10.0 * row as f64);
        assert_eq!(terrain.height_m(east, north), f64::from(height(column, row)), "{column}, {row}");
    }
}

#[test]
fn bands_are_read_one_by_one() {
    let bands = ["height, m", "SD <m>", ""].map(str::to_owned).to_vec();
    let grid =
        RasterGrid { columns: 300, rows: 200, west: 100.0, north: 220.0, cell: 1.0, crs_wkt: None, bands };
    let value = |column: usize, band: usize| (column + 1000 * band) as f32;
    let mut writer = RasterWriter::new(grid, Cursor::new(Vec::new()));
    for column in 0..2 {
        let cell = |at: usize| value(column * TILE + at / 3 % TILE, at % 3);
        writer.tile(0, column as u32, (0..TILE * TILE * 3).map(cell).collect()).unwrap();
    }
    let (mut spool, raster) = writer.finish().unwrap();
    let mut bytes = Vec::new();
    raster.assemble(&mut spool, &mut bytes).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("dtm.tif");
    std::fs::write(&path, &bytes).unwrap();
    assert_eq!(Terrain::band_descriptions(&path).unwrap(), ["height, m", "SD &lt;m>", ""]);
    for band in 0..3 {
        let terrain = Terrain::open_band(&path, band).unwrap();
        assert_eq!(terrain.size(), [300, 200]);
        for (at, column) in [(0, 0), (299, 299), (300 * 199 + 256, 256)] {
            assert_eq!(terrain.values()[at], value(column, band), "{at}");
        }
    }
    let problem = |opened: Result<Terrain>| opened.unwrap_err().to_string();
    assert!(problem(Terrain::open_band(&path, 3)).contains("the GeoTIFF has no band 4"));
    assert!(problem(Terrain::open(&path)).contains("the GeoTIFF has more than one band"));
    std::fs::write(&path, &bytes[..300]).unwrap();
    assert!(Terrain::band_descriptions(&path).is_err() && Terrain::open_band(&path, 0).is_err());
}

#[test]
fn a_strip_much_larger_than_its_file_is_refused() {
    let heights = vec![7.0; (1 << 23) + (1 << 12)];
    let mut bytes = Cursor::new(Vec::new());
    let mut tiff = TiffEncoder::new(&mut bytes).unwrap().with_compression(tiff::encoder::Compression::Lzw);
    let mut image = tiff.new_image::<colortype::Gray64Float>(1 << 12, (1 << 11) + 1).unwrap();
    let tags = Tags::default();
    image.encoder().write_tag(Tag::ModelPixelScaleTag, &tags.scale[..]).unwrap();
    image.encoder().write_tag(Tag::ModelTiepointTag, &tags.tie[..]).unwrap();
    image.rows_per_strip((1 << 11) + 1).unwrap();
    image.write_data(&heights).unwrap();
    let error = open(&bytes.into_inner()).unwrap_err();
    assert_eq!(error, "dtm: a strip or tile of the GeoTIFF has over 67108864 bytes; write it with tiles");
}

#[test]
fn a_cut_geotiff_is_an_error_at_every_length() {
    let whole = tiff_of::<colortype::Gray32Float, _>(&HEIGHTS, 3, &Tags::default());
    for length in 0..whole.len() {
        // The image may be anywhere in the file: missing data must never be invented.
        if let Ok(terrain) = open(&whole[..length]) {
            assert_eq!(terrain, open(&whole).unwrap(), "{length}");
        }
    }
}

#[test]
fn a_beam_meets_the_first_slope_it_comes_to() {
    // A wall of 50 m in the fourth of eight columns of 10 m.
    let text = "ncols 8 nrows 2 xllcenter 0 yllcenter 0 cellsize 10 0 0 0 50 0 0 0 0 0 0 0 50 0 0 0 0";
    let terrain = open(text.as_bytes()).unwrap();
    let range = |east: f64, beam: [f64; 3]| terrain.range_m([east, 5.0, 100.0], beam, [1.0, 1000.0]);
    let down = [0.0, 0.0, -1.0];
    assert!((range(5.0, down) - 100.0).abs() < 0.1);
    assert!((range(30.0, down) - 50.0).abs() < 0.1);
    assert!((range(25.0, down) - 75.0).abs() < 0.1);
    // A slanted beam from beyond the wall hits the crest, not the ground on its far side.
    let slant = [-0.6, 0.0, -0.8];
    let met = range(76.0, slant);
    let (east, up) = (76.0 - 0.6 * met, 100.0 - 0.8 * met);
    assert!((terrain.height_m(east, 5.0) - up).abs() < 0.6 && up > 20.0, "{met} {up}");
    for (east, beam) in [
        (200.0, down),
        (5.0, [0.0, 0.0, 1.0]),
        (5.0, [1.0, 0.0, 0.0]),
        (5.0, [f64::NAN; 3]),
        (5.0, [-0.9, 0.0, -0.4]),
    ] {
        assert!(range(east, beam).is_nan(), "{east} {beam:?}");
    }
    assert!(terrain.range_m([5.0, 5.0, 100.0], down, [1.0, 60.0]).is_nan(), "beyond the range");
}
