//! NEON waveforms as text: conversion to a container, and the Gaussians of an R package.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use wavex_formats::container::{
    Compression, ContainerBlock, ContainerHeader, ContainerShot, ContainerWriter, EmissionReference, Frame,
    LineBuilder, TimeScale, channel,
};

/// Start of every recorded echo after its shot's clock, ns; the text does not give the time of the
/// first sample.
pub const START_NS: f64 = 3000.0;

/// Numeric rows below a header line; other text is NaN.
pub fn rows(path: &Path) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).unwrap();
    let row = |line: &str| line.split(',').map(|cell| cell.parse().unwrap_or(f64::NAN)).collect();
    text.lines().skip(1).map(row).collect()
}

/// Waveforms of a table; zeros or empty cells at the end of rows are padding.
pub fn waveforms(path: &Path) -> Vec<Vec<u16>> {
    let samples = |row: Vec<f64>| {
        let end = row.iter().rposition(|value| *value > 0.0).map_or(0, |last| last + 1);
        row[..end].iter().map(|value| *value as u16).collect()
    };
    rows(path).into_iter().map(samples).collect()
}

/// Converts the recording of `folder` to a container: all shots as one scan line, at nadir.
pub fn to_container(folder: &Path, path: &Path) {
    let header = ContainerHeader {
        instrument: Some("Optech Gemini".into()),
        time_scale: TimeScale::Week,
        frame: Frame::Map,
        full_scale_dn: Some(4095),
        emission_reference: Some(EmissionReference::OutgoingPulse),
        ..ContainerHeader::new(1.0, 299_707_502.0)
    };
    let to = BufWriter::new(File::create(path).unwrap());
    let mut writer = ContainerWriter::file(to, path, &header, Compression::Lz4).unwrap();
    let mut line = LineBuilder::new();
    let outgoing = waveforms(&folder.join("outg_1_250.csv"));
    for (shot, (echo, outgoing)) in
        waveforms(&folder.join("return_1_250.csv")).iter().zip(&outgoing).enumerate()
    {
        line.shot(&ContainerShot {
            shot: shot as u64,
            line: 0,
            gps_time_s: Some(shot as f64 * 1e-5),
            clock_ps: shot as i64 * 10_000_000,
            origin_m: [shot as f64, 0.0, 800.0],
            direction: [0.0, 0.0, -1.0],
            facet: 0,
            flags: 0,
            mta_zone: Some(0),
            scan_angle_deg: None,
            frame_scale: None,
        });
        for (channel, start_ns, samples) in
            [(channel::REFERENCE, 0.0, outgoing), (channel::LOW_POWER, START_NS, echo)]
        {
            line.block(&ContainerBlock {
                channel,
                start_ns,
                interval_ns: None,
                zone: None,
                gain: None,
                samples,
            });
        }
    }
    writer.write(line).unwrap();
    writer.finish().unwrap().into_inner().unwrap();
}
