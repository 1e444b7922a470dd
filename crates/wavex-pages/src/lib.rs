//! Everything a run or a recording shows to people: [`report`], [`inspect`], [`explain`], [`view`].

pub mod explain;
pub mod inspect;
mod numbers;
mod page;
pub mod plot;
pub mod report;
mod verdict;
pub mod view;
