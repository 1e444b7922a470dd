//! The scan lines of a simulated flight.

use std::path::PathBuf;
use std::sync::Arc;

use super::{FULL_SCALE_DN, INTERVAL_NS, Simulate};
use crate::batch::{
    AmplitudeTable, Batch, Blocks, Channel, Emission, EmissionReference, Frame, InputInfo, TimeScale,
    emission_flags,
};
use crate::simulation::random::{Normal, Purpose, Random};
use crate::simulation::receiver::{Echo, Receiver, Window};
use crate::simulation::scanner::{self, Scanner, Shot};
use crate::simulation::scene::{Hit, Scene};
use crate::simulation::truth::TrueReturn;
use crate::simulation::{GROUP_VELOCITY_MPS, time_of_flight_ns};
use crate::stage::{Result, StageError};

/// Standard deviation of a pulse's energy, over its mean.
const ENERGY_SD: f64 = 0.01;
/// The amplitude that the instrument calls 0 dB, DN above the background.
const ZERO_DB_DN: f64 = 7.0;

/// A flight whose scan lines can be had one by one, in any order.
#[derive(Debug)]
pub(super) struct Flight {
    input: Arc<InputInfo>,
    seed: u64,
    dropout_rate: f64,
    ground_amplitude_dn: f64,
    scanner: Scanner,
    scene: Scene,
    receiver: Receiver,
    normal: Normal,
    /// Room for one shot's hits and echoes (the same ones, in the same order) and its blocks.
    hits: Vec<Hit>,
    echoes: Vec<Echo>,
    windows: Vec<Window>,
}

/// What the laser does, beyond sending a pulse at the right moment.
struct Pulse {
    /// When the pulse leaves after the tick of the sample clock, ns.
    emission_ns: f64,
    /// Its energy, over the mean.
    energy: f64,
    /// Nothing of it comes back.
    is_lost: bool,
}

impl Flight {
    pub(super) fn new(config: &Simulate) -> Result<Flight> {
        let receiver = Receiver::new(&config.receiver()).map_err(|_| {
            StageError::failed(
                "no noise has this spread and autocorrelation",
                "leave `noise_autocorrelation` out",
            )
        })?;
        Ok(Flight {
            input: Arc::new(input(config)),
            seed: config.seed,
            dropout_rate: config.dropout_rate,
            ground_amplitude_dn: config.ground_amplitude_dn,
            scanner: config.scanner(),
            scene: config.scene(),
            receiver,
            normal: Normal::default(),
            hits: Vec::new(),
            echoes: Vec::new(),
            windows: Vec::new(),
        })
    }

    /// A scan line, and the truth of the returns in it.
    pub(super) fn line(&mut self, line: u32) -> (Batch, Vec<TrueReturn>) {
        let shots = self.scanner.shots_per_line;
        let mut emissions = Vec::with_capacity(shots as usize);
        let (mut blocks, mut truth) = (Blocks::default(), Vec::new());
        for index in 0..shots {
            let shot = self.scanner.shot(line, index);
            let pulse = self.pulse(line, index);
            self.receive(&shot, &pulse);
            let zone = self.record(line, index, &pulse, &mut blocks);
            self.tell(&shot, &pulse, &mut truth);
            emissions.push(emission(&shot, zone, index + 1 == shots));
        }
        (Batch::of_shots(Arc::clone(&self.input), line, emissions, blocks), truth)
    }

    fn pulse(&self, line: u32, index: u32) -> Pulse {
        let mut random = Random::of_shot(self.seed, line, index, Purpose::Laser);
        Pulse {
            emission_ns: INTERVAL_NS * random.uniform(),
            is_lost: random.uniform() < self.dropout_rate,
            energy: 1.0 + ENERGY_SD * self.normal.draw(&mut random),
        }
    }

    /// The echoes of a pulse.
    fn receive(&mut self, shot: &Shot, pulse: &Pulse) {
        self.hits.clear();
        if !pulse.is_lost {
            self.scene.hits(shot.origin_m, shot.direction, &mut self.hits);
        }
        let response = self.receiver.response();
        self.echoes.clear();
        self.echoes.extend(self.hits.iter().map(|hit| {
            let width = response.width(time_of_flight_ns(hit.spread_m));
            let energy_dn = self.ground_amplitude_dn * pulse.energy * hit.energy;
            Echo {
                time_ns: pulse.emission_ns + time_of_flight_ns(hit.range_m),
                amplitude_dn: energy_dn * response.peak(width),
                width,
            }
        }));
        self.receiver.windows(&self.echoes, &mut self.windows);
    }

    /// Records outgoing pulse and echoes, and says in which zone the first echoes arrive.
    fn record(&mut self, line: u32, index: u32, pulse: &Pulse, blocks: &mut Blocks) -> i16 {
        let mut random = Random::of_shot(self.seed, line, index, Purpose::Noise);
        let (start_ns, samples) = self.receiver.record_emission(pulse.emission_ns, pulse.energy, &mut random);
        blocks.push(index, Channel::Reference, None, start_ns, INTERVAL_NS, samples);
        let period_ns = 1e9 / self.scanner.pulse_rate_hz;
        let mut first_zone = None;
        for window in &self.windows {
            let (start_ns, samples) = self.receiver.record(window, &self.echoes, &mut random);
            let zone = (start_ns / period_ns) as i16;
            let own = (*first_zone.get_or_insert(zone) != zone).then_some(zone);
            blocks.push(index, Channel::LowPower, own, start_ns, INTERVAL_NS, samples);
        }
        first_zone.unwrap_or(0)
    }

    /// The truth of the echoes that stand in a recorded block.
    fn tell(&self, shot: &Shot, pulse: &Pulse, truth: &mut Vec<TrueReturn>) {
        let first = truth.len();
        for (hit, echo) in self.hits.iter().zip(&self.echoes) {
            if !self.windows.iter().any(|window| self.receiver.is_in(window, echo)) {
                continue;
            }
            truth.push(TrueReturn {
                shot: shot.number,
                return_number: (truth.len() - first + 1) as u8,
                number_of_returns: 0,
                emission_ns: pulse.emission_ns,
                time_of_flight_ns: time_of_flight_ns(hit.range_m),
                range_m: hit.range_m,
                amplitude_dn: echo.amplitude_dn,
                width_ratio: self.receiver.response().width_ratio(echo.width),
                point_m: core::array::from_fn(|axis| {
                    shot.origin_m[axis] + hit.range_m * shot.direction[axis]
                }),
            });
        }
        let number = (truth.len() - first) as u8;
        truth[first..].iter_mut().for_each(|truth| truth.number_of_returns = number);
    }
}

fn emission(shot: &Shot, zone: i16, is_last: bool) -> Emission {
    let edge = if is_last { emission_flags::EDGE_OF_FLIGHT_LINE } else { 0 };
    let synchronised = emission_flags::SYNCHRONISED | emission_flags::SYNCHRONISED_WITHIN_LAST_SECOND;
    Emission {
        shot: shot.number,
        gps_time_s: shot.gps_time_s,
        clock_ps: shot.clock_ps,
        origin_m: shot.origin_m,
        direction: shot.direction,
        frame_scale: 1.0,
        emission_ns: 0.0,
        emission_sd_ns: f64::NAN,
        facet: shot.facet,
        flags: synchronised | emission_flags::SCAN_DIRECTION_POSITIVE | edge,
        mta_zone: Some(zone),
        scan_angle_deg: shot.scan_angle_rad.to_degrees() as f32,
    }
}

fn input(config: &Simulate) -> InputInfo {
    InputInfo {
        path: PathBuf::new(),
        stem: config.stem.clone(),
        format: "simulation".to_owned(),
        instrument: Some("simulated line scanner".to_owned()),
        serial: None,
        sampling_interval_ns: INTERVAL_NS,
        odd_sample_shift: 0.0,
        full_scale_dn: Some(FULL_SCALE_DN),
        group_velocity_mps: GROUP_VELOCITY_MPS,
        pulse_rate_hz: Some(config.pulse_rate_hz),
        time_scale: TimeScale::Week,
        gps_week: Some(scanner::GPS_WEEK),
        recorded: Some(scanner::RECORDED),
        frame: Frame::Map,
        crs_wkt: Some(scanner::CRS_WKT.to_owned()),
        coordinate_grid: None,
        emission_reference: EmissionReference::OutgoingPulse,
        amplitude_low: amplitude_table(config.background_dn),
        amplitude_high: None,
        range_low: None,
        range_high: None,
    }
}

/// The table of a linear receiver: decibels above the amplitude that counts as 0 dB, by background + amplitude.
fn amplitude_table(background_dn: [f64; 2]) -> Option<AmplitudeTable> {
    let background_dn = 0.5 * (background_dn[0] + background_dn[1]);
    let lowest = background_dn as u16 + 1;
    AmplitudeTable::new((lowest..=FULL_SCALE_DN).map(|dn| {
        let dn = f64::from(dn);
        (dn, 10.0 * libm::log10((dn - background_dn) / ZERO_DB_DN))
    }))
}
