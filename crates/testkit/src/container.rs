//! Containers built by hand, and their rows.

use std::path::Path;

use wavex_formats::container::{
    Compression, ContainerBlock, ContainerFootprint, ContainerHeader, ContainerReader, ContainerShot,
    ContainerWriter, EmissionReference, LineBuilder, TimeScale, channel,
};

/// A row of a container.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Shot of the row.
    pub shot: ContainerShot,
    /// Channel code, time of the first sample after the clock (ns), samples.
    pub blocks: Vec<(u8, f64, Vec<u16>)>,
}

/// A shot of a container, at nadir.
pub struct Shot {
    /// Time on the instrument's clock, ps.
    pub clock_ps: i64,
    /// Channel code, time of the first sample after the clock (ns), samples.
    pub blocks: Vec<(u8, f64, Vec<u16>)>,
}

/// A shot of line 0 at nadir from the origin, without a time.
pub fn nadir_shot(shot: u64, clock_ps: i64) -> ContainerShot {
    ContainerShot {
        shot,
        line: 0,
        gps_time_s: None,
        clock_ps,
        origin_m: [0.0; 3],
        direction: [0.0, 0.0, -1.0],
        facet: 0,
        flags: 0,
        mta_zone: Some(0),
        scan_angle_deg: None,
        frame_scale: None,
    }
}

/// A block at the sampling interval of the header, without zone and gain.
pub fn block(channel: u8, start_ns: f64, samples: &[u16]) -> ContainerBlock<'_> {
    ContainerBlock { channel, start_ns, interval_ns: None, zone: None, gain: None, samples }
}

/// A line of these rows, ready to be written.
pub fn line_of(rows: &[Row]) -> LineBuilder {
    let mut line = LineBuilder::new();
    for row in rows {
        line.shot(&row.shot);
        row.blocks.iter().for_each(|(channel, start_ns, samples)| {
            line.block(&block(*channel, *start_ns, samples));
        });
    }
    line
}

/// An uncompressed container of lines, one record batch each.
pub fn container(header: &ContainerHeader, lines: &[Vec<Row>]) -> Vec<u8> {
    compressed(header, lines, Compression::None)
}

/// The same with a compression.
pub fn compressed(header: &ContainerHeader, lines: &[Vec<Row>], compression: Compression) -> Vec<u8> {
    let mut writer = ContainerWriter::file(Vec::new(), Path::new("made"), header, compression).unwrap();
    lines.iter().for_each(|rows| writer.write(line_of(rows)).unwrap());
    writer.finish().unwrap()
}

/// A container of two beams whose samples are fractions of a digitiser step.
pub fn of_fractions() -> Vec<u8> {
    let header = ContainerHeader { has_fractions: true, ..ContainerHeader::new(1.0, 299_792_458.0) };
    let mut writer = ContainerWriter::file(Vec::new(), Path::new("made"), &header, Compression::Lz4).unwrap();
    for beam in ["BEAM0101", "BEAM1011"] {
        let mut line = LineBuilder::new();
        for shot in 0..3 {
            line.shot(&nadir_shot(shot, 0));
            for (code, samples) in
                [(channel::REFERENCE, &[0.5, 9.25, 0.75][..]), (channel::LOW_POWER, &[2.0, 7.5, 3.25, 2.125])]
            {
                line.block_of_fractions(&block(code, 0.0, &[]), samples);
            }
            line.footprint(&ContainerFootprint {
                beam: Some(beam),
                shot_number: Some(19_000 + shot),
                noise_mean_dn: Some(2.0),
                noise_sd_dn: Some(0.5),
                is_advised_against: shot == 1,
            });
        }
        writer.write(line).unwrap();
    }
    writer.finish().unwrap()
}

/// A container of one line with these shots, numbered from 100; without times unless `timed`.
pub fn of_shots(shots: &[Shot], reference: EmissionReference, timed: bool) -> Vec<u8> {
    let header = ContainerHeader {
        time_scale: TimeScale::Week,
        full_scale_dn: Some(255),
        emission_reference: Some(reference),
        ..ContainerHeader::new(1.0, 299_707_502.0)
    };
    let row = |(number, shot): (u64, &Shot)| Row {
        shot: ContainerShot {
            gps_time_s: timed.then_some(shot.clock_ps as f64 * 1e-12),
            ..nadir_shot(number, shot.clock_ps)
        },
        blocks: shot.blocks.clone(),
    };
    container(&header, &[(100..).zip(shots).map(row).collect()])
}

/// Rows of a container by line.
pub fn rows(path: &Path) -> Vec<Vec<Row>> {
    let mut reader = ContainerReader::open(path).unwrap();
    let mut lines = Vec::new();
    while let Some(line) = reader.next_line().unwrap() {
        let row = |row| Row {
            shot: line.shot(row),
            blocks: line
                .blocks(row)
                .map(|block| (block.channel, block.start_ns, block.samples.to_vec()))
                .collect(),
        };
        lines.push((0..line.rows()).map(row).collect());
    }
    lines
}
