//! Errors of the writer.

use super::*;

#[test]
fn invalid_options_are_refused() {
    let new = |name: &str, options: &WriterOptions| {
        Writer::new(Cursor::new(Vec::new()), Path::new(name), options).err().unwrap().to_string()
    };
    let good = options(&[]);
    assert_eq!(
        new("a.ply", &good),
        "a.ply: the extension is neither `las` nor `laz`; give the output one of them"
    );
    assert_eq!(
        new("a.las", &WriterOptions { scale: [0.01, 0.0, 0.01], ..good.clone() }),
        "a.las: the scale [0.01, 0.0, 0.01] is not positive; give a scale like 0.001"
    );
    assert_eq!(
        new("a.las", &WriterOptions { offset: [0.0, f64::NAN, 0.0], ..good.clone() }),
        "a.las: the offset [0.0, NaN, 0.0] is not finite; give an offset near the points"
    );
    assert_eq!(
        new("a.las", &options(&[AMP, CHANNEL, AMP])),
        "a.las: the extra attribute Amp is listed twice; give it once"
    );
    assert_eq!(
        new("a.las", &WriterOptions { index: IndexPlace::Appended, ..good.clone() }),
        "a.las: an index can be appended only to compressed points; write LAZ, or a separate index \
         file"
    );
    assert_eq!(
        new("a.las", &WriterOptions { wkt: Some(&"x".repeat(65_535)), ..good }),
        "a.las: OGC coordinate system WKT: more than the 65535 bytes that a LAS record may have; \
         give a shorter WKT, or fewer extra attributes"
    );
}

#[test]
fn a_point_out_of_range_is_reported_and_skipped() {
    let mut writer = Writer::new(Cursor::new(Vec::new()), Path::new("a.las"), &options(&[CHANNEL])).unwrap();
    let good = PointOut { x: 1000.0, y: -2000.0, ..PointOut::default() };
    let mut write =
        |point: &PointOut, extra: &[u8]| writer.write_point(point, extra).map_err(|e| e.to_string());
    assert_eq!(write(&good, &[1]), Ok(()));
    assert_eq!(
        write(&good, &[1, 2]),
        Err("a.las: point 1 has 2 extra bytes, but the attributes need 1; give each attribute of \
             the options once, in order"
            .into())
    );
    assert_eq!(
        write(&PointOut { y: 3e6, ..good.clone() }, &[1]),
        Err("a.las: point 1 at [1000.0, 3000000.0, 0.0] cannot be stored: y = 3000000 is too far from the offset \
             -2000 for steps of 0.001; choose an offset near the points, or a larger scale"
            .into())
    );
    for bad in [f64::NAN, f64::INFINITY, -1e300] {
        assert!(write(&PointOut { z: bad, ..good.clone() }, &[1]).is_err());
    }
    let largest = f64::from(i32::MAX) * 0.002;
    assert_eq!(write(&PointOut { z: largest, ..good }, &[1]), Ok(()));
    let bytes = writer.finish().unwrap().into_inner();
    assert_eq!((u64_at(&bytes, 247), f64_at(&bytes, 211)), (2, largest));
}

#[test]
fn a_failing_sink_is_an_error() {
    let mut small = [0u8; 400];
    let mut writer = Writer::new(
        Cursor::new(&mut small[..]),
        Path::new("a.laz"),
        &WriterOptions { wkt: None, ..options(&[]) },
    );
    let error = match &mut writer {
        Ok(_) => panic!("400 bytes hold no header, record and points"),
        Err(error) => error.to_string(),
    };
    assert_eq!(error, "a.laz: cannot write: failed to write whole buffer");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn las_and_laz_read_back_as_they_were_written(
        points in prop::collection::vec(any_point(), 1..40),
        extra in any::<[u8; 3]>(),
    ) {
        let options = options(&[AMP, CHANNEL]);
        let las = write("a.las", &options, &points, &extra);
        let (header, plain) = records(&las);
        let (_, compressed) = records(&write("a.laz", &options, &points, &extra));
        prop_assert_eq!(&plain, &compressed);
        let mut back = Point::default();
        let (mut min, mut max) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for (written, record) in points.iter().zip(plain.chunks_exact(33)) {
            PointLayout::of(6).decode(record, &header.scale, &header.offset, &mut back);
            prop_assert!((back.x - written.x).abs() <= 0.000_501);
            prop_assert!((back.y - written.y).abs() <= 0.000_501);
            prop_assert!((back.z - written.z).abs() <= 0.001_001);
            prop_assert_eq!(&record[30..], &extra);
            for (axis, value) in [back.x, back.y, back.z].into_iter().enumerate() {
                min[axis] = min[axis].min(value);
                max[axis] = max[axis].max(value);
            }
        }
        prop_assert_eq!((header.min, header.max), (min, max));
        assert_read_by_las(LasVersion::V1_4, las, &points, &extra);
    }

    #[test]
    fn old_versions_read_back_as_they_were_written(
        points in prop::collection::vec(any_point(), 1..40),
        extra in any::<[u8; 3]>(),
    ) {
        // The `laz` crate subtracts the bits of successive times, which panics in debug builds for
        // different signs.
        let fits = |point: PointOut| PointOut {
            gps_time: point.gps_time.abs(),
            return_number: point.return_number.min(7),
            number_of_returns: point.number_of_returns.min(7),
            classification: point.classification.min(31),
            scanner_channel: 0,
            scan_angle_deg: point.scan_angle_deg.round().clamp(-90.0, 90.0),
            ..point
        };
        let points: Vec<PointOut> = points.into_iter().map(fits).collect();
        let utm_33 = utm_33();
        let options = WriterOptions { version: LasVersion::V1_2, wkt: Some(&utm_33), ..options(&[AMP, CHANNEL]) };
        let las = write("a.las", &options, &points, &extra);
        let (header, plain) = records(&las);
        let (_, compressed) = records(&write("a.laz", &options, &points, &extra));
        prop_assert_eq!(&plain, &compressed);
        prop_assert_eq!((header.point_format, header.n_points), (1, points.len() as u64));
        assert_read_by_las(LasVersion::V1_2, las, &points, &extra);
    }
}
