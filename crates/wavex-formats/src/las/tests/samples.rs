//! Reads real files, located by `WAVEX_DATA`.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use crate::las::{GpsTime, Point, Reader, Wave};

/// Returns the folder of real files, if set.
fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("WAVEX_DATA").map(PathBuf::from);
    if folder.is_none() {
        println!("skipped: WAVEX_DATA not set");
    }
    folder
}

/// Reads all points of a file with their extra bytes.
fn read_all(path: &Path) -> Vec<(Point, Vec<u8>)> {
    let mut reader = Reader::open(path).unwrap();
    let (mut points, mut point) = (Vec::new(), Point::default());
    while reader.next_point(&mut point).unwrap() {
        points.push((point.clone(), reader.extra_bytes().to_vec()));
    }
    points
}

/// Reads all points of an uncompressed file with the `las` crate.
fn oracle(path: &Path) -> Vec<las::raw::Point> {
    let bytes = fs::read(path).unwrap();
    let header = las::raw::Header::read_from(Cursor::new(&bytes)).unwrap();
    let mut format = las::point::Format::new(header.point_data_record_format).unwrap();
    format.extra_bytes = header.point_data_record_length - format.len();
    let mut cursor = Cursor::new(&bytes[header.offset_to_point_data as usize..]);
    let mut points = Vec::new();
    while (cursor.position() as usize) < cursor.get_ref().len() {
        points.push(las::raw::Point::read_from(&mut cursor, &format).unwrap());
    }
    points
}

fn assert_same(ours: &(Point, Vec<u8>), theirs: &las::raw::Point) {
    let (point, extra) = ours;
    let flags = &theirs.flags;
    assert_eq!(point.raw, [theirs.x, theirs.y, theirs.z]);
    assert_eq!(point.intensity, theirs.intensity);
    assert_eq!(point.return_number, flags.return_number());
    assert_eq!(point.number_of_returns, flags.number_of_returns());
    assert_eq!(point.scan_direction, flags.scan_direction() == las::point::ScanDirection::LeftToRight);
    assert_eq!(point.edge_of_flight_line, flags.is_edge_of_flight_line());
    assert_eq!(point.synthetic, flags.is_synthetic());
    assert_eq!(point.key_point, flags.is_key_point());
    assert_eq!(point.withheld, flags.is_withheld());
    assert_eq!(point.scanner_channel, flags.scanner_channel());
    match flags {
        las::raw::point::Flags::TwoByte(_, class) => assert_eq!(point.classification, class & 31),
        las::raw::point::Flags::ThreeByte(_, bits, class) => {
            assert_eq!((point.classification, point.overlap), (*class, bits & 8 != 0));
        }
    }
    let angle_deg = match theirs.scan_angle {
        las::raw::point::ScanAngle::Rank(rank) => f32::from(rank),
        las::raw::point::ScanAngle::Scaled(steps) => (f64::from(steps) * 0.006) as f32,
    };
    assert_eq!(point.scan_angle_deg, angle_deg);
    assert_eq!(point.user_data, theirs.user_data);
    assert_eq!(point.point_source_id, theirs.point_source_id);
    // These files contain arbitrary bits, including NaN.
    assert_eq!(Some(point.gps_time.to_bits()), theirs.gps_time.map(f64::to_bits));
    let (wave, their_wave) = (point.wave, theirs.waveform.unwrap());
    assert_eq!(wave.descriptor, their_wave.wave_packet_descriptor_index);
    assert_eq!(wave.offset, their_wave.byte_offset_to_waveform_data);
    assert_eq!(wave.size, their_wave.waveform_packet_size_in_bytes);
    assert_eq!(wave.location_ps.to_bits(), their_wave.return_point_waveform_location.to_bits());
    let their_direction = [their_wave.x_t, their_wave.y_t, their_wave.z_t];
    assert_eq!(wave.direction_per_ps.map(f32::to_bits), their_direction.map(f32::to_bits));
    assert_eq!(*extra, theirs.extra_bytes);
}

#[test]
fn las_and_laz_twins_hold_the_points_that_the_las_crate_reads() {
    let Some(data) = data() else { return };
    for name in ["pdrf4-1.3", "pdrf5-1.3", "pdrf9-1.4", "pdrf10-1.4"] {
        let las = data
            .join("las_wavepackets")
            .join(name)
            .with_extension(format!("{}.las", &name[name.len() - 1..]));
        let laz = las.with_extension("laz");
        let (ours, twin, theirs) = (read_all(&las), read_all(&laz), oracle(&las));
        assert_eq!(ours.len(), 1024, "{name}");
        assert_eq!(theirs.len(), 1024, "{name}");
        ours.iter().zip(&theirs).for_each(|(ours, theirs)| assert_same(ours, theirs));
        assert_eq!(format!("{ours:?}"), format!("{twin:?}"), "{name}: LAS and LAZ differ");
    }
}

#[test]
fn las_1_5_is_read() {
    let Some(data) = data() else { return };
    for name in ["pdrf9-1.5.las", "pdrf10-1.5.las"] {
        let path = data.join("las_wavepackets").join(name);
        let header = Reader::open(&path).unwrap().header().clone();
        assert_eq!((header.version, header.header_size, header.gps_time()), ((1, 5), 393, GpsTime::Week));
        let (ours, theirs) = (read_all(&path), oracle(&path));
        assert_eq!((ours.len(), theirs.len()), (1024, 1024));
        ours.iter().zip(&theirs).for_each(|(ours, theirs)| assert_same(ours, theirs));
    }
}

#[test]
fn a_file_whose_waveforms_are_missing_says_so() {
    let Some(data) = data() else { return };
    let path = data.join("las_wavepackets").join("fullwave.laz");
    let error = Reader::open(&path).err().unwrap();
    let expected = "its waveforms are missing: neither inside the file nor in `fullwave.wdp` next \
                    to it";
    assert!(error.to_string().contains(expected), "{error}");
}

#[test]
fn a_recording_says_what_it_is() {
    let Some(data) = data() else { return };
    let reader = Reader::open(&data.join("riegl_q680i_dev").join("riegl_q680i_dev.las")).unwrap();
    let header = reader.header();
    assert_eq!((header.version, header.point_format, header.record_length), ((1, 4), 9, 63));
    assert_eq!((header.n_points, header.n_vlrs, header.n_evlrs), (667, 105, 0));
    assert_eq!(header.n_points_by_return[..5], [606, 58, 3, 0, 0]);
    assert_eq!(header.generating_software, "RiPROCESS 1.6.5.664");
    assert_eq!((header.creation_day, header.creation_year), (188, 2015));
    assert_eq!(header.gps_time(), GpsTime::Week);
    let descriptor = |index| reader.descriptor(&Wave { descriptor: index, ..Default::default() });
    let lengths = (1..=255u8).filter_map(|index| descriptor(index).ok()).map(|found| found.samples);
    assert_eq!(lengths.collect::<Vec<_>>(), [60, 120], "98 more are empty");
    // The file has a WKT, although its header does not declare it.
    assert!(!header.says_wkt() && reader.crs().wkt.unwrap().starts_with("PROJCS[\"UTM_North zone 33\""));
    assert_eq!(reader.projection(34735).unwrap().data.len(), 208);
    let extra: Vec<_> =
        reader.extra_bytes_descriptors().iter().map(|e| (e.name.as_str(), e.start, e.bytes)).collect();
    assert_eq!(extra, [("Amplitude", 0, 2), ("Pulse width", 2, 2)]);
}

/// Reads a column of a CSV table by name.
fn column(table: &str, name: &str) -> Vec<f64> {
    let mut lines = table.lines();
    let index = lines.next().unwrap().split(',').position(|other| other == name).unwrap();
    lines.map(|line| line.split(',').nth(index).unwrap().parse().unwrap()).collect()
}

#[test]
fn a_recording_agrees_with_the_vendors_table() {
    let Some(data) = data() else { return };
    let folder = data.join("riegl_q680i_dev");
    let table = fs::read_to_string(folder.join("riegl_q680i_dev_vendor_returns.csv")).unwrap();
    let columns = ["x", "y", "z", "wave_location_ps", "wave_offset", "wave_size", "return_number"];
    let expected = columns.map(|name| column(&table, name));
    let points = read_all(&folder.join("riegl_q680i_dev.las"));
    assert_eq!((points.len(), expected[0].len()), (667, 667));
    for (row, (point, _)) in points.iter().enumerate() {
        for (coordinate, expected) in [point.x, point.y, point.z].iter().zip(&expected) {
            assert!((coordinate - expected[row]).abs() < 1e-6, "{row}: {point:?}");
        }
        // The table has three decimals.
        assert!((f64::from(point.wave.location_ps) - expected[3][row]).abs() <= 0.001, "{row}: {point:?}");
        assert_eq!(point.wave.offset as f64, expected[4][row]);
        assert_eq!(f64::from(point.wave.size), expected[5][row]);
        assert_eq!(f64::from(point.return_number), expected[6][row]);
    }
}

#[test]
fn returns_of_one_pulse_have_one_anchor() {
    let Some(data) = data() else { return };
    let points = read_all(&data.join("riegl_q680i_dev").join("riegl_q680i_dev.las"));
    let (mut pairs, mut worst_ours, mut worst_other) = (0, 0.0f64, 0.0f64);
    for pair in points.windows(2) {
        let [a, b] = [&pair[0].0, &pair[1].0];
        assert!(a.wave.direction_per_ps[2] > 0.0, "the vector points up, to the sensor");
        if a.wave.offset != b.wave.offset {
            continue;
        }
        let gap = |sign: f64| {
            let [a, b] = [a, b].map(|p| {
                let wave = Wave { location_ps: sign as f32 * p.wave.location_ps, ..p.wave };
                wave.sample_position([p.x, p.y, p.z], 0.0, 1000.0)
            });
            a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
        };
        pairs += 1;
        worst_ours = worst_ours.max(gap(1.0));
        worst_other = worst_other.max(gap(-1.0));
    }
    println!("{pairs} pairs: anchors within {worst_ours:.4} m, with the other sign {worst_other:.2} m");
    assert!(pairs > 50);
    assert!(worst_ours < 0.005, "{worst_ours}");
}

/// Returns the peak position in samples.
///
/// The vertex of the parabola through the strongest sample and its neighbours.
fn peak(samples: &[u16]) -> f64 {
    let (mut at, mut strongest) = (0, 0);
    for (i, &sample) in samples.iter().enumerate() {
        if sample > strongest {
            (at, strongest) = (i, sample);
        }
    }
    let [before, top, after] = [at - 1, at, at + 1].map(|i| f64::from(samples[i]));
    at as f64 + 0.5 * (before - after) / (before - 2.0 * top + after)
}

#[test]
fn packets_hold_the_samples_of_the_pulsewaves_twin() {
    let Some(data) = data() else { return };
    let folder = data.join("riegl_q680i_dev");
    let waves = fs::read(folder.join("riegl_q680i_dev.wvs")).unwrap();
    let mut reader = Reader::open(&folder.join("riegl_q680i_dev.las")).unwrap();
    let (mut point, mut samples, mut n, mut from) = (Point::default(), Vec::new(), 0, 0);
    let (mut last_offset, mut singles, mut sum_ps) = (0, 0, 0.0);
    while reader.next_point(&mut point).unwrap() {
        let descriptor = reader.packet(&point.wave, &mut samples).unwrap();
        assert_eq!((descriptor.bits, descriptor.spacing_ps), (16, 1000));
        assert_eq!(samples.len(), point.wave.size as usize / 2);
        // The twin has the same samples as bytes, in the order of the shots.
        let bytes: Vec<u8> = samples.iter().map(|&sample| u8::try_from(sample).unwrap()).collect();
        if point.wave.offset != last_offset {
            let at = waves[from..].windows(bytes.len()).position(|window| window == bytes);
            from += at.unwrap_or_else(|| panic!("packet of point {n} is not in the twin"));
            last_offset = point.wave.offset;
        }
        assert_eq!(waves[from..from + bytes.len()], bytes);
        if point.number_of_returns == 1 {
            let gap_ps =
                f64::from(point.wave.location_ps) - f64::from(descriptor.spacing_ps) * peak(&samples);
            assert!(gap_ps.abs() < 600.0, "point {n}: {gap_ps} ps");
            sum_ps += gap_ps;
            singles += 1;
        }
        n += 1;
    }
    assert_eq!((n, singles), (667, 549));
    // Locations count from the first sample. The vendor subtracts the position of the outgoing
    // pulse, a fraction of up to half a sample. Single gaps are therefore inconclusive, but they
    // average out.
    let mean_ps = sum_ps / f64::from(singles);
    assert!(mean_ps.abs() < 50.0, "{mean_ps} ps");
}

/// Opens a file and reads all points and packets.
///
/// Ignores errors of single packets.
fn read_through(path: &Path) -> crate::Result<usize> {
    let mut reader = Reader::open(path)?;
    let (mut point, mut samples, mut n) = (Point::default(), Vec::new(), 0);
    while reader.next_point(&mut point)? {
        let _ = reader.packet(&point.wave, &mut samples);
        n += 1;
    }
    Ok(n)
}

fn sample_files(data: &Path) -> Vec<PathBuf> {
    let mut files = vec![data.join("riegl_q680i_dev").join("riegl_q680i_dev.las")];
    for name in ["pdrf4-1.3", "pdrf5-1.3", "pdrf9-1.4", "pdrf10-1.4", "pdrf9-1.5", "pdrf10-1.5"] {
        for extension in ["las", "laz"] {
            let path = data.join("las_wavepackets").join(format!("{name}.{extension}"));
            files.extend(path.is_file().then_some(path));
        }
    }
    files
}

/// Returns the path for a copy of `source` in `folder`, with the waveform file already copied.
fn place_for(source: &Path, folder: &Path) -> PathBuf {
    let copy = folder.join(source.file_name().unwrap());
    let wdp = source.with_extension("wdp");
    if wdp.is_file() {
        fs::copy(&wdp, copy.with_extension("wdp")).unwrap();
    }
    copy
}

#[test]
fn a_file_cut_anywhere_is_an_error() {
    let Some(data) = data() else { return };
    let folder = tempfile::tempdir().unwrap();
    for source in sample_files(&data) {
        let bytes = fs::read(&source).unwrap();
        let cut = place_for(&source, folder.path());
        let inside = (0..bytes.len()).step_by(bytes.len() / 100);
        for length in inside.chain([226, 234, 374, bytes.len() - 1]) {
            fs::write(&cut, &bytes[..length]).unwrap();
            let read = read_through(&cut);
            assert!(read.is_err(), "{} cut to {length} of {}: {read:?}", source.display(), bytes.len());
            let text = read.unwrap_err().to_string();
            assert!(text.starts_with(&format!("{}: ", cut.display())), "{text}");
        }
    }
}

#[test]
fn a_damaged_file_never_panics() {
    let Some(data) = data() else { return };
    let folder = tempfile::tempdir().unwrap();
    for source in sample_files(&data) {
        let bytes = fs::read(&source).unwrap();
        let copy = place_for(&source, folder.path());
        let mut refused = 0;
        for step in 0..50 {
            let mut damaged = bytes.clone();
            // Damage the header, the records after it, the points and the end, with bits that
            // produce large numbers.
            let at = if step % 2 == 0 { step * 40 } else { step * bytes.len() / 50 };
            damaged.iter_mut().skip(at).take(4).for_each(|byte| *byte ^= 0xa5);
            fs::write(&copy, &damaged).unwrap();
            refused += usize::from(read_through(&copy).is_err());
        }
        assert!((1..50).contains(&refused), "{}: {refused} of 50 refused", source.display());
    }
}
