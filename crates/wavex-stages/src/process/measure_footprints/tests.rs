//! Footprints of made shots, through the stage.
