//! The kernels allocate memory only at the start, not per waveform.

use std::sync::Arc;

use wavex_signal::decompose::DecomposeSettings;
use wavex_signal::decompose::Waveform;
use wavex_signal::decompose::{BatchDecomposer, Decompositions, Mode, Tables};
use wavex_simd::SimdLevel;
use wavex_testkit::waveforms::{SAMPLES, Scene, Waveforms, model, noise};

use super::{REQUESTS, RUNNING};

const WARM_UP: usize = 32_000;
const COUNTED: usize = 8_000;

/// In the mixed scene, the plain kernels decompose one in 500 waveforms.
#[test]
fn decomposition_allocates_nothing_per_waveform() {
    let _running = RUNNING.lock();
    let noise = noise();
    let model = model(&noise);
    let tables = Tables::new(&model).map(Arc::new);
    let mut waveforms = Waveforms::new(&model, &noise, Scene::Mixed, 5);
    let mut samples = Vec::new();
    (0..WARM_UP + COUNTED).for_each(|_| drop(waveforms.next(&mut samples)));
    let blocks: Vec<_> = samples.chunks(SAMPLES).map(|samples| Waveform { samples }).collect();
    let (first, then) = blocks.split_at(WARM_UP);
    for mode in [Mode::Fastest, Mode::FastSeparated, Mode::Refined] {
        let settings = DecomposeSettings::default();
        let mut kernels =
            BatchDecomposer::new(&model, tables.clone(), &settings, mode, SimdLevel::best()).unwrap();
        let mut outcomes = Decompositions::default();
        kernels.decompose(first, &mut outcomes);
        let (before, plain) = (REQUESTS.get(), kernels.left_to_plain());
        kernels.decompose(then, &mut outcomes);
        let (requests, plain) = (REQUESTS.get() - before, kernels.left_to_plain() - plain);
        println!(
            "{mode:?}: {requests} requests for {COUNTED} waveforms, {plain} of them by the plain kernels"
        );
        assert!(requests <= COUNTED / 1000, "{mode:?}: {requests}");
        assert_eq!(outcomes.len(), COUNTED);
    }
}
