//! Round trips of headers.

use proptest::prelude::*;

use super::*;

prop_compose! {
    fn any_header()(
        minor in 0..=5u8,
        ids in (any::<u16>(), any::<u16>(), any::<[u8; 16]>(), any::<bool>(), any::<(u16, u16, u16)>()),
        texts in ("[a-zA-Z0-9 ]{0,32}", "[a-z]{0,32}"),
        sizes in (0..300u16, 0..1000u32, any::<u32>(), 0..=10u8, 0..500u16),
        counts in (1..=u32::MAX, any::<[u32; 15]>()),
        numbers in [1e-9..1e3f64, 1e-9..1e3, 1e-9..1e3],
        boxes in any::<[[i32; 3]; 3]>(),
        later in any::<(u64, u64, u32)>(),
    ) -> LasHeader {
        let header_size = header_bytes(minor) + sizes.0;
        let from = |version: u8| u64::from(minor >= version);
        let (point_format, n_counts) = if minor >= 4 { (sizes.3, 15) } else { (sizes.3 % 6, 5) };
        LasHeader {
            file_source_id: ids.0,
            global_encoding: ids.1,
            guid: ids.2,
            version: (1, minor),
            system_identifier: texts.0,
            generating_software: texts.1,
            creation_day: ids.4.0,
            creation_year: ids.4.1,
            header_size,
            offset_to_points: u32::from(header_size) + sizes.1,
            n_vlrs: sizes.2,
            point_format,
            compressed: ids.3,
            record_length: PointLayout::of(point_format).length as u16 + sizes.4,
            n_points: counts.0.into(),
            n_points_by_return: std::array::from_fn(|n| if n < n_counts { counts.1[n].into() } else { 0 }),
            scale: numbers,
            offset: boxes[0].map(f64::from),
            min: boxes[1].map(f64::from),
            max: boxes[2].map(f64::from),
            start_of_waveforms: later.0 * from(3),
            start_of_evlrs: later.1 * from(4),
            n_evlrs: later.2 * from(4) as u32,
            time_offset_megaseconds: ids.4.2 * from(5) as u16,
        }
    }
}

proptest! {
    #[test]
    fn a_written_header_reads_as_the_same(header in any_header()) {
        let bytes = header.write();
        prop_assert_eq!(bytes.len(), usize::from(header.header_size));
        let read = LasHeader::read(&mut bytes.as_slice(), Path::new("a.las"), u64::MAX).unwrap();
        prop_assert_eq!(read, header);
    }
}
