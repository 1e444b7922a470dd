//! Writes small containers and tables of returns in every format.
//!
//! All values follow from the shot number alone. `tests/python/read_container.py` reads the files
//! with pyarrow and DuckDB and compares the values:
//!
//! ```sh
//! cargo run --example write_container -- out
//! python tests/python/read_container.py out/*
//! ```

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::{Context, Result};
use wavex::scan_line::{Return, ReturnChannel};
use wavex::stages::writers::write_table::{ReturnColumns, ReturnRow, TableFormat, TableInfo, TableWriter};
use wavex_formats::container::{
    Compression, ContainerBlock, ContainerHeader, ContainerOnline, ContainerShot, ContainerWriter,
    EmissionReference, LineBuilder, TimeScale, channel,
};

const LINES: u64 = 3;
const SHOTS_PER_LINE: u64 = 4;

fn main() -> Result<()> {
    let folder = std::env::args().nth(1).context("missing argument: output folder")?;
    let folder = Path::new(&folder);
    std::fs::create_dir_all(folder)?;
    for (name, compression) in [
        ("plain.arrow", Compression::None),
        ("lz4.arrow", Compression::Lz4),
        ("zstd.arrow", Compression::Zstd),
    ] {
        let path = folder.join(name);
        let to = BufWriter::new(File::create(&path)?);
        write_lines(ContainerWriter::file(to, &path, &header(), compression)?)?;
    }
    let path = folder.join("stream.arrows");
    let to = BufWriter::new(File::create(&path)?);
    write_lines(ContainerWriter::stream(to, &path, &header(), Compression::Lz4)?)?;
    for (name, format) in [
        ("returns.arrow", TableFormat::Arrow),
        ("returns.parquet", TableFormat::Parquet),
        ("returns.csv", TableFormat::Csv),
    ] {
        let path = folder.join(name);
        let to = BufWriter::new(File::create(&path)?);
        let mut table = TableWriter::new(
            to,
            &path,
            format,
            ReturnColumns,
            TableInfo { time_scale: "week", ..TableInfo::default() },
        )?;
        (0..LINES * SHOTS_PER_LINE).flat_map(returns).try_for_each(|row| table.push(row))?;
        table.finish()?.into_inner()?.sync_all()?;
    }
    Ok(())
}

fn header() -> ContainerHeader {
    ContainerHeader {
        instrument: Some("made up".into()),
        serial: Some("1".into()),
        pulse_rate_hz: Some(400e3),
        time_scale: TimeScale::Week,
        gps_week: Some(1747),
        amplitude_low: Some(vec![(9.0, 0.0), (255.0, 19.7)]),
        recorded: Some((172, 2013)),
        full_scale_dn: Some(255),
        emission_reference: Some(EmissionReference::OutgoingPulse),
        ..ContainerHeader::new(1.0, 299_707_502.0)
    }
}

fn write_lines(mut writer: ContainerWriter<BufWriter<File>>) -> Result<()> {
    for number in 0..LINES {
        let mut line = LineBuilder::new();
        for shot in number * SHOTS_PER_LINE..(number + 1) * SHOTS_PER_LINE {
            add_shot(&mut line, shot, number as u32);
        }
        writer.write(line)?;
    }
    writer.finish()?.into_inner()?.sync_all()?;
    Ok(())
}

fn add_shot(line: &mut LineBuilder, n: u64, number: u32) {
    let x = n as f64;
    line.shot(&ContainerShot {
        shot: n,
        line: number,
        gps_time_s: (n % 5 != 4).then_some(1000.0 + x / 2.0),
        clock_ps: n as i64 * 2_500_000,
        origin_m: [x, 2.0 * x, 3.0 * x],
        direction: [0.6, 0.0, -0.8],
        facet: (n % 4) as u16,
        flags: 1,
        mta_zone: (n % 2 == 1).then_some(2),
        scan_angle_deg: (n > 0).then_some(n as f32 - 6.0),
        frame_scale: (n == 7).then_some(0.9996),
    });
    let samples = |count: u64, step: u64| (0..count).map(|i| (step * n + i) as u16).collect::<Vec<_>>();
    let reference = ContainerBlock {
        channel: channel::REFERENCE,
        start_ns: 0.25,
        interval_ns: None,
        zone: None,
        gain: None,
        samples: &samples(6, 1),
    };
    line.block(&reference);
    let echo = ContainerBlock {
        channel: channel::LOW_POWER,
        start_ns: 100.0 + x,
        interval_ns: (n == 3).then_some(0.5),
        zone: (n == 6).then_some(1),
        gain: None,
        samples: &samples(8 + n, 10),
    };
    line.block(&echo);
    for i in 0..n % 3 {
        line.online(&ContainerOnline { time_ns: 100.0 + i as f64, amplitude: 1.5 });
    }
}

fn returns(n: u64) -> impl Iterator<Item = ReturnRow> {
    let count = (n % 3) as u8;
    (0..count).map(move |index| ReturnRow {
        shot: n,
        gps_time_s: if n % 5 == 4 { f64::NAN } else { 1000.0 + n as f64 / 2.0 },
        found: found(n, index, count),
        point: n.is_multiple_of(2).then(|| [n as f64, 0.1 + f64::from(index), -0.125]),
        profile: None,
    })
}

fn found(n: u64, index: u8, count: u8) -> Return {
    let range_m = 100.0 + n as f64 + f64::from(index) / 8.0;
    Return {
        emission: 0,
        return_number: index + 1,
        number_of_returns: count,
        channel: [ReturnChannel::Low, ReturnChannel::High, ReturnChannel::Joint][(n / 3 % 3) as usize],
        flags: 0x0100,
        mta_zone: if n % 2 == 1 { 2 } else { -1 },
        time_of_flight_ns: range_m / 0.15,
        time_of_flight_sd_ns: 0.01,
        range_m,
        range_sd_m: 0.0015,
        amplitude_dn: 0.1 + 0.2,
        amplitude_sd_dn: 0.9,
        gain: 1.0,
        peak_dn: 2.0 + 0.1 + 0.2,
        peak_sd_dn: 0.9,
        amplitude_db: if index == 0 { 12.5 } else { f64::NAN },
        width_ratio: 1.0,
        width_ratio_sd: 0.0625,
        fwhm_ns: 4.5,
        total_sd_m: if n.is_multiple_of(4) { 0.04 } else { f64::NAN },
        thickness_m: 0.0,
        thickness_sd_m: f64::NAN,
        deviation_ratio: -0.5,
        intensity: 70.0,
        intensity_sd: 1.0,
        withheld: index == 1,
        class: 20 * index,
        height_above_ground_m: f32::NAN,
    }
}
