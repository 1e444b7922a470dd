//! Points written many at a time.

use std::io::Cursor;
use std::ops::Range;
use std::path::Path;

use proptest::prelude::*;

use super::writer::{cloud, options, u64_at};
use crate::Error;
use crate::las::{AMP, CHANNEL, ExtraColumns, IndexPlace, LasVersion, Writer, WriterOptions};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn points_written_together_are_those_written_one_by_one(
        n in 0..600usize,
        too_far in prop::collection::vec(0..600usize, 0..3),
        format in prop::sample::select(vec!["a.las", "a.laz"]),
        version in prop::sample::select(vec![LasVersion::V1_2, LasVersion::V1_4]),
    ) {
        let options = WriterOptions { version, wkt: None, index: IndexPlace::Beside, ..options(&[AMP, CHANNEL]) };
        let mut points = cloud(n);
        for (number, x) in too_far.into_iter().zip([1e300, f64::NAN]) {
            points.iter_mut().skip(number).take(1).for_each(|point| point.x = x);
        }
        let extra = |number: usize| [number as f64 * 0.7, (number % 2) as f64];
        let new = || Writer::new(Cursor::new(Vec::new()), Path::new(format), &options).unwrap();

        let mut one_by_one = new();
        let mut refused = Vec::new();
        for (number, point) in points.iter().enumerate() {
            let mut bytes = Vec::new();
            let values = [AMP, CHANNEL].into_iter().zip(extra(number));
            values.for_each(|(attribute, value)| attribute.push(value, &mut bytes));
            refused.extend(one_by_one.write_point(point, &bytes).err().map(|error| error.to_string()));
        }
        let mut together = new();
        let mut refused_together = Vec::new();
        let put = |numbers: Range<usize>, columns: &mut ExtraColumns| {
            for (k, attribute) in [AMP, CHANNEL].iter().enumerate() {
                let values: Vec<f64> = numbers.clone().map(|number| extra(number)[k]).collect();
                columns.put(attribute, &values);
            }
        };
        let made = |number: usize| points[number].clone();
        together.write_points(n, made, put, |error| refused_together.push(error.to_string())).unwrap();

        prop_assert_eq!(refused_together, refused);
        prop_assert_eq!(together.n_points(), one_by_one.n_points());
        prop_assert_eq!(together.take_index(), one_by_one.take_index());
        prop_assert_eq!(together.finish().unwrap().into_inner(), one_by_one.finish().unwrap().into_inner());
    }
}

#[test]
fn extra_attributes_that_are_missing_leave_points_out() {
    let mut writer = Writer::new(Cursor::new(Vec::new()), Path::new("a.las"), &options(&[AMP])).unwrap();
    let points = cloud(3);
    let made = |number: usize| points[number].clone();
    let refused = |error: Error| panic!("{error}");
    let too_few = |_: Range<usize>, columns: &mut ExtraColumns| columns.put(&AMP, &[7.0; 2]);
    for found in
        [writer.write_points(3, made, |_, _| (), refused), writer.write_points(3, made, too_few, refused)]
    {
        let found = found.unwrap_err().to_string();
        assert!(
            found.starts_with("a.las: point 0 has 0 extra bytes, but the attributes need 2; "),
            "{found}"
        );
    }
    writer
        .write_points(3, made, |numbers, columns| columns.put(&AMP, &vec![7.0; numbers.len()]), refused)
        .unwrap();
    let las = writer.finish().unwrap().into_inner();
    assert_eq!((las[las.len() - 2], u64_at(&las, 247)), (7, 3));
}
