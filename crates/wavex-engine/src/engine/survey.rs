//! Sensor models of a survey, learnt from waveforms of all its inputs.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::ops::ControlFlow;
use std::sync::Arc;

use rayon::ThreadPool;

use super::progress::Phase;
use super::{Cause, Input, Options, ProgressMode, RunError, inputs, observe, pool, run_context};
use crate::job::{Job, ModelScope};
use wavex_line::scan_line::ScanLine;
use wavex_line::stage::{
    Context, Instrument, InstrumentModel, Learning, Learns, Measured, Plan, RunContext, SensorDrift,
    StageError, SurveyModels,
};

/// Minimum number of waveforms taken from each input.
const MIN_WAVEFORMS: u64 = 1000;

/// Number of waveforms from which an input is compared with the others.
const MEASURED_WAVEFORMS: u64 = 2000;

/// Largest differences of an input from the median of its instrument, besides four of its standard
/// deviations. Background: part of the noise.
const BACKGROUND: f64 = 0.5;
/// Relative difference of the noise.
const NOISE: f64 = 0.2;
/// Relative difference of the pulse width.
const WIDTH: f64 = 0.03;
/// Relative difference of the gain ratio of the receivers.
const GAIN: f64 = 0.03;
/// Difference of the delay of the receivers, ns.
const DELAY_NS: f64 = 0.1;

/// Sensor models for a run: read from `survey_model`, otherwise learnt from all inputs.
///
/// `None` if each input has its own model: with one input, with `model = "input"`, or if no stage
/// calibrates.
///
/// # Errors
/// If the file cannot be read, the job has no valid input, or the user interrupts.
pub fn survey_models(job: &Job, options: &Options) -> Result<Option<SurveyModels>, RunError> {
    if !calibrates(job) {
        return Ok(None);
    }
    if let Some(name) = &job.settings.survey_model {
        let models = SurveyModels::read(&options.input_dir.join(name)).map_err(RunError::of_job)?;
        // A report has only its own inputs: a survey may have a run for each of thousands.
        let inputs = inputs(job, &options.input_dir)?;
        let stems: BTreeSet<&str> = inputs.iter().map(|input| input.stem.as_str()).collect();
        return Ok(Some(models.only(&stems)));
    }
    let inputs = inputs(job, &options.input_dir)?;
    if shares_models(job, inputs.len()) { learn(job, options, inputs).map(Some) } else { Ok(None) }
}

/// Whether a run over this many inputs learns sensor models from all of them.
pub fn shares_models(job: &Job, inputs: usize) -> bool {
    let is_survey = job.settings.model == ModelScope::Survey && job.settings.survey_model.is_none();
    is_survey && inputs > 1 && calibrates(job)
}

/// Learns the sensor models from all inputs of a job, even from a single one.
///
/// # Errors
/// If no stage calibrates, the job has no valid input, or the user interrupts.
pub fn learn_survey_models(job: &Job, options: &Options) -> Result<SurveyModels, RunError> {
    if !calibrates(job) {
        let problem = "no stage of the job estimates a sensor model";
        let remedy = "add `calibrate` without `load` and `preset`";
        return Err(RunError::of_job(StageError::failed(problem, remedy)));
    }
    learn(job, options, inputs(job, &options.input_dir)?)
}

fn learns(job: &Job, stage: usize) -> Option<Learns> {
    match &job.stages[stage].planned.plan {
        Plan::Transform(plan) => plan.learns(),
        _ => None,
    }
}

fn calibrates(job: &Job) -> bool {
    (0..job.stages.len()).filter_map(|stage| learns(job, stage)).any(|learns| learns.makes_model)
}

fn learn(job: &Job, options: &Options, inputs: Vec<Input>) -> Result<SurveyModels, RunError> {
    // Standard input and pipes cannot be read twice.
    let inputs: Vec<Input> = inputs.into_iter().filter(|input| input.path.is_file()).collect();
    let rows = inputs.iter().map(|input| SensorDrift { stem: input.stem.clone(), ..SensorDrift::default() });
    let models = SurveyModels { inputs: rows.collect(), ..SurveyModels::new() };
    let mut survey = SurveyLearner { job, options, models, pool: pool::start(options)? };
    for stage in 0..job.stages.len() {
        if let Some(learns) = learns(job, stage) {
            survey.learn(stage, learns, &inputs)?;
        }
    }
    survey.models.inputs.iter().filter_map(|input| Some((&input.stem, input.own_model.as_ref()?))).for_each(
        |(stem, reason)| {
            tracing::warn!("{stem}: calibrated on its own, because it contradicts the survey: {reason}");
        },
    );
    Ok(survey.models)
}

struct SurveyLearner<'a> {
    job: &'a Job,
    options: &'a Options,
    models: SurveyModels,
    pool: Option<Arc<ThreadPool>>,
}

impl SurveyLearner<'_> {
    /// Learns what a stage learns, from the lines that reach it.
    fn learn(&mut self, stage: usize, learns: Learns, inputs: &[Input]) -> Result<(), RunError> {
        let inputs_n = inputs.len().max(1);
        let pooled = learns.waveforms.div_ceil(inputs_n as u64);
        let limit = usize::try_from(self.job.settings.memory_mb).unwrap_or(usize::MAX / 1_000_000);
        let bytes = limit.saturating_mul(500_000) / inputs_n;
        let mut pooled_bytes = 0;
        let mut samples: Vec<Vec<ScanLine>> = Vec::with_capacity(inputs.len());
        let known = Arc::new(self.models.clone());
        let mut progress = Phase::new("calibrate", "calibrating", self.options.progress, inputs.len());
        for (number, input) in inputs.iter().enumerate() {
            progress.show(&input.stem, number, 0.0);
            let mut lines = match self.models.inputs[number].own_model {
                None => self.sample(stage, input, &known, [pooled.max(MIN_WAVEFORMS), bytes as u64])?,
                Some(_) => Vec::new(),
            };
            self.assign(number, &lines);
            self.measure(stage, number, &mut lines)?;
            let step = waveforms(&lines) / pooled;
            let (kept, _) = thinned(lines, step);
            let kept_bytes: usize = kept.iter().map(ScanLine::bytes).sum();
            // A line may be larger than the share of its input: the first inputs then fill the memory.
            let has_room = pooled_bytes + kept_bytes <= inputs_n * bytes;
            pooled_bytes += if has_room { kept_bytes } else { 0 };
            samples.push(if has_room { kept } else { Vec::new() });
        }
        for instrument in 0..self.models.instruments.len() {
            let of_instrument: Vec<usize> = (0..inputs.len())
                .filter(|&of| self.models.inputs[of].instrument == Some(instrument))
                .collect();
            mark_contradictions(&mut self.models.inputs, &of_instrument);
            let agreeing: Vec<usize> = of_instrument
                .iter()
                .copied()
                .filter(|&of| self.models.inputs[of].own_model.is_none())
                .collect();
            let mut lines: Vec<ScanLine> =
                agreeing.iter().flat_map(|&of| std::mem::take(&mut samples[of])).collect();
            if lines.is_empty() {
                continue;
            }
            let mut cx = Context::of_run();
            let mut known = self.models.instruments[instrument].clone();
            let learnt = self.teach(stage, &mut lines, &mut known, &mut cx, false)?;
            let counters = cx.counters();
            known.notes.extend(counters.warnings().chain(counters.findings.iter().cloned()));
            known.inputs = agreeing.len();
            match learnt {
                Ok(()) => self.models.instruments[instrument] = known,
                Err(error) if learns.makes_model => {
                    self.models.instruments[instrument].notes.push(error.to_string());
                }
                Err(_) => {}
            }
        }
        Ok(())
    }

    /// First lines of an input that reach a stage, up to this number of waveforms or bytes.
    ///
    /// None if the input fails: its own run reports the error.
    fn sample(
        &self,
        stage: usize,
        input: &Input,
        known: &Arc<SurveyModels>,
        [wanted, bytes]: [u64; 2],
    ) -> Result<Vec<ScanLine>, RunError> {
        let mut upstream = self.job.clone();
        upstream.stages.truncate(stage);
        upstream.stages.retain(|stage| !matches!(stage.planned.plan, Plan::Sink(_)));
        let user = self.options.cancel.clone();
        let look = move |sample: &mut SampledLines, line: &ScanLine| {
            sample.waveforms += line.stats.nw;
            sample.bytes += line.bytes() as u64;
            sample.lines.push(line.copied());
            let is_enough = sample.waveforms >= wanted || sample.bytes >= bytes || user.is_cancelled();
            if is_enough { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        // A single worker, so that lines leave in order: those taken depend on nothing else.
        let options = Options {
            survey: Some(Arc::clone(known)),
            threads: 1,
            progress: ProgressMode::Hidden,
            profile: false,
            ..self.options.clone()
        };
        let input_again = input.clone();
        let seen =
            observe(&upstream, input_again, &options, Context::default(), SampledLines::default(), look);
        if self.options.cancel.is_cancelled() {
            return Err(RunError { stage: None, input: None, cause: Cause::Interrupted });
        }
        let mut lines = seen.map(|sample| sample.lines).unwrap_or_default();
        lines.sort_by_key(|line| line.line);
        Ok(lines)
    }

    /// Notes the instrument of an input.
    fn assign(&mut self, number: usize, lines: &[ScanLine]) {
        let Some(first) = lines.first() else { return };
        let instrument = Instrument::of(&first.input);
        let known = &mut self.models.instruments;
        let found = known.iter().position(|model| model.instrument == instrument);
        self.models.inputs[number].instrument = Some(found.unwrap_or_else(|| {
            known.push(InstrumentModel { instrument, ..InstrumentModel::default() });
            known.len() - 1
        }));
    }

    /// Learns from one input alone, to compare it with the others.
    fn measure(&mut self, stage: usize, number: usize, lines: &mut Vec<ScanLine>) -> Result<(), RunError> {
        let Some(instrument) = self.models.inputs[number].instrument.filter(|_| !lines.is_empty()) else {
            return Ok(());
        };
        let mut alone = self.models.instruments[instrument].clone();
        alone.fusion = None;
        let of_survey = alone.sensor_model.clone();
        let waveforms = waveforms(lines);
        let (mut chosen, others) = thinned(std::mem::take(lines), waveforms.div_ceil(MEASURED_WAVEFORMS));
        let learnt = self.teach(stage, &mut chosen, &mut alone, &mut Context::default(), true)?;
        lines.extend(chosen.into_iter().chain(others));
        lines.sort_by_key(|line| line.line);
        let row = &mut self.models.inputs[number];
        row.waveforms = row.waveforms.max(waveforms);
        if learnt.is_ok() {
            row.measured(&alone, of_survey.as_deref());
        }
        Ok(())
    }

    /// Has a stage learn from lines; the outer error is an interruption.
    fn teach(
        &self,
        stage: usize,
        lines: &mut Vec<ScanLine>,
        known: &mut InstrumentModel,
        cx: &mut Context,
        only_compares: bool,
    ) -> Result<Result<(), StageError>, RunError> {
        let Plan::Transform(plan) = &self.job.stages[stage].planned.plan else { return Ok(Ok(())) };
        let input = Input::default();
        let run: RunContext = run_context(self.options, input, self.pool.clone());
        let learnt = plan.learn(lines, &mut Learning { run: &run, known, cx, only_compares });
        match learnt {
            _ if self.options.cancel.is_cancelled() => {
                Err(RunError { stage: None, input: None, cause: Cause::Interrupted })
            }
            learnt => Ok(learnt),
        }
    }
}

fn waveforms(lines: &[ScanLine]) -> u64 {
    lines.iter().map(|line| line.stats.nw).sum()
}

/// One of every `step` lines, and the others.
fn thinned(lines: Vec<ScanLine>, step: u64) -> (Vec<ScanLine>, Vec<ScanLine>) {
    let (chosen, others): (Vec<_>, Vec<_>) =
        (0..).zip(lines).partition(|(place, _): &(u64, ScanLine)| place % step.max(1) == 0);
    let lines = |numbered: Vec<(u64, ScanLine)>| numbered.into_iter().map(|(_, line)| line).collect();
    (lines(chosen), lines(others))
}

/// Lines of an input.
#[derive(Default)]
struct SampledLines {
    lines: Vec<ScanLine>,
    waveforms: u64,
    bytes: u64,
}

/// Marks inputs that differ from the median of their instrument.
///
/// If more than half of them do, all have their own models.
fn mark_contradictions(rows: &mut [SensorDrift], of_instrument: &[usize]) {
    let noise_dn: Vec<f64> = (0..3)
        .map(|channel| {
            let of_channel =
                |&of: &usize| rows[of].channels()[channel].1.map(|found| found.noise_sd_dn.value);
            median(of_instrument.iter().filter_map(of_channel).collect())
        })
        .collect();
    let mut reasons = vec![String::new(); rows.len()];
    for (name, unit, of_row, tolerance) in quantities(&noise_dn) {
        let found: Vec<(usize, Measured)> =
            of_instrument.iter().filter_map(|&of| Some((of, of_row(&rows[of])?))).collect();
        let usual = median(found.iter().map(|(_, measured)| measured.value).collect());
        for (of, Measured { value, sd }) in found {
            let most = tolerance.at(usual) + 4.0 * sd;
            if (value - usual).abs() > most && reasons[of].is_empty() {
                let _ = write!(
                    reasons[of],
                    "{name} {value:.4}{unit} instead of {usual:.4}{unit}, more than {most:.4}{unit} apart"
                );
            }
        }
    }
    for &of in of_instrument {
        let reason = std::mem::take(&mut reasons[of]);
        if !reason.is_empty() {
            rows[of].own_model.get_or_insert(reason);
        }
    }
    let own = of_instrument.iter().filter(|&&of| rows[of].own_model.is_some()).count();
    if 2 * own > of_instrument.len() {
        for &of in of_instrument {
            rows[of].own_model.get_or_insert("most inputs of this instrument differ".to_owned());
        }
    }
}

/// Allowed difference.
enum Tolerance {
    Absolute(f64),
    Relative(f64),
}

impl Tolerance {
    fn at(&self, usual: f64) -> f64 {
        match self {
            Tolerance::Absolute(most) => *most,
            Tolerance::Relative(most) => most * usual.abs(),
        }
    }
}

type OfRow = Box<dyn Fn(&SensorDrift) -> Option<Measured>>;

/// Compared quantities: name, unit, value, allowed difference.
fn quantities(noise_dn: &[f64]) -> Vec<(String, &'static str, OfRow, Tolerance)> {
    let mut quantities: Vec<(String, &'static str, OfRow, Tolerance)> = vec![
        ("gain ratio".into(), "", Box::new(|row| row.gain_ratio), Tolerance::Relative(GAIN)),
        ("delay".into(), " ns", Box::new(|row| row.delay_ns), Tolerance::Absolute(DELAY_NS)),
    ];
    for (channel, (name, _)) in SensorDrift::default().channels().into_iter().enumerate() {
        let background: OfRow =
            Box::new(move |row| row.channels()[channel].1.map(|found| found.background_dn));
        let noise: OfRow = Box::new(move |row| row.channels()[channel].1.map(|found| found.noise_sd_dn));
        let width: OfRow = Box::new(move |row| row.channels()[channel].1.map(|found| found.pulse_fwhm_ns));
        let least_dn = BACKGROUND * noise_dn[channel];
        quantities.push((format!("{name} background"), " DN", background, Tolerance::Absolute(least_dn)));
        quantities.push((format!("{name} noise"), " DN", noise, Tolerance::Relative(NOISE)));
        quantities.push((format!("{name} pulse width"), " ns", width, Tolerance::Relative(WIDTH)));
    }
    quantities
}

/// Median of values, of an even number the mean of the middle two; NaN of none.
///
/// `wavex_simd::statistics::median` takes the upper one. A survey may have only two inputs, and both
/// must be at the same distance from the median.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        n => 0.5 * (values[(n - 1) / 2] + values[n / 2]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_line::stage::ChannelDrift;

    fn row(noise_dn: f64, background_dn: f64) -> SensorDrift {
        let measured = |value| Measured { value, sd: 0.01 };
        let low_power = ChannelDrift {
            background_dn: measured(background_dn),
            noise_sd_dn: measured(noise_dn),
            pulse_fwhm_ns: measured(4.4),
        };
        SensorDrift { low_power: Some(low_power), ..SensorDrift::default() }
    }

    #[test]
    fn an_input_that_differs_has_its_own_model() {
        let mut rows = vec![row(1.0, 2.0), row(1.1, 2.2), row(0.95, 2.1), row(2.0, 2.1), row(1.0, 3.0)];
        mark_contradictions(&mut rows, &[0, 1, 2, 3, 4]);
        let reasons: Vec<Option<&str>> = rows.iter().map(|row| row.own_model.as_deref()).collect();
        assert_eq!(
            reasons,
            [
                None,
                None,
                None,
                Some("low power noise 2.0000 DN instead of 1.0000 DN, more than 0.2400 DN apart"),
                Some("low power background 3.0000 DN instead of 2.1000 DN, more than 0.5400 DN apart"),
            ]
        );
    }

    #[test]
    fn inputs_without_a_majority_have_their_own_models() {
        let mut rows = vec![row(1.0, 2.0), row(4.0, 2.0), row(2.0, 2.0)];
        mark_contradictions(&mut rows, &[0, 1, 2]);
        assert!(rows.iter().all(|row| row.own_model.is_some()));
    }
}
