//! The files of a run of points, in the order in which they get their names.
//!
//! A run may be killed between any two of these steps, and nothing tells other programs which packets or which index a file of
//! points was written with: they trust the names. So no step may leave a file of points beside packets or an index of another
//! run. What an earlier run left goes first: its index, and where packets stand beside the points, its points. Packets then
//! come before the points that refer to them, and the index after the points that it counts.

use std::io::Write;

use super::WavePacketsKey;
use super::waves::{self, Waves};
use crate::formats::Error;
use crate::formats::las::{Writer, indexes_beside};
use crate::stage::{Context, Item, OutputFile, Result, WholeFile};

/// What is written beside the points, or becomes a part of their file.
pub(super) struct Files {
    /// The file of the index.
    pub index: Option<OutputFile>,
    /// The waveforms of the points.
    pub waves: Option<Waves>,
    /// Where the waveforms go.
    pub place: WavePacketsKey,
}

impl Files {
    /// Completes the files and keeps them in order.
    pub fn finish(self, mut writer: Writer<OutputFile>, cx: &mut Context) -> Result<()> {
        let index = self.index.map(|file| finish_index(file, &mut writer)).transpose()?.flatten();
        let points = match self.waves {
            None => writer.finish()?,
            Some(waves) => finish_with_waveforms(writer, waves, self.place, cx)?,
        };
        let stale = indexes_beside(points.path());
        cx.keep(points.finish()?.instead_of(stale));
        index.into_iter().for_each(|index| cx.keep(index));
        Ok(())
    }
}

/// The file of the index; `None` where an index cannot name so many points.
fn finish_index(mut file: OutputFile, writer: &mut Writer<OutputFile>) -> Result<Option<WholeFile>> {
    let Some(index) = writer.take_index() else { return Ok(None) };
    let path = file.path().to_path_buf();
    file.write_all(&index).map_err(Error::io(&path, "write"))?;
    Ok(Some(file.finish()?))
}

fn finish_with_waveforms(
    writer: Writer<OutputFile>,
    waves: Waves,
    place: WavePacketsKey,
    cx: &mut Context,
) -> Result<OutputFile> {
    cx.reject(Item::Blocks, "a waveform that no packet can hold", waves.n_refused);
    let (packets, kinds) = waves.finish()?;
    if place == WavePacketsKey::Internal {
        return Ok(writer.finish_with_waveforms(&kinds, Some(&mut waves::open(&packets)?))?);
    }
    let points = writer.finish_with_waveforms(&kinds, None)?;
    cx.keep(packets.instead_of([points.path().to_path_buf()]));
    Ok(points)
}
