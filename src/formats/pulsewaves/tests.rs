//! Tests of the reader: files spelled out, files damaged, and recordings against the peer's dumps.

mod build;
mod damage;
mod peer;
mod recordings;
mod records;
mod waves;
