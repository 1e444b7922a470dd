//! Scan lines of a simulated flight.

use std::path::PathBuf;
use std::sync::Arc;

use super::{FULL_SCALE_DN, GainFollows, INTERVAL_NS, Simulate};
use wavex_line::scan_line::{
    AmplitudeTable, Blocks, Channel, Emission, EmissionReference, Frame, GainControl, InputInfo, ScanLine,
    TimeScale, emission_flags,
};
use wavex_line::stage::{Result, StageError};
use wavex_simulation::detector::{DetectorModel, Sensitivity};
use wavex_simulation::platform::Platform;
use wavex_simulation::pulse::WidthIndex;
use wavex_simulation::random::{Normal, Purpose, Random};
use wavex_simulation::receiver::{ReceivedEcho, SampleWindow, SimulatedReceiver, TRIGGER_DN};
use wavex_simulation::scanner::{self, ScanMechanism, Scanner, ScannerShot};
use wavex_simulation::scene::{Class, Hit, Scene, SceneBeam};
use wavex_simulation::truth::TrueReturn;
use wavex_simulation::world::{self, World};
use wavex_simulation::{GROUP_VELOCITY_MPS, time_of_flight_ns};

/// Relative standard deviation of the pulse energy.
const ENERGY_SD: f64 = 0.01;
/// Target height of the strongest echo for automatic gain control, DN.
const WANTED_DN: f64 = 150.0;
/// Largest range of false echoes, relative to the range of the lowest ground.
const FALSE_ALARM_REACH: f64 = 1.25;

/// A flight whose scan lines can be generated in any order.
#[derive(Debug)]
pub(super) struct SimulatedFlight {
    input: Arc<InputInfo>,
    pub(super) seed: u64,
    pub(super) lines: u32,
    dropout_rate: f64,
    false_alarm_rate: f64,
    blind_gap_ns: f64,
    ground_amplitude_dn: f64,
    /// Start of the flight, s of the GPS week.
    start_time_s: f64,
    as_recorded: bool,
    /// Error of the recorded sensor height, m, if there is no trajectory.
    height_error_m: f64,
    /// Whether the truth is requested.
    pub(super) tells_truth: bool,
    /// Largest time of flight of an echo, ns.
    pub(super) longest_ns: f64,
    pub(super) scanner: Scanner,
    platform: Platform,
    world: World,
    scene: Scene,
    detector: DetectorModel,
    pub(super) receiver: SimulatedReceiver,
    normal: Normal,
    agc: Option<Agc>,
    /// Buffers for one shot: hits, echoes (in the same order) and blocks.
    pub(super) hits: Vec<Hit>,
    pub(super) echoes: Vec<ReceivedEcho>,
    windows: Vec<SampleWindow>,
}

/// An emitted pulse.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cast {
    pub(super) line: u32,
    pub(super) index: u32,
    pub(super) shot: ScannerShot,
    /// Its beam through the scene.
    beam: SceneBeam,
    pub(super) pulse: SimulatedPulse,
}

/// Random properties of a pulse.
#[derive(Clone, Copy, Debug)]
pub(super) struct SimulatedPulse {
    /// Emission time after the tick of the sample clock, ns.
    pub(super) emission_ns: f64,
    /// Energy relative to the mean.
    pub(super) energy: f64,
    /// No echo is received.
    is_lost: bool,
}

/// Recording conditions of an echo.
#[derive(Clone, Copy, Debug)]
pub(super) struct RecordingConditions {
    pub(super) zone: i16,
    pub(super) in_high_power: bool,
    pub(super) gain: f64,
}

/// Automatic gain control.
#[derive(Clone, Copy, Debug)]
struct Agc {
    range: [f64; 2],
    follows: GainFollows,
    period_s: f64,
}

impl Agc {
    /// `None` if the gain is constant.
    fn of(config: &Simulate) -> Option<Agc> {
        let agc =
            Agc { range: config.gain_range, follows: config.gain_follows, period_s: config.gain_period_s };
        config.has_gain_control().then_some(agc)
    }

    fn gain(&self, since_start_s: f64, before_dn: Option<f64>) -> f64 {
        let [least, greatest] = self.range;
        match self.follows {
            GainFollows::Time => {
                let turn = libm::cos(core::f64::consts::TAU * since_start_s / self.period_s);
                (least * libm::pow(greatest / least, 0.5 - 0.5 * turn)).clamp(least, greatest)
            }
            GainFollows::Echo => before_dn.map_or(greatest, |dn| (WANTED_DN / dn).clamp(least, greatest)),
        }
    }
}

/// Highest of these echoes at gain 1, DN.
pub(super) fn strongest(echoes: &[ReceivedEcho]) -> Option<f64> {
    echoes.iter().map(|echo| echo.amplitude_dn).reduce(f64::max)
}

impl SimulatedFlight {
    pub(super) fn new(config: &Simulate) -> Result<SimulatedFlight> {
        let receiver = SimulatedReceiver::new(&config.receiver()).map_err(|_| {
            StageError::failed(
                "no noise has this spread and autocorrelation",
                "leave `noise_autocorrelation` out",
            )
        })?;
        // The scanner can be higher than the aircraft's reference point.
        let furthest_m = (config.flying_height_m + 20.0) / libm::cos(config.steepest_deg().to_radians());
        Ok(SimulatedFlight {
            input: Arc::new(input(config)),
            seed: config.seed,
            lines: config.lines,
            dropout_rate: config.dropout_rate,
            false_alarm_rate: config.false_alarm_rate,
            blind_gap_ns: config.blind_gap_ns,
            ground_amplitude_dn: config.ground_amplitude_dn,
            start_time_s: config.start_time_s,
            as_recorded: config.as_recorded,
            height_error_m: config.height_error_m,
            tells_truth: true,
            longest_ns: FALSE_ALARM_REACH * time_of_flight_ns(furthest_m),
            scanner: config.scanner(),
            platform: config.platform(),
            world: config.world(),
            scene: config.scene(),
            detector: config.detector(),
            receiver,
            normal: Normal::default(),
            agc: Agc::of(config),
            hits: Vec::new(),
            echoes: Vec::new(),
            windows: Vec::new(),
        })
    }

    /// Sets whether lines are generated with their truth.
    pub(super) fn telling_truth(self, tells_truth: bool) -> SimulatedFlight {
        SimulatedFlight { tells_truth, ..self }
    }

    /// Generates a scan line and the truth of its returns.
    pub(super) fn line(&mut self, line: u32) -> (ScanLine, Vec<TrueReturn>) {
        let (mut blocks, mut truth) = (Blocks::default(), Vec::new());
        let emissions = match self.as_recorded {
            false => self.resolved_line(line, &mut blocks, &mut truth),
            true => self.recorded_line(line, &mut blocks, &mut truth),
        };
        (ScanLine::of_shots(Arc::clone(&self.input), line, emissions, blocks), truth)
    }

    /// Generates a line whose blocks are stored with the shots that caused them.
    fn resolved_line(
        &mut self,
        line: u32,
        blocks: &mut Blocks,
        truth: &mut Vec<TrueReturn>,
    ) -> Vec<Emission> {
        let shots = self.scanner.shots_per_line;
        let mut emissions = Vec::with_capacity(shots as usize);
        let mut before = None;
        for index in 0..shots {
            let cast = self.cast(line, index);
            self.receive(&cast);
            let gain = self.gain(&cast, before);
            self.receiver.set_gain(gain);
            before = strongest(&self.echoes);
            self.receiver.windows(&self.echoes, &mut self.windows);
            let zone = self.record(&cast, blocks);
            if self.tells_truth {
                self.tell(&cast, zone, truth);
            }
            emissions.push(self.emission(&cast, Some(zone)));
        }
        emissions
    }

    /// Gain of the blocks recorded with a shot.
    ///
    /// `before` is the strongest echo of the previous shot of the line, DN.
    pub(super) fn gain(&self, cast: &Cast, before: Option<f64>) -> f64 {
        self.agc.as_ref().map_or(1.0, |agc| agc.gain(cast.shot.since_start_s(), before))
    }

    /// Emits a pulse.
    pub(super) fn cast(&self, line: u32, index: u32) -> Cast {
        let shot = self.scanner.shot(line, index);
        let mut random = Random::of_shot(self.seed, line, index, Purpose::Laser);
        let pulse = SimulatedPulse {
            emission_ns: INTERVAL_NS * random.uniform(),
            is_lost: random.uniform() < self.dropout_rate,
            energy: 1.0 + ENERGY_SD * self.normal.draw(&mut random),
        };
        let beam = self.platform.beam(shot.since_start_s(), shot.direction_in_scanner);
        Cast { line, index, shot, beam, pulse }
    }

    /// Computes the hits and echoes of a pulse, in order of time.
    ///
    /// Only echoes received while the receiver is open.
    pub(super) fn receive(&mut self, cast: &Cast) {
        self.hits.clear();
        if !cast.pulse.is_lost {
            self.scene.hits(&cast.beam, &mut self.hits);
        }
        self.echoes.clear();
        for hit in &self.hits {
            let width = self.receiver.response().width(time_of_flight_ns(hit.spread_m));
            let energy_dn = self.ground_amplitude_dn * cast.pulse.energy * hit.energy;
            let linear_dn = energy_dn * self.receiver.response().peak(width);
            self.echoes.push(self.echo(cast, hit.range_m, linear_dn, width));
        }
        if self.false_alarm_rate > 0.0 {
            self.raise_false_alarm(cast);
        }
        if self.blind_gap_ns > 0.0 {
            self.drop_blind_echoes(cast);
        }
    }

    /// Echo of a target at a range, with this linear peak amplitude.
    fn echo(&self, cast: &Cast, range_m: f64, linear_dn: f64, width: WidthIndex) -> ReceivedEcho {
        ReceivedEcho {
            time_ns: cast.pulse.emission_ns + time_of_flight_ns(range_m),
            amplitude_dn: self.detector.height_dn(Sensitivity::Sensitive, linear_dn),
            high_power_dn: self.detector.height_dn(Sensitivity::Coarse, linear_dn),
            linear_dn,
            width,
        }
    }

    /// Adds a false echo to a fraction of the pulses.
    fn raise_false_alarm(&mut self, cast: &Cast) {
        let mut random = Random::of_shot(self.seed, cast.line, cast.index, Purpose::FalseAlarms);
        if random.uniform() >= self.false_alarm_rate {
            return;
        }
        let range_m = random.uniform() * 0.5e-9 * GROUP_VELOCITY_MPS * self.longest_ns;
        let flat = self.receiver.response().width(0.0);
        let echo = self.echo(cast, range_m, TRIGGER_DN * (1.0 + random.uniform()), flat);
        let at = self.hits.partition_point(|hit| hit.range_m < range_m);
        self.hits.insert(at, Hit { class: Class::FalseAlarm, range_m, energy: 0.0, spread_m: 0.0 });
        self.echoes.insert(at, echo);
    }

    /// Removes echoes received in the gap around an emission.
    fn drop_blind_echoes(&mut self, cast: &Cast) {
        for k in (0..self.echoes.len()).rev() {
            if self.is_blind(cast.shot.since_start_ns as f64 + self.echoes[k].time_ns) {
                self.echoes.remove(k);
                self.hits.remove(k);
            }
        }
    }

    /// Whether a time, ns from the start, is in the gap around an emission.
    fn is_blind(&self, time_ns: f64) -> bool {
        let pulses = 1e-9 * time_ns * self.scanner.pulse_rate_hz;
        let line = (pulses / self.scanner.pulses_per_line()).floor();
        let index = (pulses - line * self.scanner.pulses_per_line()).floor() as i64;
        // Modulation shifts an emission by less than a quarter of an interval.
        (index - 1..=index + 2).any(|index| {
            self.emission_at(line as u32, index)
                .is_some_and(|tick_ns| (time_ns - tick_ns as f64).abs() <= self.blind_gap_ns)
        })
    }

    /// Tick of an emission by its index in a line, ns from the start.
    ///
    /// Outside the line, ticks of the neighbouring lines, unless the laser pauses there.
    fn emission_at(&self, line: u32, index: i64) -> Option<i64> {
        let shots = i64::from(self.scanner.shots_per_line);
        if !(0..shots).contains(&index) && self.scanner.mirror == ScanMechanism::RotatingPolygon {
            return None;
        }
        let number = u64::try_from(i64::from(line) * shots + index).ok()?;
        let (line, index) = self.scanner.place(number);
        (line < self.lines).then(|| self.scanner.tick_ns(line, index))
    }

    /// Records outgoing pulse and echoes. Returns the zone of the first echoes.
    fn record(&mut self, cast: &Cast, blocks: &mut Blocks) -> i16 {
        let mut noise = SampleNoise::new(self.seed, cast);
        noise.emission(&mut self.receiver, cast.index, &cast.pulse, blocks);
        let mut first_zone = None;
        for window in &self.windows {
            let zone = zone_of(&self.scanner, cast, self.receiver.start_ns(window));
            let own = (*first_zone.get_or_insert(zone) != zone).then_some(zone);
            noise.block(&mut self.receiver, cast.index, own, window, &self.echoes, blocks);
        }
        first_zone.unwrap_or(0)
    }

    /// Adds the truth of the echoes in recorded blocks.
    fn tell(&self, cast: &Cast, zone: i16, truth: &mut Vec<TrueReturn>) {
        let first = truth.len();
        for (hit, echo) in self.hits.iter().zip(&self.echoes) {
            let Some(window) = self.windows.iter().find(|window| self.receiver.is_in(window, echo)) else {
                continue;
            };
            let zone = match self.windows.first() == Some(window) {
                true => zone,
                false => zone_of(&self.scanner, cast, self.receiver.start_ns(window)),
            };
            let in_high_power = self.receiver.is_strong(window, &self.echoes);
            truth.push(self.true_return(
                cast,
                hit,
                echo,
                RecordingConditions { zone, in_high_power, gain: self.receiver.gain() },
            ));
        }
        number(&mut truth[first..]);
    }

    /// Truth of an echo; [`number`] sets the return numbers.
    pub(super) fn true_return(
        &self,
        cast: &Cast,
        hit: &Hit,
        echo: &ReceivedEcho,
        recorded: RecordingConditions,
    ) -> TrueReturn {
        let point_m = cast.beam.at(hit.range_m);
        TrueReturn {
            shot: cast.shot.number,
            return_number: 0,
            number_of_returns: 0,
            emission_ns: cast.pulse.emission_ns,
            time_of_flight_ns: time_of_flight_ns(hit.range_m),
            range_m: hit.range_m,
            amplitude_dn: recorded.gain * echo.amplitude_dn,
            width_ratio: self.receiver.response().width_ratio(echo.width),
            point_m: match self.input.frame {
                Frame::Map => self.world.on_flat_map(point_m),
                Frame::Scanner | Frame::Body | Frame::Earth => self.world.on_earth(point_m),
            },
            zone: recorded.zone,
            in_high_power: recorded.in_high_power,
            class: hit.class,
            linear_dn: echo.linear_dn,
            gain: recorded.gain,
        }
    }

    pub(super) fn emission(&self, cast: &Cast, mta_zone: Option<i16>) -> Emission {
        let Cast { shot, beam, .. } = cast;
        let has_edges = self.scanner.mirror != ScanMechanism::Circular;
        let is_last = has_edges && cast.index + 1 == self.scanner.shots_per_line;
        let edge = if is_last { emission_flags::EDGE_OF_FLIGHT_LINE } else { 0 };
        let to_the_right = if shot.to_the_right { emission_flags::SCAN_DIRECTION_POSITIVE } else { 0 };
        let synchronised = emission_flags::SYNCHRONISED | emission_flags::SYNCHRONISED_WITHIN_LAST_SECOND;
        let (origin_m, direction) = match self.input.frame {
            Frame::Map => {
                let [x, y, z] = self.world.on_flat_map(beam.origin_m);
                ([x, y, z + self.height_error_m], self.world.turned(beam.direction))
            }
            Frame::Scanner | Frame::Body | Frame::Earth => ([0.0; 3], shot.direction_in_scanner),
        };
        Emission {
            shot: shot.number,
            gps_time_s: self.start_time_s + shot.since_start_s(),
            clock_ps: shot.clock_ps(),
            origin_m,
            direction,
            frame_scale: 1.0,
            emission_ns: 0.0,
            emission_sd_ns: f64::NAN,
            facet: shot.facet,
            flags: synchronised | to_the_right | edge,
            mta_zone,
            scan_angle_deg: shot.scan_angle_rad.to_degrees() as f32,
        }
    }
}

/// Numbers the returns of one shot.
pub(super) fn number(returns: &mut [TrueReturn]) {
    let count = returns.len() as u8;
    for (number, truth) in (1..).zip(returns) {
        (truth.return_number, truth.number_of_returns) = (number, count);
    }
}

/// Number of emissions between a shot and a time after its clock, without pauses.
fn zone_of(scanner: &Scanner, cast: &Cast, time_ns: f64) -> i16 {
    let nominal = (time_ns / (1e9 / scanner.pulse_rate_hz)) as i16;
    if scanner.modulation_ns == 0.0 {
        return nominal;
    }
    let is_out = |zone: i16| {
        let following = cast.index.saturating_add_signed(i32::from(zone));
        let (line, index) = match scanner.mirror {
            ScanMechanism::RotatingPolygon => (cast.line, following),
            _ => scanner.place(scanner.number(cast.line, 0) + u64::from(following)),
        };
        (scanner.tick_ns(line, index) - cast.shot.since_start_ns) as f64 <= time_ns
    };
    (1..=nominal + 1).rev().find(|&zone| is_out(zone)).unwrap_or(0)
}

/// Random numbers for the samples recorded with one shot.
pub(super) struct SampleNoise {
    low_power: Random,
    high_power: Random,
}

impl SampleNoise {
    pub(super) fn new(seed: u64, cast: &Cast) -> SampleNoise {
        let of = |purpose| Random::of_shot(seed, cast.line, cast.index, purpose);
        SampleNoise { low_power: of(Purpose::Noise), high_power: of(Purpose::HighPowerNoise) }
    }

    /// Records the outgoing pulse.
    pub(super) fn emission(
        &mut self,
        receiver: &mut SimulatedReceiver,
        index: u32,
        pulse: &SimulatedPulse,
        blocks: &mut Blocks,
    ) {
        let (start_ns, samples) =
            receiver.record_emission(pulse.emission_ns, pulse.energy, &mut self.low_power);
        blocks.push(index, Channel::Reference, None, start_ns, INTERVAL_NS, samples);
    }

    /// Records a window with each receiver that keeps it.
    pub(super) fn block(
        &mut self,
        receiver: &mut SimulatedReceiver,
        index: u32,
        zone: Option<i16>,
        window: &SampleWindow,
        echoes: &[ReceivedEcho],
        blocks: &mut Blocks,
    ) {
        let (start_ns, samples) = receiver.record(window, echoes, &mut self.low_power);
        blocks.push(index, Channel::LowPower, zone, start_ns, INTERVAL_NS, samples);
        blocks.set_last_gain(receiver.gain());
        if !receiver.is_strong(window, echoes) {
            return;
        }
        if let Some((start_ns, samples)) = receiver.record_high_power(window, echoes, &mut self.high_power) {
            blocks.push(index, Channel::HighPower, zone, start_ns, INTERVAL_NS, samples);
            blocks.set_last_gain(receiver.gain());
        }
    }
}

fn input(config: &Simulate) -> InputInfo {
    let background_dn = 0.5 * (config.background_dn[0] + config.background_dn[1]);
    let table =
        |receiver| AmplitudeTable::new(config.detector().table(receiver, background_dn, FULL_SCALE_DN));
    let frame = if config.has_trajectory() { Frame::Scanner } else { Frame::Map };
    InputInfo {
        full_scale_is_set: false,
        path: PathBuf::new(),
        stem: config.stem.clone(),
        format: "simulation".to_owned(),
        instrument: Some("simulated line scanner".to_owned()),
        serial: None,
        sampling_interval_ns: INTERVAL_NS,
        odd_sample_shift: config.odd_sample_shift,
        full_scale_dn: Some(FULL_SCALE_DN),
        gain_control: if config.has_gain_control() { GainControl::Recorded } else { GainControl::Off },
        group_velocity_mps: GROUP_VELOCITY_MPS,
        pulse_rate_hz: Some(config.pulse_rate_hz),
        time_scale: TimeScale::Week,
        gps_week: Some(scanner::GPS_WEEK),
        recorded: config.recorded(),
        frame,
        crs_wkt: (frame == Frame::Map).then(|| world::CRS_WKT.to_owned()),
        coordinate_grid: None,
        emission_reference: EmissionReference::OutgoingPulse,
        origin_is_sensor: true,
        first_shot: None,
        amplitude_low: table(Sensitivity::Sensitive),
        amplitude_high: config.high_power.then(|| table(Sensitivity::Coarse)).flatten(),
        range_low: None,
        range_high: None,
        ..InputInfo::default()
    }
}
