//! Files that say where an instrument was, and how it was turned, at each moment.

pub mod pof;
pub mod sbet;
