//! Lines as recorded: blocks are stored with the last shot emitted before their reception.

use std::ops::Range;

use super::INTERVAL_NS;
use super::flight::{Cast, RecordingConditions, SampleNoise, SimulatedFlight, number, strongest};
use wavex_line::scan_line::{Blocks, Emission};
use wavex_simulation::receiver::{ReceivedEcho, SampleWindow};
use wavex_simulation::scene::Hit;
use wavex_simulation::truth::TrueReturn;

/// Time before the first echo of a line from which echoes affect block starts, ns.
///
/// Longer chains of echoes without a gap do not occur.
const CHAIN_NS: f64 = 4000.0;
/// Time before and after an echo's peak within which it contributes to samples, ns.
const RISE_NS: f64 = 60.0;
const DECAY_NS: f64 = 1000.0;

/// Echoes received during a line and around it, in order of time.
struct EchoStream {
    /// Running number of the first shot in `casts`.
    first: u64,
    casts: Vec<Cast>,
    /// Time origin of the stream, ns from the start of the flight.
    base_ns: i64,
    echoes: Vec<ReceivedEcho>,
    /// Hit of each echo and the index of its shot in `casts`.
    origins: Vec<(Hit, usize)>,
    windows: Vec<SampleWindow>,
    /// Highest echo of each shot in `casts`, DN.
    strongest: Vec<Option<f64>>,
}

impl SimulatedFlight {
    /// Generates a line with the blocks received during it.
    ///
    /// The truth contains the returns of its own shots.
    pub(super) fn recorded_line(
        &mut self,
        line: u32,
        blocks: &mut Blocks,
        truth: &mut Vec<TrueReturn>,
    ) -> Vec<Emission> {
        let stream = self.stream(line);
        let first = (self.scanner.number(line, 0) - stream.first) as usize;
        let own = first..first + self.scanner.shots_per_line as usize;
        let received = stream.received(&self.receiver);
        let mut next = received.partition_point(|&place| place < own.start);
        let mut near = Vec::new();
        for (place, cast) in stream.casts.iter().enumerate().take(own.end).skip(own.start) {
            let mut recorder = SampleNoise::new(self.seed, cast);
            let gain = self.gain(cast, stream.before(place));
            self.receiver.set_gain(gain);
            recorder.emission(&mut self.receiver, cast.index, &cast.pulse, blocks);
            while received.get(next) == Some(&place) {
                let ahead_ns = cast.shot.since_start_ns - stream.base_ns;
                let window = stream.windows[next].by_clock_ahead((ahead_ns as f64 / INTERVAL_NS) as i64);
                stream.near(&stream.windows[next], ahead_ns, &mut near);
                recorder.block(&mut self.receiver, cast.index, None, &window, &near, blocks);
                next += 1;
            }
        }
        if self.tells_truth {
            self.tell_stream(&stream, &received, own.clone(), truth);
        }
        stream.casts[own].iter().map(|cast| self.emission(cast, None)).collect()
    }

    /// Collects the echoes that affect a line's blocks or the returns of its shots.
    fn stream(&mut self, line: u32) -> EchoStream {
        let shots = self.scanner.shots_per_line;
        let tick_ns = |number: u64| {
            let (line, index) = self.scanner.place(number);
            self.scanner.tick_ns(line, index)
        };
        let base_ns = self.scanner.tick_ns(line, 0);
        let reach_ns = (self.longest_ns + CHAIN_NS) as i64;
        let (mut first, mut end) = (self.scanner.number(line, 0), self.scanner.number(line, shots));
        while first > 0 && tick_ns(first - 1) >= base_ns - reach_ns {
            first -= 1;
        }
        let (all, last_ns) = (self.scanner.number(self.lines, 0), self.scanner.tick_ns(line, shots - 1));
        while end < all && tick_ns(end) <= last_ns + reach_ns {
            end += 1;
        }
        let mut stream = EchoStream {
            first,
            casts: Vec::with_capacity((end - first) as usize),
            base_ns,
            echoes: Vec::new(),
            origins: Vec::new(),
            windows: Vec::new(),
            strongest: Vec::new(),
        };
        let mut arrived: Vec<(ReceivedEcho, Hit, usize)> = Vec::new();
        for number in first..end {
            let (line, index) = self.scanner.place(number);
            let cast = self.cast(line, index);
            self.receive(&cast);
            let after_base_ns = (cast.shot.since_start_ns - base_ns) as f64;
            let place = stream.casts.len();
            arrived.extend(self.echoes.iter().zip(&self.hits).map(|(echo, hit)| {
                (ReceivedEcho { time_ns: echo.time_ns + after_base_ns, ..*echo }, *hit, place)
            }));
            stream.strongest.push(strongest(&self.echoes));
            stream.casts.push(cast);
        }
        arrived.sort_by(|a, b| a.0.time_ns.total_cmp(&b.0.time_ns));
        stream.echoes.extend(arrived.iter().map(|(echo, ..)| *echo));
        stream.origins.extend(arrived.iter().map(|&(_, hit, place)| (hit, place)));
        self.receiver.windows(&stream.echoes, &mut stream.windows);
        stream
    }

    /// Adds the truth of the returns of some shots, wherever they were recorded.
    fn tell_stream(
        &self,
        stream: &EchoStream,
        received: &[usize],
        own: Range<usize>,
        truth: &mut Vec<TrueReturn>,
    ) {
        let first = truth.len();
        let mut near = Vec::new();
        for (echo, (hit, place)) in stream.echoes.iter().zip(&stream.origins) {
            let after =
                stream.windows.partition_point(|window| self.receiver.start_ns(window) <= echo.time_ns);
            let window = after.checked_sub(1).and_then(|at| Some((at, stream.windows.get(at)?)));
            let Some((at, window)) = window.filter(|(_, window)| self.receiver.is_in(window, echo)) else {
                continue;
            };
            if own.contains(place) {
                stream.near(window, 0, &mut near);
                let in_high_power = self.receiver.is_strong(window, &near);
                let zone = (received[at] - place) as i16;
                let gain = self.gain(&stream.casts[received[at]], stream.before(received[at]));
                let recorded = RecordingConditions { zone, in_high_power, gain };
                truth.push(self.true_return(&stream.casts[*place], hit, echo, recorded));
            }
        }
        let own_truth = &mut truth[first..];
        own_truth.sort_by_key(|truth| truth.shot);
        own_truth.chunk_by_mut(|a, b| a.shot == b.shot).for_each(number);
    }
}

impl EchoStream {
    /// Index in `casts` of the shot with which each window is stored.
    ///
    /// The last shot emitted before the window begins.
    fn received(&self, receiver: &wavex_simulation::receiver::SimulatedReceiver) -> Vec<usize> {
        let began = |window: &SampleWindow| {
            let start_ns = receiver.start_ns(window);
            let out = |cast: &Cast| (cast.shot.since_start_ns - self.base_ns) as f64 <= start_ns;
            self.casts.partition_point(out).saturating_sub(1)
        };
        self.windows.iter().map(began).collect()
    }

    /// Highest echo of the previous shot of the same line, DN.
    fn before(&self, place: usize) -> Option<f64> {
        let is_first = self.casts.get(place).is_none_or(|cast| cast.index == 0);
        if is_first { None } else { self.strongest.get(place.checked_sub(1)?).copied().flatten() }
    }

    /// Echoes that contribute to a window, with times from a clock `ahead_ns` later.
    fn near(&self, window: &SampleWindow, ahead_ns: i64, near: &mut Vec<ReceivedEcho>) {
        let [from_ns, to_ns] = window.limits_ns(INTERVAL_NS);
        let first = self.echoes.partition_point(|echo| echo.time_ns < from_ns - DECAY_NS);
        let arrived = self.echoes[first..].iter().take_while(|echo| echo.time_ns < to_ns + RISE_NS);
        near.clear();
        near.extend(arrived.map(|echo| ReceivedEcho { time_ns: echo.time_ns - ahead_ns as f64, ..*echo }));
    }
}
