//! Order in which the files of a run get their final names.
//!
//! A run may be killed between any two of these steps. Other programs match points with packets and
//! indexes by name only. Therefore no step may leave points next to packets or an index of another
//! run. Files of an earlier run are removed first: its index and, with external packets, its
//! points. Packets are then published before the points that refer to them, and the index after the
//! points that it counts. A STAC item is published last; an earlier one is removed with the index.

use std::io::Write;

use super::WavePacketsKey;
use super::waves::{self, PacketFile};
use crate::stac;
use wavex_formats::Error;
use wavex_formats::las::{Writer, indexes_beside};
use wavex_line::stage::{Context, FinishedFile, OutputFile, Reason, Result};

/// Companion files of the points, or data appended to them.
pub(super) struct CompanionFiles {
    /// File of the spatial index.
    pub index: Option<OutputFile>,
    /// The waveforms of the points.
    pub waves: Option<PacketFile>,
    /// Destination of the waveforms.
    pub place: WavePacketsKey,
    /// STAC item of the points.
    pub item: Option<StacFile>,
}

/// File of a STAC item, and what the points' file does not contain.
pub(super) struct StacFile {
    pub file: OutputFile,
    /// Coordinate reference system as WKT.
    pub wkt: Option<String>,
    /// Smallest and largest time of the points, as stored, s.
    pub times_s: Option<[f64; 2]>,
}

impl CompanionFiles {
    /// Completes the files and publishes them in order.
    pub fn finish(self, mut writer: Writer<OutputFile>, cx: &mut Context) -> Result<()> {
        let index = self.index.map(|file| finish_index(file, &mut writer)).transpose()?.flatten();
        let points = match self.waves {
            None => writer.finish()?,
            Some(waves) => finish_with_waveforms(writer, waves, self.place, cx)?,
        };
        let earlier = self.item.iter().map(|item| item.file.path().to_path_buf());
        let stale: Vec<_> = indexes_beside(points.path()).into_iter().chain(earlier).collect();
        let points = points.finish()?;
        let item = self.item.map(|item| finish_item(item, &points, cx)).transpose()?.flatten();
        cx.publish(points.replacing(stale));
        index.into_iter().chain(item).for_each(|file| cx.publish(file));
        Ok(())
    }
}

/// Completes the index file; `None` if the index format cannot address this many points.
fn finish_index(mut file: OutputFile, writer: &mut Writer<OutputFile>) -> Result<Option<FinishedFile>> {
    let Some(index) = writer.take_index() else { return Ok(None) };
    let path = file.path().to_path_buf();
    file.write_all(&index).map_err(Error::io(&path, "write"))?;
    Ok(Some(file.finish()?))
}

/// Completes the STAC item of complete points; `None` if they have no date.
fn finish_item(item: StacFile, points: &FinishedFile, cx: &mut Context) -> Result<Option<FinishedFile>> {
    let about = stac::describe(points)?;
    let points = stac::ItemPoints {
        about: &about,
        path: points.path(),
        wkt: item.wkt.as_deref(),
        times_s: item.times_s,
    };
    let finished = stac::finish(item.file, &points)?;
    if finished.is_none() {
        cx.warn(stac::NO_DATE);
    } else if !stac::names_system(item.wkt.as_deref()) {
        cx.warn(stac::NO_SYSTEM);
    }
    Ok(finished)
}

fn finish_with_waveforms(
    writer: Writer<OutputFile>,
    waves: PacketFile,
    place: WavePacketsKey,
    cx: &mut Context,
) -> Result<OutputFile> {
    cx.reject(Reason::IndescribableWaveform, waves.n_refused);
    let (packets, kinds) = waves.finish()?;
    if place == WavePacketsKey::Internal {
        return Ok(writer.finish_with_waveforms(&kinds, Some(&mut waves::open(&packets)?))?);
    }
    let points = writer.finish_with_waveforms(&kinds, None)?;
    cx.publish(packets.replacing([points.path().to_path_buf()]));
    Ok(points)
}
