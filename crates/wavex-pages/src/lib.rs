//! Everything a run or a recording shows to people: [`report`], [`inspect`], [`explain`], [`view`].

pub mod explain;
pub mod inspect;
pub mod report;
pub mod view;
