//! Reader tests: handmade files, damaged files, and recordings compared with dumps of the reference
//! library.

mod build;
mod damage;
mod peer;
mod recordings;
mod records;
mod waves;
