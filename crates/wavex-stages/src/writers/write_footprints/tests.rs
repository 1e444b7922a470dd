//! Tables of footprints.
