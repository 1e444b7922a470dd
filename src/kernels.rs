//! Numbers to numbers.
pub mod flags {
    //! Flags.
}
/// What calibration finds.
#[derive(Debug, Clone)]
pub struct SensorModel {}
