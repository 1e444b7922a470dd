//! Pending scan lines; a line is emitted once no later block can belong to it.

use std::collections::VecDeque;

use super::echoes::{Destination, EchoPeak, Group, Received};
use super::geometry::BeamGeometry;
use super::summary::MtaCounts;
use super::{ResolveMta, failed};
use wavex_formats::terrain::Terrain;
use wavex_line::georef::Geometry as Placed;
use wavex_line::scan_line::{
    Block, Blocks, Channel, Content, EmissionReference, OnlineReturn, ScanLine, Ticket,
};
use wavex_line::stage::{Output, Reason, Result};
use wavex_returns::mta::{
    self, Assigned, BAND_LINES, BYTES_PER_ECHO, BYTES_PER_SHOT, LOOK_AHEAD_BYTES, Resolved, Resolver,
    Settings,
};

/// Upper bound of the kernel's cell memory per shot of the pending lines, bytes (docs/explanation/mta.md,
/// Memory and order).
const CELL_BYTES_PER_SHOT: usize = 48;
/// Nominal size in the kernel's window of a shot, and of a block or online return, bytes.
const WINDOW_BYTES_PER_SHOT: usize = 256;
const WINDOW_BYTES_PER_BLOCK: usize = 240;

/// Lines whose zones are being resolved.
pub(super) struct ZoneWindow {
    resolver: Resolver,
    settings: Settings,
    geometry: BeamGeometry,
    /// The first lines, until it is known whether the scanner is circular.
    first_lines: Vec<ScanLine>,
    held: VecDeque<HeldLine>,
    /// Number of the first line in `held`, in the resolver's count.
    first: u64,
    /// Lines below this number are complete.
    settled: u64,
    pub(super) held_bytes: usize,
    /// Delay of the last outgoing pulse relative to its shot's clock, ps.
    outgoing_ps: i64,
    /// Number of lines added, and their nominal size in the kernel's window, bytes.
    pushed: usize,
    pushed_bytes: usize,
    /// Memory of the terrain model, bytes.
    terrain_bytes: usize,
    /// Budget share of the terrain model; released with the strip.
    _terrain_ticket: Option<Ticket>,
    tally: MtaCounts,
}

/// A pending line.
struct HeldLine {
    scan_line: ScanLine,
    received: Received,
    /// Index in the line of each shot known to the resolver.
    known: Vec<u32>,
    /// Group of each echo known to the resolver.
    group_of_echo: Vec<u32>,
    /// Blocks, of this line and of later ones, caused by this line's shots.
    incoming: Vec<Relocation>,
    online: Vec<OnlineReturn>,
    bytes: usize,
}

/// A block on its way to the shot that caused it.
struct Relocation {
    /// Index of that shot in its line.
    to: u32,
    /// Time relative to the clock of that shot, ns.
    start_ns: f64,
    /// Line and index of the block that holds the samples.
    line: u64,
    block: u32,
    zone: Option<i16>,
    is_uncertain: bool,
}

/// Assignment of a group to a shot.
#[derive(Clone, Copy)]
struct Assignment {
    line: u64,
    emission: u32,
    zone: i16,
    /// From the causing shot's clock to the record's clock, ns.
    later_ns: f64,
    is_uncertain: bool,
}

impl ZoneWindow {
    /// Starts with the first line of a recording.
    pub fn new(
        config: &ResolveMta,
        first: &ScanLine,
        terrain: Option<&Terrain>,
        placed: &Placed,
        out: &mut Output,
    ) -> Result<ZoneWindow> {
        let settings = config.settings(first.input.group_velocity_mps);
        let resolver = Resolver::new(&settings).map_err(|error| failed(&error))?;
        let geometry = BeamGeometry::of(first, config.range_m, terrain, placed)?;
        let mut terrain_bytes = 0;
        if let Some(terrain) = terrain {
            terrain_elsewhere(terrain, first, out);
            terrain_bytes = terrain.bytes();
        }
        Ok(ZoneWindow {
            resolver,
            settings,
            geometry,
            first_lines: Vec::new(),
            held: VecDeque::new(),
            first: 0,
            settled: 0,
            held_bytes: 0,
            outgoing_ps: 0,
            pushed: 0,
            pushed_bytes: 0,
            terrain_bytes,
            _terrain_ticket: first.ticket.as_ref().map(|ticket| ticket.beside(terrain_bytes)),
            tally: MtaCounts::new(settings.blind_gap_ns),
        })
    }

    /// Adds the next line and emits complete ones.
    pub fn push(&mut self, scan_line: ScanLine, terrain: Option<&Terrain>, out: &mut Output) -> Result<()> {
        let is_known = self.geometry.follow(&scan_line.emissions);
        self.first_lines.push(scan_line);
        let bytes: usize = self.first_lines.iter().map(ScanLine::bytes).sum();
        match is_known || bytes > out.may_hold_bytes() / 2 {
            true => self.take_first_lines(terrain, out),
            false => Ok(()),
        }
    }

    fn take_first_lines(&mut self, terrain: Option<&Terrain>, out: &mut Output) -> Result<()> {
        let is_cyclic = self.geometry.is_circular();
        if is_cyclic != self.settings.is_cyclic {
            self.settings.is_cyclic = is_cyclic;
            self.resolver = Resolver::new(&self.settings).map_err(|error| failed(&error))?;
        }
        std::mem::take(&mut self.first_lines).into_iter().try_for_each(|line| self.take(line, terrain, out))
    }

    fn take(&mut self, scan_line: ScanLine, terrain: Option<&Terrain>, out: &mut Output) -> Result<()> {
        self.geometry.learn(&scan_line.emissions);
        let empty = Blocks::default();
        let received = Received::of(&scan_line.emissions, scan_line.blocks().unwrap_or(&empty));
        let mut held = HeldLine {
            scan_line,
            received,
            known: Vec::new(),
            group_of_echo: Vec::new(),
            incoming: Vec::new(),
            online: Vec::new(),
            bytes: 0,
        };
        let line = held.for_kernel(&self.geometry, terrain, &mut self.outgoing_ps);
        self.pushed_bytes += line.bytes;
        self.pushed += 1;
        if held.known.len() < held.scan_line.emissions.len() {
            out.cx
                .warn("shots with duplicate timestamps are indistinguishable; their echoes go to the first");
        }
        held.count();
        self.held_bytes += held.bytes;
        self.held.push_back(held);
        self.resolver.push(&line).map_err(|error| failed(&error))?;
        self.settle(out)?;
        out.foresee(self.foreseen_bytes());
        Ok(())
    }

    /// Resolves and emits the remaining lines.
    pub fn finish(mut self, terrain: Option<&Terrain>, out: &mut Output) -> Result<()> {
        self.take_first_lines(terrain, out)?;
        self.resolver.finish().map_err(|error| failed(&error))?;
        self.settle(out)?;
        self.settled = u64::MAX;
        self.give_on(out)?;
        self.tally.tell(&self.resolver, out.cx);
        Ok(())
    }

    /// Assigns the blocks of all resolved lines to their shots.
    fn settle(&mut self, out: &mut Output) -> Result<()> {
        while let Some(resolved) = self.resolver.pop() {
            self.assign(&resolved, out);
            self.settled = self.settled.max(resolved.settled_lines);
        }
        self.give_on(out)
    }

    fn give_on(&mut self, out: &mut Output) -> Result<()> {
        while self.first < self.settled && !self.held.is_empty() {
            let blocks = self.regrouped();
            let Some(held) = self.held.pop_front() else { break };
            self.held_bytes -= held.bytes;
            self.first += 1;
            let mut scan_line = held.scan_line;
            scan_line.stats.nw = blocks.waveforms() as u64;
            scan_line.content = Content::Shots(blocks);
            out.emit(scan_line)?;
        }
        Ok(())
    }

    /// The blocks of the first line's shots, sorted by shot and time; sets the zones of the shots.
    fn regrouped(&mut self) -> Blocks {
        let Some(line) = self.held.front_mut() else { return Blocks::default() };
        let mut incoming = std::mem::take(&mut line.incoming);
        let mut online = std::mem::take(&mut line.online);
        incoming.sort_by(|a, b| a.to.cmp(&b.to).then(a.start_ns.total_cmp(&b.start_ns)));
        online.sort_by(|a, b| a.emission.cmp(&b.emission).then(a.time_ns.total_cmp(&b.time_ns)));
        let mut first_zones = vec![None; line.scan_line.emissions.len()];
        for moved in &incoming {
            if let Some(first) = first_zones.get_mut(moved.to as usize) {
                *first = first.or(moved.zone);
            }
        }
        for (emission, first) in line.scan_line.emissions.iter_mut().zip(first_zones) {
            // A shot without echoes has no zone; 0 marks it as resolved.
            emission.mta_zone = emission.mta_zone.or(first).or(Some(0));
        }
        let mut blocks = Blocks::default();
        let emissions = &self.held[0].scan_line.emissions;
        for moved in &incoming {
            let source =
                self.held.get((moved.line - self.first) as usize).and_then(|held| held.scan_line.blocks());
            let found = source.and_then(|source| Some((source, source.get(moved.block as usize)?)));
            let Some((source, block)) = found else { continue };
            let of_shot = emissions.get(moved.to as usize).and_then(|emission| emission.mta_zone);
            let zone = moved.zone.filter(|_| moved.zone != of_shot);
            let samples = source.samples(block);
            blocks.push(moved.to, block.channel, zone, moved.start_ns, block.interval_ns, samples);
            blocks.set_last_gain(block.gain);
            if moved.is_uncertain {
                blocks.doubt_last_zone();
            }
        }
        blocks.online = online;
        blocks
    }

    /// Sends the blocks of a resolved line to the lines that caused them.
    fn assign(&mut self, resolved: &Resolved, out: &mut Output) {
        let Some(at) = resolved.line.checked_sub(self.first).map(|at| at as usize) else { return };
        let Some(line) = self.held.get(at) else { return };
        let mut verdicts: Vec<Option<Assignment>> = vec![None; line.received.groups.len()];
        let mut from = 0;
        let of_group = |a: &u32, b: &u32| a == b;
        for run in line.group_of_echo.chunk_by(of_group) {
            let echoes = &resolved.echoes[from..(from + run.len()).min(resolved.echoes.len())];
            from += run.len();
            let Some(&group) = run.first() else { continue };
            let Some(of_group) = line.received.groups.get(group as usize) else { continue };
            let verdict = self.verdict(line, of_group, echoes);
            if let Some((verdict, margin_nats)) = verdict {
                self.tally.add(verdict.zone, margin_nats, verdict.is_uncertain, out.cx);
                verdicts[group as usize] = Some(verdict);
            }
        }
        let (moves, online) = line.moves(resolved.line, &verdicts, out);
        for (to, moved) in moves {
            self.held[(to - self.first) as usize].incoming.push(moved);
        }
        for (to, returned) in online {
            self.held[(to - self.first) as usize].online.push(returned);
        }
    }

    /// The cause with the largest total echo height in a group, and its margin.
    fn verdict(&self, line: &HeldLine, group: &Group, echoes: &[Assigned]) -> Option<(Assignment, f32)> {
        let peaks = line.received.echoes.get(group.echoes.start as usize..group.echoes.end as usize)?;
        let votes = || echoes.iter().zip(peaks).filter(|(echo, _)| echo.cause.is_some());
        let mut best: Option<(f64, &Assigned)> = None;
        for (echo, _) in votes() {
            let of_cause = votes().filter(|(other, _)| other.cause == echo.cause);
            let weight: f64 = of_cause.map(|(_, peak)| peak.height_dn.max(1.0)).sum();
            // Of equal weights the first wins; it belongs to the highest pulse.
            if best.is_none_or(|(most, _)| weight > most) {
                best = Some((weight, echo));
            }
        }
        let (_, best) = best?;
        let cause = best.cause?;
        let cause_line = self.held.get(cause.line.checked_sub(self.first)? as usize)?;
        let emission = *cause_line.known.get(cause.emission as usize)?;
        let causing = cause_line.scan_line.emissions.get(emission as usize)?;
        let record = line.scan_line.emissions.get(group.record as usize)?;
        let zone = line.received_with(group).saturating_sub(causing.shot).min(i16::MAX as u64) as i16;
        let is_split = votes().any(|(echo, _)| echo.cause != best.cause);
        let verdict = Assignment {
            line: cause.line,
            emission,
            zone,
            later_ns: record.clock_ps.saturating_sub(causing.clock_ps) as f64 / 1000.0,
            is_uncertain: best.uncertain || is_split,
        };
        Some((verdict, best.margin_nats))
    }

    /// Upper bound of the memory that this stage will hold, bytes.
    fn foreseen_bytes(&self) -> usize {
        let lines_by_bytes =
            (LOOK_AHEAD_BYTES / (self.pushed_bytes / self.pushed).max(1)).saturating_add(BAND_LINES);
        let ahead = self.resolver.look_ahead_lines().min(lines_by_bytes.max(2 * BAND_LINES));
        self.held_bytes / self.held.len().max(1) * (ahead + 1) + self.terrain_bytes
    }
}

impl HeldLine {
    /// Converts the line for the kernel, with ascending emission times as clocks.
    ///
    /// `outgoing_ps` is the delay of the last outgoing pulse relative to its clock.
    fn for_kernel(
        &mut self,
        geometry: &BeamGeometry,
        terrain: Option<&Terrain>,
        outgoing_ps: &mut i64,
    ) -> mta::Line {
        let mut line = mta::Line { bytes: self.window_bytes(), ..mta::Line::default() };
        let has_outgoing = self.scan_line.input.emission_reference == EmissionReference::OutgoingPulse;
        // For each shot, its index among those known to the kernel.
        let mut places = Vec::with_capacity(self.scan_line.emissions.len());
        for ((index, emission), outgoing_ns) in
            (0u32..).zip(&self.scan_line.emissions).zip(&self.received.outgoing_ns)
        {
            // A pulse leaves at its recorded peak, not at its time stamp. If a peak is unusable,
            // the last delay is used.
            if has_outgoing && outgoing_ns.is_finite() {
                *outgoing_ps = (outgoing_ns * 1000.0).round() as i64;
            }
            let left_ps = emission.clock_ps.saturating_add(*outgoing_ps);
            let last = line.emissions.last().map(|last: &mta::Emission| last.clock_ps);
            if last.is_none_or(|last| last < left_ps) {
                line.emissions
                    .push(mta::Emission { clock_ps: left_ps, ..geometry.emission(emission, terrain) });
                self.known.push(index);
            }
            places.push(line.emissions.len() as u32 - 1);
        }
        for (number, group) in (0u32..).zip(&self.received.groups) {
            let record = self.scan_line.emissions.get(group.record as usize);
            let (Some(&place), Some(record)) = (places.get(group.record as usize), record) else { continue };
            let left = line.emissions.get(place as usize);
            let after_ns =
                left.map_or(0.0, |left| left.clock_ps.saturating_sub(record.clock_ps) as f64 / 1000.0);
            for peak in &self.received.echoes[group.echoes.start as usize..group.echoes.end as usize] {
                line.echoes.push(mta::Echo { emission: place, time_ns: peak.time_ns - after_ns });
                self.group_of_echo.push(number);
            }
        }
        line
    }

    /// Nominal size of the line in the kernel's window, bytes; depends on the data only, not on the
    /// reader.
    fn window_bytes(&self) -> usize {
        let blocks = self.scan_line.blocks();
        let samples: usize = blocks.map_or(0, |blocks| blocks.iter().map(Block::len).sum());
        self.scan_line.emissions.len() * WINDOW_BYTES_PER_SHOT
            + blocks.map_or(0, |blocks| blocks.len() + blocks.online.len()) * WINDOW_BYTES_PER_BLOCK
            + samples * size_of::<u16>()
    }

    /// Charges the memory of the pending line to the budget.
    fn count(&mut self) {
        let shots = self.scan_line.emissions.len();
        let received = &self.received;
        self.bytes = self.scan_line.bytes()
            + shots * (BYTES_PER_SHOT + CELL_BYTES_PER_SHOT + size_of::<u32>() + size_of::<f64>())
            + received.echoes.len() * (BYTES_PER_ECHO + size_of::<EchoPeak>() + size_of::<u32>())
            + received.groups.len() * (size_of::<Group>() + size_of::<Option<Assignment>>())
            + received.blocks.len() * (size_of::<Destination>() + 2 * size_of::<Relocation>())
            + received.online.len() * (size_of::<Destination>() + 2 * size_of::<OnlineReturn>());
        if let Some(ticket) = &mut self.scan_line.ticket {
            ticket.resize(self.bytes);
        }
    }

    /// Number of the last shot fired before a group begins.
    fn received_with(&self, group: &Group) -> u64 {
        let emissions = &self.scan_line.emissions;
        let mut at = group.record as usize;
        let clock_ps = emissions.get(at).map_or(0, |record| record.clock_ps);
        let is_out = |next: usize| {
            let next = emissions.get(next);
            next.is_some_and(|next| next.clock_ps.saturating_sub(clock_ps) as f64 <= group.from_ns * 1000.0)
        };
        while is_out(at + 1) {
            at += 1;
        }
        emissions.get(at).map_or(0, |emission| emission.shot)
    }

    /// Destinations of blocks and online returns; those without a cause are rejected.
    #[expect(clippy::type_complexity, reason = "two lists of what goes to which line")]
    fn moves(
        &self,
        number: u64,
        verdicts: &[Option<Assignment>],
        out: &mut Output,
    ) -> (Vec<(u64, Relocation)>, Vec<(u64, OnlineReturn)>) {
        let Some(blocks) = self.scan_line.blocks() else { return (Vec::new(), Vec::new()) };
        let verdict = |place: Destination| match place {
            Destination::Group(group) => verdicts.get(group as usize).copied().flatten(),
            _ => None,
        };
        let mut moves = Vec::with_capacity(blocks.len());
        for ((index, block), &place) in (0u32..).zip(blocks.iter()).zip(&self.received.blocks) {
            let mut moved = Relocation {
                to: block.emission,
                start_ns: block.start_ns,
                line: number,
                block: index,
                zone: None,
                is_uncertain: block.is_zone_uncertain,
            };
            let line = match (place, verdict(place)) {
                (Destination::Group(_), Some(verdict)) => {
                    moved.to = verdict.emission;
                    moved.start_ns += verdict.later_ns;
                    (moved.zone, moved.is_uncertain) = (Some(verdict.zone), verdict.is_uncertain);
                    verdict.line
                }
                (Destination::Stays, _) => {
                    let Some(emission) = self.scan_line.emissions.get(block.emission as usize) else {
                        out.cx.reject(Reason::BlockWithoutShot, 1);
                        continue;
                    };
                    if block.channel != Channel::Reference {
                        moved.zone = block.zone.or(emission.mta_zone);
                    }
                    number
                }
                (Destination::Nowhere, _) => {
                    out.cx.reject(Reason::BlockFarFromShot, 1);
                    continue;
                }
                (Destination::Group(_), None) => {
                    out.cx.reject(Reason::NoEmission, 1);
                    continue;
                }
            };
            moves.push((line, moved));
        }
        (moves, self.online_moves(number, verdict, out))
    }

    fn online_moves(
        &self,
        number: u64,
        verdict: impl Fn(Destination) -> Option<Assignment>,
        out: &mut Output,
    ) -> Vec<(u64, OnlineReturn)> {
        let online = self.scan_line.blocks().map_or(&[][..], |blocks| &blocks.online);
        let mut moves = Vec::with_capacity(online.len());
        for (&returned, &place) in online.iter().zip(&self.received.online) {
            match (place, verdict(place)) {
                (Destination::Stays, _) => moves.push((number, returned)),
                (_, Some(Assignment { line, emission, later_ns, .. })) => {
                    let time_ns = returned.time_ns + later_ns;
                    moves.push((line, OnlineReturn { emission, time_ns, ..returned }));
                }
                _ => out.cx.warn("online returns without an assigned shot are skipped"),
            }
        }
        moves
    }
}

/// Notes if the terrain model and the recording name different CRSs.
fn terrain_elsewhere(terrain: &Terrain, first: &ScanLine, out: &mut Output) {
    let name = |wkt: &str| wkt.split('"').nth(1).map(str::to_owned);
    let of_terrain = terrain.epsg().and_then(wavex_geodesy::crs::wkt_of_epsg).and_then(|wkt| name(&wkt));
    let of_recording = first.input.crs_wkt.as_deref().and_then(name);
    if let (Some(terrain), Some(recording)) = (of_terrain, of_recording)
        && terrain != recording
    {
        out.cx.warn(format!(
            "the terrain model is in {terrain} but the recording is in {recording}: coordinates are used without conversion"
        ));
    }
}
