//! Numbers to numbers.
pub mod flags {
    //! Flags.
}
/// What calibration finds.
#[derive(Debug, Clone, serde::Serialize, schemars::JsonSchema)]
pub struct SensorModel {}
