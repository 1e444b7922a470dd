//! Tests of the scalar form on real recordings in `WAVEX_DATA`; none are in the repository.

use std::io::Read;
use std::path::{Path, PathBuf};

use crate::calibrate::{CalibrationSettings, calibrate};
use crate::decompose::Waveform;
use crate::decompose::{DecomposeSettings, Decomposer};
use crate::outgoing::OutgoingFitter;
use crate::sensor_model::Background;
use crate::simulated::moments;

fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("WAVEX_DATA").map(PathBuf::from);
    if folder.is_none() {
        println!("skipped: WAVEX_DATA not set");
    }
    folder
}

/// Segments of a text dump of PulseWaves with the given sampling type: "1" outgoing, "2" returning.
fn segments(dump: &Path, kind: &str, count: usize) -> Vec<Vec<u16>> {
    let mut text = String::new();
    flate2::read::GzDecoder::new(std::fs::File::open(dump).unwrap()).read_to_string(&mut text).unwrap();
    text.lines()
        .filter_map(|line| line.strip_prefix("S ")?.split_once(':'))
        .filter(|(head, _)| head.split_whitespace().nth(1) == Some(kind))
        .map(|(_, samples)| samples.split_whitespace().map(|s| s.parse().unwrap()).collect())
        .take(count)
        .collect()
}

fn blocks(segments: &[Vec<u16>]) -> impl Iterator<Item = Waveform<'_>> + Clone {
    segments.iter().map(|samples| Waveform { samples })
}

/// Rows of numbers below a header; non-numbers become NaN.
fn table(path: &Path) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).unwrap();
    let row = |line: &str| line.split(',').map(|v| v.parse().unwrap_or(f64::NAN)).collect();
    text.lines().skip(1).map(row).collect()
}

/// Median, and half the difference of the 16th and 84th percentiles.
fn robust(values: &mut [f64]) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    let at = |part: f64| values[(part * values.len() as f64) as usize];
    (at(0.5), 0.5 * (at(0.841) - at(0.159)))
}

/// RIEGL LMS-Q680, 8 bit, 1 GHz.
#[test]
fn riegl_echoes_are_calibrated_and_decomposed() {
    let Some(folder) = data() else { return };
    let echoes = segments(&folder.join("pulsewaves/riegl_example3.txt.gz"), "2", 3000);
    let model = calibrate(blocks(&echoes), &CalibrationSettings::echoes(1.0, 255.0)).unwrap();
    println!("{model:?}");
    assert_eq!(model.background, Background::Fixed);
    assert!(model.background_dn.iter().all(|level| (1.7..2.0).contains(level)));
    assert!((0.80..0.90).contains(&model.noise_sd_dn));
    assert!((0.58..0.66).contains(&model.autocorrelation[0]));
    assert!((4.0..4.2).contains(&model.pulse_fwhm_ns));
    let mut decomposer = Decomposer::new(&model, &DecomposeSettings::default(), 80).unwrap();
    let (mut returns, mut without) = (0, 0);
    for samples in &echoes {
        let outcome = decomposer.decompose(samples);
        let c = outcome.counts;
        assert_eq!(c.n_candidates + c.n_added, c.np + c.np_filtered() + c.np_merged + c.np_xtalk_dropped);
        returns += outcome.returns.len();
        without += usize::from(outcome.returns.is_empty());
    }
    println!("{returns} returns in {} waveforms, {without} without", echoes.len());
    assert!(without * 100 < echoes.len());
}

#[test]
fn riegl_outgoing_pulses_are_calibrated_and_fitted() {
    let Some(folder) = data() else { return };
    let pulses = segments(&folder.join("pulsewaves/riegl_example3.txt.gz"), "1", 3000);
    let model = calibrate(blocks(&pulses), &CalibrationSettings::reference(1.0, 255.0)).unwrap();
    println!("{model:?}");
    assert!((0.78..0.90).contains(&model.noise_sd_dn));
    assert!((4.2..4.4).contains(&model.pulse_fwhm_ns));
    let mut fitter = OutgoingFitter::new(&model, 80).unwrap();
    let fits: Vec<_> = pulses.iter().map(|samples| fitter.fit(samples).unwrap()).collect();
    let sd = moments(&fits.iter().map(|f| f.position_sd_samples).collect::<Vec<_>>()).0;
    let width = moments(&fits.iter().map(|f| f.fwhm_ns).collect::<Vec<_>>());
    let height = moments(&fits.iter().map(|f| f.amplitude_dn).collect::<Vec<_>>());
    println!("position sd {sd:.5} samples, width {width:.4?} ns, height {height:.2?} DN");
    assert!((0.005..0.010).contains(&sd));
    assert!(width.1 < 0.06 && height.1 < 0.05 * height.0);
}

/// RIEGL LMS-Q680i against the vendor's returns; without the outgoing pulse the sub-sample offset
/// is unknown.
#[test]
fn riegl_singles_agree_with_the_vendor() {
    let Some(folder) = data() else { return };
    let folder = folder.join("riegl_q680i_dev");
    let packets = std::fs::read(folder.join("riegl_q680i_dev.wdp")).unwrap();
    let rows = table(&folder.join("riegl_q680i_dev_vendor_returns.csv"));
    let samples = |row: &Vec<f64>| -> Vec<u16> {
        let (start, size) = (row[9] as usize, row[10] as usize);
        packets[start..start + size].chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect()
    };
    let first: Vec<_> = rows.iter().filter(|row| row[3] == 1.0).collect();
    let waveforms: Vec<_> = first.iter().map(|row| samples(row)).collect();
    let model = calibrate(blocks(&waveforms), &CalibrationSettings::echoes(1.0, 255.0)).unwrap();
    println!("{model:?}");
    let mut decomposer = Decomposer::new(&model, &DecomposeSettings::default(), 60).unwrap();
    let (mut positions, mut widths) = (vec![], vec![]);
    for (row, samples) in first.iter().zip(&waveforms).filter(|(row, _)| row[4] == 1.0) {
        let returns = decomposer.decompose(samples).returns;
        let found = returns.iter().max_by(|a, b| a.amplitude_dn.total_cmp(&b.amplitude_dn)).unwrap();
        positions.push(found.position_samples - row[11] / 1000.0);
        widths.push(found.fwhm_ns - row[13]);
    }
    let (n, position, width) = (positions.len(), robust(&mut positions), robust(&mut widths));
    println!(
        "{n} single returns: position minus vendor's {position:.3?} ns, width minus vendor's {width:.3?} ns"
    );
    assert!((0.90..0.96).contains(&model.noise_sd_dn) && (0.58..0.66).contains(&model.autocorrelation[0]));
    // Even and odd samples of this digitiser have different levels.
    for (phase, level) in [2.18, 2.41, 2.18, 2.41].iter().enumerate() {
        assert!((model.background_dn[phase] - level).abs() < 0.05);
    }
    assert!(position.1 < 0.5);
    assert!(width.0.abs() < 0.05 && width.1 < 0.08);
}

/// NEON (Optech Gemini): pulses of 15 ns in short blocks that begin on the rising edge, against the
/// Gaussians of an R package.
#[test]
fn neon_is_decomposed_unattended() {
    let Some(folder) = data() else { return };
    let waveforms: Vec<Vec<u16>> = table(&folder.join("neon/return_1_250.csv"))
        .iter()
        .map(|row| {
            // Rows are padded with zeros.
            let end = row.iter().rposition(|&v| v > 0.0).map_or(0, |last| last + 1);
            row[..end].iter().map(|&v| v as u16).collect()
        })
        .collect();
    let model = calibrate(blocks(&waveforms), &CalibrationSettings::echoes(1.0, 4095.0)).unwrap();
    println!("{model:?}");
    assert_eq!(model.background, Background::PerWaveform);
    let theirs = table(&folder.join("neon/decomposition_1_250.csv"));
    // The R package has one Gaussian per maximum, however skewed, and subtracts the smallest
    // sample.
    let [second_look, detection] = [16, 0].map(|max_added| {
        let settings = DecomposeSettings { max_added, ..DecomposeSettings::default() };
        let mut decomposer = Decomposer::new(&model, &settings, 104).unwrap();
        let mut differences = singles_less_theirs(&mut decomposer, &waveforms, &theirs);
        let (constant, spread) = robust(&mut differences);
        let near = differences.iter().filter(|d| (*d - constant).abs() < 0.25).count();
        println!(
            "at most {max_added} added: {} singles, constant {constant:.3} ns, spread {spread:.3} ns, \
             within 0.25 ns {near}",
            differences.len()
        );
        (differences.len(), constant, near)
    });
    assert_eq!((second_look.0, detection.0), (156, 156));
    // The R package counts samples from 1.
    assert!((detection.1 + 1.0).abs() < 0.15);
    assert!(detection.2 * 100 >= 95 * detection.0 && second_look.2 * 100 >= 95 * second_look.0);
}

/// Position of the strongest return minus the component's, for waveforms with one component.
fn singles_less_theirs(decomposer: &mut Decomposer, waveforms: &[Vec<u16>], theirs: &[Vec<f64>]) -> Vec<f64> {
    let mut differences = vec![];
    for (i, samples) in waveforms.iter().enumerate() {
        let components: Vec<f64> =
            theirs.iter().filter(|row| row[0] as usize == i + 1).map(|row| row[2]).collect();
        let returns = decomposer.decompose(samples).returns;
        let strongest = returns.iter().max_by(|a, b| a.amplitude_dn.total_cmp(&b.amplitude_dn));
        if let ([u], Some(strongest)) = (&components[..], strongest) {
            differences.push(strongest.position_samples - u);
        }
    }
    differences
}
