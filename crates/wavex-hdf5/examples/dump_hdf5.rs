//! Writes all samples of a file, for comparison with other readers.
//!
//! For each shot: number of received samples, number of outgoing samples (`u32`), the samples (`f32`),
//! shot number (`u64`), time, noise mean and SD, three positions (`f64`); all little-endian.
//! For each waveform of a pulse of SPD, with `SPD` as the beam: both numbers and the samples as above, number of
//! the pulse (`u64`), time, ns, three coordinates of the origin, azimuth, zenith, range, m (`f64`).
//!
//! usage: dump_hdf5 FILE BEAM > samples.bin

use std::env;
use std::error::Error;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use wavex_hdf5::{Granule, Shot, SpdPulse, SpdReader};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().collect();
    let [_, file, beam] = &arguments[..] else {
        return Err("usage: dump_hdf5 FILE BEAM > samples.bin".into());
    };
    if beam == "SPD" {
        return pulses(Path::new(file));
    }
    let mut beam = Granule::open(Path::new(file))?.beam(beam)?;
    let mut out = BufWriter::new(io::stdout().lock());
    let mut shot = Shot::default();
    for index in 0..beam.len() {
        beam.shot(index, &mut shot)?;
        for samples in [&shot.received_dn, &shot.outgoing_dn] {
            out.write_all(&(samples.len() as u32).to_le_bytes())?;
        }
        for sample in shot.received_dn.iter().chain(&shot.outgoing_dn) {
            out.write_all(&sample.to_le_bytes())?;
        }
        out.write_all(&shot.shot_number.to_le_bytes())?;
        let positions = [shot.first_bin, shot.last_bin, shot.instrument];
        let positions =
            positions.iter().flat_map(|place| [place.longitude_rad, place.latitude_rad, place.height_m]);
        let values = [shot.time_s, f64::from(shot.noise_mean_dn), f64::from(shot.noise_sd_dn)];
        for value in values.into_iter().chain(positions) {
            out.write_all(&value.to_le_bytes())?;
        }
    }
    Ok(out.flush()?)
}

fn pulses(file: &Path) -> Result<(), Box<dyn Error>> {
    let mut reader = SpdReader::open(file)?;
    let mut out = BufWriter::new(io::stdout().lock());
    let mut pulse = SpdPulse::default();
    for index in 0..reader.len() {
        reader.pulse(index, &mut pulse)?;
        for waveform in pulse.waveforms() {
            for samples in [&waveform.received_dn, &waveform.transmitted_dn] {
                out.write_all(&(samples.len() as u32).to_le_bytes())?;
            }
            for sample in waveform.received_dn.iter().chain(&waveform.transmitted_dn) {
                out.write_all(&f32::from(*sample).to_le_bytes())?;
            }
            out.write_all(&pulse.id.to_le_bytes())?;
            let time_ns = pulse.time_ns.map_or(f64::NAN, |ns| ns as f64);
            let [x, y, z] = pulse.origin;
            for value in [time_ns, x, y, z, pulse.azimuth_rad, pulse.zenith_rad, waveform.range_m] {
                out.write_all(&value.to_le_bytes())?;
            }
        }
    }
    Ok(out.flush()?)
}
