//! Bits of the header field "global encoding".

/// GPS time is adjusted standard GPS time, not seconds of the week.
pub(super) const ADJUSTED_TIME: u16 = 1;
/// Waveform packets are inside the file.
pub(super) const WAVES_INSIDE: u16 = 1 << 1;
/// Waveform packets are in a separate file.
pub(super) const WAVES_BESIDE: u16 = 1 << 2;
/// Return numbers are synthetic.
pub(super) const SYNTHETIC_RETURNS: u16 = 1 << 3;
/// The coordinate system is given as WKT.
pub(super) const WKT: u16 = 1 << 4;
/// With [`ADJUSTED_TIME`], from LAS 1.5 on.
///
/// The header gives the offset of GPS time.
pub(super) const TIME_OFFSET: u16 = 1 << 6;
