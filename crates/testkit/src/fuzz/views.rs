//! Requests to the server of `wavex view`.

use std::path::PathBuf;
use std::sync::OnceLock;
use std::thread;
use std::time::Duration;
use wavex::registry::STAGES;

use wavex::engine::Cancel;
use wavex::job::{Job, Override};
use wavex::view::{self, Opened, View};

/// A small flight, which is kept in memory.
const JOB: &str = "\
[[stage]]
type = 'simulate'
lines = 3
shots_per_line = 100
[[stage]]
type = 'calibrate'
waveforms = 200
[[stage]]
type = 'decompose'
[[stage]]
type = 'georeference'
";
/// Most requests of an input, so that its time is bounded.
const MOST_REQUESTS: usize = 8;
/// Most bytes of an answer: the page, or all that is found in the flight.
const MOST_BYTES: usize = 1 << 22;

/// Requests, one per line, to a view that stays open: each is answered or refused.
pub fn view(bytes: &[u8]) {
    let view = flight();
    for address in String::from_utf8_lossy(bytes).lines().take(MOST_REQUESTS) {
        let (status, content) = view.answer(address);
        assert!(matches!(status, 200 | 400 | 404 | 410), "{address}: {status}");
        assert!(content.len() <= MOST_BYTES, "{address}: {} bytes", content.len());
        if status != 200 {
            let refusal: serde_json::Value = serde_json::from_slice(&content).unwrap();
            assert!(refusal["error"].as_str().is_some_and(|text| !text.is_empty()), "{address}");
        }
    }
}

/// The view of the flight, once it has been read.
fn flight() -> &'static View {
    static VIEW: OnceLock<View> = OnceLock::new();
    VIEW.get_or_init(|| {
        let with = |set: &[String]| {
            let overrides: Vec<Override> = set.iter().map(Override::new).collect();
            Job::parse(STAGES, "job.toml", JOB, &overrides).map_err(|errors| errors.to_string())
        };
        let opened = Opened {
            title: "flight".into(),
            kind: "job",
            without_waveforms: None,
            job: with(&[]).unwrap(),
            with: Box::new(with),
            input_dir: PathBuf::new(),
            folder: None,
            memory_bytes: 1 << 24,
        };
        let view = view::open(opened, 0, Cancel::default()).unwrap();
        loop {
            match view.ended() {
                None => thread::sleep(Duration::from_millis(10)),
                Some(ended) => break assert!(ended.unwrap() > 0),
            }
        }
        view
    })
}
