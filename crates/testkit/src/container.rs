//! Containers built by hand: shots at nadir, each with its blocks.

use wavex_formats::container::{
    Compression, ContainerBlock, ContainerHeader, ContainerShot, ContainerWriter, EmissionReference,
    LineBuilder, TimeScale,
};

/// A shot of a container.
pub struct Shot {
    /// Time on the instrument's clock, ps.
    pub clock_ps: i64,
    /// Channel code, time of the first sample after the clock (ns), samples.
    pub blocks: Vec<(u8, f64, Vec<u16>)>,
}

/// A container of one line with these shots, numbered from 100; without times unless `timed`.
pub fn container(shots: &[Shot], reference: EmissionReference, timed: bool) -> Vec<u8> {
    let header = ContainerHeader {
        time_scale: TimeScale::Week,
        full_scale_dn: Some(255),
        emission_reference: Some(reference),
        ..ContainerHeader::new(1.0, 299_707_502.0)
    };
    let path = std::path::Path::new("made by hand");
    let mut writer = ContainerWriter::file(Vec::new(), path, &header, Compression::None).unwrap();
    let mut line = LineBuilder::new();
    for (number, shot) in (100..).zip(shots) {
        line.shot(&ContainerShot {
            shot: number,
            line: 0,
            gps_time_s: timed.then_some(shot.clock_ps as f64 * 1e-12),
            clock_ps: shot.clock_ps,
            origin_m: [0.0; 3],
            direction: [0.0, 0.0, -1.0],
            facet: 0,
            flags: 0,
            mta_zone: Some(0),
            scan_angle_deg: None,
            frame_scale: None,
        });
        for (channel, start_ns, samples) in &shot.blocks {
            line.block(&ContainerBlock {
                channel: *channel,
                start_ns: *start_ns,
                zone: None,
                interval_ns: None,
                gain: None,
                samples,
            });
        }
    }
    writer.write(line).unwrap();
    writer.finish().unwrap()
}
