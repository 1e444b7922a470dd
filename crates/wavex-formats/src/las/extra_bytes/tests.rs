//! Descriptors and values of extra attributes.

use super::*;
use proptest::prelude::*;

/// Undeclared limits; NaN is stored as 0.
const fn undeclared(
    name: &'static str,
    description: &'static str,
    data_type: DataType,
    scale: Option<f64>,
    offset: Option<f64>,
) -> ExtraAttribute {
    let (nan, nan_is_no_data, limits) = (0, false, None);
    ExtraAttribute { name, description, data_type, scale, offset, nan, nan_is_no_data, limits }
}

/// Declared limits and no-data value.
const fn declared(
    name: &'static str,
    data_type: DataType,
    scale: Option<f64>,
    limits: (f64, f64),
    nan: i64,
) -> ExtraAttribute {
    let (limits, nan_is_no_data) = (Some(limits), true);
    ExtraAttribute { nan, nan_is_no_data, limits, ..undeclared(name, "", data_type, scale, None) }
}

const WIDE_RATIO: ExtraAttribute =
    undeclared("WideRatio", "Pulse widening ratio", DataType::U8, Some(0.025), Some(0.5));
pub(in crate::las) const AMP: ExtraAttribute =
    undeclared("Amp", "Target amplitude", DataType::U16, Some(1.0), Some(0.0));
const DEV_RATIO: ExtraAttribute =
    undeclared("DevRatio", "Residual against noise (sigma)", DataType::U8, Some(0.1), Some(0.0));
const RANGE_ERR: ExtraAttribute = ExtraAttribute {
    nan: u8::MAX as i64,
    ..undeclared("RangeErr", "Range std. dev. (m)", DataType::U8, Some(0.001), Some(0.0))
};
pub(in crate::las) const CHANNEL: ExtraAttribute =
    undeclared("Channel", "Power channel (0 low, 1 high)", DataType::U8, None, None);

/// Attributes of several types, scales and offsets.
pub(in crate::las) const ATTRIBUTES: [ExtraAttribute; 5] = [WIDE_RATIO, AMP, DEV_RATIO, RANGE_ERR, CHANNEL];

const AMPLITUDE: ExtraAttribute =
    declared("Amplitude", DataType::U16, Some(0.01), (0.0, 10_000.0), u16::MAX as i64);
const REFLECTANCE: ExtraAttribute =
    declared("Reflectance", DataType::I16, Some(0.01), (-5_000.0, 15_000.0), i16::MIN as i64);
const RANGE_SD: ExtraAttribute = declared("Range SD", DataType::F32, None, (0.0, (1u64 << 40) as f64), 0);

#[test]
fn a_descriptor_is_spelled_out() {
    let bytes = WIDE_RATIO.descriptor();
    assert_eq!(bytes[..4], [0, 0, 1, 0b11000]);
    assert_eq!(&bytes[4..14], b"WideRatio\0");
    assert_eq!(bytes[14..112], [0; 98]);
    assert_eq!(bytes[112..120], 0.025f64.to_le_bytes());
    assert_eq!(bytes[120..136], [0; 16]);
    assert_eq!(bytes[136..144], 0.5f64.to_le_bytes());
    assert_eq!(bytes[144..160], [0; 16]);
    assert_eq!(&bytes[160..181], b"Pulse widening ratio\0");
    assert_eq!(bytes[181..], [0; 11]);

    assert_eq!(CHANNEL.descriptor()[..4], [0, 0, 1, 0]);
    let signed =
        ExtraAttribute { data_type: DataType::I16, nan: -1, nan_is_no_data: true, ..CHANNEL }.descriptor();
    assert_eq!(signed[..4], [0, 0, 4, 1]);
    assert_eq!(signed[40..48], [0xff; 8]);
}

#[test]
fn values_are_rounded_and_clamped() {
    assert_eq!(quantise(1.0, &WIDE_RATIO), 20);
    assert_eq!(quantise(0.4, &WIDE_RATIO), 0);
    assert_eq!(quantise(100.0, &WIDE_RATIO), 255);
    assert_eq!(quantise(-3.0, &DEV_RATIO), 0);
    assert_eq!(quantise(70_000.0, &AMP), 65_535);
    assert_eq!(quantise(f64::INFINITY, &AMP), 65_535);
    assert_eq!(quantise(f64::NEG_INFINITY, &AMP), 0);
    assert_eq!(quantise(f64::NAN, &AMP), 0);
    assert_eq!(quantise(f64::NAN, &RANGE_ERR), 255);
    let wide = ExtraAttribute { data_type: DataType::I8, nan: -1000, ..CHANNEL };
    assert_eq!(quantise(f64::NAN, &wide), -128);
    assert_eq!(quantise(-1e300, &wide), -128);
}

#[test]
fn limits_and_no_data_are_declared() {
    let bytes = |number: i64| number.to_le_bytes();
    let amplitude = AMPLITUDE.descriptor();
    assert_eq!(amplitude[..4], [0, 0, 3, 0b1111]);
    assert_eq!(&amplitude[4..14], b"Amplitude\0");
    assert_eq!((&amplitude[40..48], &amplitude[64..72]), (&bytes(65_535)[..], &bytes(0)[..]));
    assert_eq!((&amplitude[88..96], &amplitude[112..120]), (&bytes(10_000)[..], &0.01f64.to_le_bytes()[..]));
    let reflectance = REFLECTANCE.descriptor();
    assert_eq!((&reflectance[40..48], &reflectance[64..72]), (&bytes(-32_768)[..], &bytes(-5000)[..]));
    let sd = RANGE_SD.descriptor();
    assert_eq!(sd[..4], [0, 0, 9, 0b111]);
    assert!(f64::from_le_bytes(*sd[40..].first_chunk().unwrap()).is_nan());
    assert_eq!(&sd[64..72], &0.0f64.to_le_bytes());
}

#[test]
fn single_precision_values_are_clamped_to_their_limits() {
    let sd = |value: f64| f32::from_bits(quantise(value, &RANGE_SD) as u32);
    assert_eq!((sd(0.0), sd(-1.0), sd(0.5)), (0.0, 0.0, 0.5));
    assert!(sd(f64::NAN).is_nan() && sd(f64::INFINITY).is_finite());
}

proptest! {
    #[test]
    fn a_column_is_stored_as_its_values(
        values in prop::collection::vec(prop_oneof![-10.0..10.0f64, -1e5..1e5f64, any::<f64>()], 0..40),
        attribute in prop::sample::select(ATTRIBUTES.to_vec()),
        data_type in prop::sample::select(vec![
            DataType::U8, DataType::I8, DataType::U16, DataType::I16, DataType::U32, DataType::I32, DataType::F32,
        ]),
        is_as_declared in any::<bool>(),
    ) {
        let data_type = if is_as_declared { attribute.data_type } else { data_type };
        let limits = attribute.limits.filter(|_| data_type == attribute.data_type);
        let attribute = ExtraAttribute { data_type, limits, ..attribute };
        let mut stored = vec![0; values.len()];
        attribute.quantise_column(&values, &mut stored);
        for (stored, value) in stored.into_iter().zip(values) {
            prop_assert_eq!(stored, quantise(value, &attribute) as i32, "{}", value);
        }
    }
}

#[test]
fn values_stand_behind_each_other_little_endian() {
    let mut extra = Vec::new();
    AMP.push(258.4, &mut extra);
    CHANNEL.push(1.0, &mut extra);
    ExtraAttribute { data_type: DataType::I32, ..CHANNEL }.push(-2.0, &mut extra);
    assert_eq!(extra, [2, 1, 1, 0xfe, 0xff, 0xff, 0xff]);
}

fn record(data: Vec<u8>) -> Vlr {
    let length = data.len() as u64;
    Vlr { user_id: "LASF_Spec".into(), record_id: 4, description: String::new(), offset: 429, length, data }
}

#[test]
fn written_descriptors_read_back() {
    let data: Vec<u8> = ATTRIBUTES.iter().flat_map(ExtraAttribute::descriptor).collect();
    let read = parse(Path::new("f"), &record(data)).unwrap();
    assert_eq!(read.len(), ATTRIBUTES.len());
    let mut start = 0;
    for (read, written) in read.iter().zip(&ATTRIBUTES) {
        assert_eq!((read.name.as_str(), read.description.as_str()), (written.name, written.description));
        assert_eq!((read.scale, read.offset, read.no_data), (written.scale, written.offset, None));
        assert_eq!((read.start, read.bytes), (start, written.data_type.bytes()));
        start += read.bytes;
    }
    assert_eq!(start, 6);
}

#[test]
fn types_that_are_not_written_are_read() {
    let mut data = vec![0; 4 * DESCRIPTOR];
    for (number, (data_type, options)) in [(0, 7), (25, 0), (10, 1), (31, 0)].into_iter().enumerate() {
        data[number * DESCRIPTOR + 2] = data_type;
        data[number * DESCRIPTOR + 3] = options;
    }
    let read = parse(Path::new("f"), &record(data)).unwrap();
    let places: Vec<_> = read.iter().map(|a| (a.start, a.bytes, a.no_data)).collect();
    assert_eq!(places, [(0, 7, None), (7, 12, None), (19, 8, Some([0; 8]))]);
}

proptest! {
    #[test]
    fn a_value_in_range_is_off_by_half_a_step_at_most(value in 0.5..6.8f64) {
        let back = quantise(value, &WIDE_RATIO) as f64 * 0.025 + 0.5;
        prop_assert!((back - value).abs() <= 0.0125 + 1e-12);
    }

    #[test]
    fn single_precision_keeps_a_value_within_a_250th(value in 1e-9..1e9f64) {
        let bits = quantise(value, &RANGE_SD) as u32;
        let back = f64::from(f32::from_bits(bits));
        prop_assert!((back - value).abs() <= value / 256.0, "{back} for {value}");
        prop_assert_eq!(bits & 0xffff, 0);
    }

    #[test]
    fn nothing_leaves_the_range_of_its_type(value in any::<f64>()) {
        for attribute in ATTRIBUTES.into_iter().chain([AMPLITUDE, REFLECTANCE, RANGE_SD]) {
            let (least, largest) = attribute.data_type.range();
            prop_assert!((least..=largest).contains(&quantise(value, &attribute)));
        }
    }
}

#[test]
fn stored_values_are_scaled_and_no_data_is_nan() {
    let attribute = |data_type: u8, bytes, no_data: Option<[u8; 8]>| ExtraBytes {
        name: String::new(),
        description: String::new(),
        data_type,
        start: 1,
        bytes,
        scale: Some(0.5),
        offset: Some(10.0),
        no_data,
    };
    let extra = [9, 0xfe, 0xff, 0xff, 0xff, 0, 0, 0x80, 0x3f];
    let value = |data_type, bytes| attribute(data_type, bytes, None).value(&extra);
    assert_eq!(value(1, 1), 137.0);
    assert_eq!([value(2, 1), value(4, 2), value(6, 4)], [9.0; 3]);
    assert_eq!(value(3, 2), 0.5 * 65_534.0 + 10.0);
    assert_eq!(attribute(9, 4, None).value(&[0, 0, 0, 0x80, 0x3f]), 10.5);
    assert_eq!(attribute(10, 8, None).value(&[&[0][..], &2.0_f64.to_le_bytes()].concat()), 11.0);
    // Undocumented, too wide for a number, and beyond the end of the point.
    assert!(
        [value(0, 4), value(11, 2), value(21, 24), value(9, 12), value(10, 9)]
            .iter()
            .all(|value| value.is_nan())
    );
    assert!(ExtraBytes { start: usize::MAX, ..attribute(1, 1, None) }.value(&extra).is_nan());
    assert!(attribute(4, 2, Some((-2_i64).to_le_bytes())).value(&extra).is_nan());
    assert!(attribute(3, 2, Some(65_534_u64.to_le_bytes())).value(&extra).is_nan());
    let nan = attribute(9, 4, Some(0_f64.to_bits().to_le_bytes()));
    assert!(nan.value(&[0; 5]).is_nan());
    assert_eq!(attribute(3, 2, Some([0; 8])).value(&extra), 0.5 * 65_534.0 + 10.0);
}
