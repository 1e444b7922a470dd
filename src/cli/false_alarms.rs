//! `wavex false-alarms`: false-return rates of pure noise by threshold.

use std::fmt::Write;

use clap::Args;

use super::Failure;
use super::terminal::print;
use wavex_signal::false_alarms::FilteredNoise;
use wavex_signal::noise::{ArNoise, fit_by_bic};

/// Noise correlations, thresholds and waveform size of the table.
#[derive(Args)]
pub(super) struct FalseAlarmArgs {
    /// Noise correlations, one column each: 0.6 at a lag of one sample, or 0.63:0.42:0.22 at lags
    /// of 1, 2, 3 samples
    #[arg(long, num_args = 1.., value_delimiter = ',', allow_negative_numbers = true)]
    #[arg(value_name = "RHO", default_values = ["0", "0.3", "0.6", "0.63:0.42:0.22:0.11"])]
    pub(super) correlation: Vec<String>,
    /// Thresholds, one row each
    #[arg(long, num_args = 1.., value_delimiter = ',', allow_negative_numbers = true)]
    #[arg(value_name = "SIGMA", default_values_t = [3.5, 4.0, 4.5, 5.0, 5.5, 6.0])]
    pub(super) sigma: Vec<f64>,
    /// Full width at half maximum of a pulse, samples
    #[arg(long, default_value_t = 4.5, allow_negative_numbers = true)]
    pub(super) fwhm: f64,
    /// Samples per waveform
    #[arg(long, default_value_t = 60.0, allow_negative_numbers = true)]
    pub(super) samples: f64,
}

/// Tolerance for equal correlations.
const SAME_CORRELATION: f64 = 1e-3;

/// Prints the table.
pub(super) fn false_alarms(args: &FalseAlarmArgs) -> Result<(), Failure> {
    check(args)?;
    let noises: Vec<ArNoise> = args.correlation.iter().map(|text| noise(text)).collect::<Result<_, _>>()?;
    print(&table(args, &noises))
}

/// Checks that the arguments are within the range of the table.
fn check(args: &FalseAlarmArgs) -> Result<(), Failure> {
    let within = |name: &str, value: f64, [low, high]: [f64; 2]| match (low..=high).contains(&value) {
        true => Ok(()),
        false => Err(Failure::Wrong(format!("--{name} {value}: must be between {low} and {high}"))),
    };
    args.sigma.iter().try_for_each(|&sigma| within("sigma", sigma, [1.0, 30.0]))?;
    within("fwhm", args.fwhm, [0.5, 100.0])?;
    within("samples", args.samples, [args.fwhm.ceil(), 65_535.0])
}

fn table(args: &FalseAlarmArgs, noises: &[ArNoise]) -> String {
    let filtered: Vec<FilteredNoise> =
        noises.iter().map(|noise| FilteredNoise::of(args.fwhm, noise)).collect();
    let mut text = format!(
        "Maxima of pure noise per waveform of {} samples, pulse of {} samples full width at half maximum,\n\
         by threshold (standard deviations after the matched filter) and correlation of the noise;\n\
         about half of them remain as returns\n\n",
        args.samples, args.fwhm
    );
    let row = |text: &mut String, head: &str, cells: Vec<String>| {
        let _ = writeln!(
            text,
            "{head:>8}{}",
            cells.iter().map(|cell| format!(" {cell:>14}")).collect::<String>()
        );
    };
    row(&mut text, "sigma", args.correlation.clone());
    for sigma in &args.sigma {
        let cells = filtered.iter().map(|noise| format!("{:.2e}", noise.per_waveform(*sigma, args.samples)));
        row(&mut text, &sigma.to_string(), cells.collect());
    }
    text.push_str(
        "\nRice's formula for the interpolated maxima that detection starts from. In 20 million simulated samples the\n\
         count is 0.97 to 1.00 times the formula at 3 and 3.5, and agrees within statistical error at 4 and 4.5\n\
         (5 and 13 %). The fit that follows keeps 0.45 to 0.48 of the maxima as returns.\n",
    );
    text
}

/// Noise with these autocorrelations at lags of 1, 2, ... samples.
///
/// `text` is `0.6` or a list such as `0.63:0.42:0.22:0.11`.
fn noise(text: &str) -> Result<ArNoise, Failure> {
    let wrong = |problem: &str| Failure::Wrong(format!("--correlation {text}: {problem}"));
    let lags: Result<Vec<f64>, _> = text.split(':').map(str::parse).collect();
    let lags = lags.map_err(|_| wrong("not a number or a list of numbers separated by `:`"))?;
    if lags.len() > 8 || !lags.iter().all(|rho| rho.abs() < 1.0) {
        return Err(wrong("give at most 8 correlations, each between -1 and 1"));
    }
    let autocovariance: Vec<f64> = [1.0].into_iter().chain(lags.iter().copied()).collect();
    // With this many samples the BIC does not limit the order.
    let found = fit_by_bic(&autocovariance, 1_000_000_000, lags.len());
    let has_them = |noise: &ArNoise| {
        let mut own = vec![0.0; autocovariance.len()];
        noise.autocovariance_into(&mut own);
        own.iter().zip(&autocovariance).all(|(own, asked)| (own - asked).abs() < SAME_CORRELATION)
    };
    found.filter(has_them).ok_or_else(|| wrong("no stationary noise has these correlations"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(correlation: &[&str]) -> FalseAlarmArgs {
        let correlation = correlation.iter().map(|text| text.to_string()).collect();
        FalseAlarmArgs { correlation, sigma: vec![4.0, 4.5], fwhm: 4.253, samples: 60.0 }
    }

    #[test]
    fn the_table_has_a_row_per_threshold_and_a_column_per_correlation() {
        let args = args(&["0", "0.6", "0.63:0.42:0.22:0.11"]);
        let noises: Vec<ArNoise> = args.correlation.iter().map(|text| noise(text).unwrap()).collect();
        let table = table(&args, &noises);
        let rows: Vec<Vec<&str>> =
            table.lines().skip(4).map(|line| line.split_whitespace().collect()).collect();
        assert_eq!(rows[0], ["sigma", "0", "0.6", "0.63:0.42:0.22:0.11"]);
        assert_eq!((rows[1][0], rows[1].len(), rows[2][0]), ("4", 4, "4.5"));
        // Rice's formula gives 1.7e-4 per 60 ns at 4.5 for a bandwidth of 0.44 rad/ns, which lies
        // between white noise and this noise.
        assert!(rows[2][1].starts_with("1.6e-4") || rows[2][1].starts_with("1.5"), "{}", rows[2][1]);
    }

    #[test]
    fn correlations_that_do_not_exist_are_refused() {
        let message = |text: &str| super::super::terminal::message(&noise(text).unwrap_err(), false);
        assert_eq!(
            message("half"),
            "error: --correlation half: not a number or a list of numbers separated by `:`\n"
        );
        assert_eq!(
            message("1.5"),
            "error: --correlation 1.5: give at most 8 correlations, each between -1 and 1\n"
        );
        for text in ["0.9:-0.9", "0.5:-0.8:0.9"] {
            assert_eq!(
                message(text),
                format!("error: --correlation {text}: no stationary noise has these correlations\n")
            );
        }
        assert!(["-0.3", "0.6:0.36", "0.6:0.9"].iter().all(|text| noise(text).is_ok()));
    }

    #[test]
    fn what_no_table_can_be_made_of_is_refused() {
        let message =
            |args: FalseAlarmArgs| super::super::terminal::message(&check(&args).unwrap_err(), false);
        let sigma = |sigma: f64| FalseAlarmArgs { sigma: vec![4.5, sigma], ..args(&["0"]) };
        assert_eq!(message(sigma(f64::NAN)), "error: --sigma NaN: must be between 1 and 30\n");
        assert_eq!(message(sigma(-1.0)), "error: --sigma -1: must be between 1 and 30\n");
        let fwhm = |fwhm: f64| FalseAlarmArgs { fwhm, ..args(&["0"]) };
        assert_eq!(message(fwhm(0.0)), "error: --fwhm 0: must be between 0.5 and 100\n");
        assert_eq!(message(fwhm(f64::INFINITY)), "error: --fwhm inf: must be between 0.5 and 100\n");
        let samples = |samples: f64| FalseAlarmArgs { samples, ..args(&["0"]) };
        assert_eq!(message(samples(-100.0)), "error: --samples -100: must be between 5 and 65535\n");
    }

    #[test]
    fn the_manual_shows_the_table() {
        let correlation = ["0", "0.3", "0.6", "0.63:0.42:0.22:0.11"];
        let args = FalseAlarmArgs {
            sigma: vec![3.5, 4.0, 4.5, 5.0, 5.5, 6.0],
            fwhm: 4.5,
            samples: 60.0,
            ..args(&correlation)
        };
        let noises: Vec<ArNoise> = args.correlation.iter().map(|text| noise(text).unwrap()).collect();
        let table = table(&args, &noises);
        let manual = include_str!("../../docs/explanation/method.md");
        assert!(table.lines().filter(|line| line.contains("e-")).all(|row| manual.contains(row)), "{table}");
    }
}
