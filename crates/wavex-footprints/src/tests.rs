//! Footprints of known ground and canopy.

use super::*;
