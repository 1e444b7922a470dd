//! Writes all samples of a file, for comparison with other readers.
//!
//! For each shot: number of received samples, number of outgoing samples (`u32`), the samples (`f32`),
//! shot number (`u64`), time, noise mean and SD, three positions (`f64`); all little-endian.
//!
//! usage: dump_hdf5 FILE BEAM > samples.bin

use std::env;
use std::error::Error;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use wavex_hdf5::{Granule, Shot};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().collect();
    let [_, file, beam] = &arguments[..] else {
        return Err("usage: dump_hdf5 FILE BEAM > samples.bin".into());
    };
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
