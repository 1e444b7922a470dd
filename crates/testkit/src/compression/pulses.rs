//! Compressed pulses of a `.plz` file.

use std::collections::BTreeMap;

use laz::compressors::IntegerCompressor;
use laz::models::{ArithmeticModel, ArithmeticModelBuilder};

use super::{Encoder, finished, integers};

/// Size of a pulse record without source ID and extra bytes.
const PULSE: usize = 48;

/// Everything after the records of the pulse file: the offset of the chunk table, which is at byte `at`, the
/// chunks, and their table.
///
/// Records are pulses of 48 bytes, a source ID of `source_id_bytes` (0, 2 or 4), and extra bytes. With
/// `varying` the table has the number of pulses of each chunk.
pub fn chunks(
    at: usize,
    records: &[Vec<u8>],
    chunk: usize,
    source_id_bytes: usize,
    varying: bool,
) -> Vec<u8> {
    let chunks: Vec<Vec<u8>> = records.chunks(chunk).map(|records| one(records, source_id_bytes)).collect();
    let table_at = at + 8 + chunks.iter().map(Vec::len).sum::<usize>();
    let mut bytes = (table_at as i64).to_le_bytes().to_vec();
    bytes.extend(chunks.concat());
    bytes.extend(0u32.to_le_bytes());
    bytes.extend((chunks.len() as u32).to_le_bytes());
    if chunks.is_empty() {
        return bytes;
    }
    let (mut encoder, mut numbers) = (Encoder::new(Vec::new()), integers(32, 2));
    let (mut last_pulses, mut last_bytes) = (0, 0);
    for (bytes, records) in chunks.iter().zip(records.chunks(chunk)) {
        if varying {
            numbers.compress(&mut encoder, last_pulses, records.len() as i32, 0).unwrap();
            last_pulses = records.len() as i32;
        }
        numbers.compress(&mut encoder, last_bytes, bytes.len() as i32, 1).unwrap();
        last_bytes = bytes.len() as i32;
    }
    bytes.extend(finished(encoder));
    bytes
}

/// A chunk of at least one record.
fn one(records: &[Vec<u8>], source_id_bytes: usize) -> Vec<u8> {
    let mut encoder = Encoder::new(Vec::new());
    let mut pulses = Pulses::new();
    let mut source_ids = SourceIds::new(&records[0], source_id_bytes);
    let mut extra: Vec<ArithmeticModel> =
        records[0][PULSE + source_id_bytes..].iter().map(|_| symbols(256)).collect();
    for pair in records.windows(2) {
        pulses.add(&mut encoder, &Fields::of(&pair[0]), &Fields::of(&pair[1]));
        if source_id_bytes > 0 {
            source_ids.add(&mut encoder, &pair[1]);
        }
        for (i, model) in extra.iter_mut().enumerate() {
            let byte = |record: &[u8]| record[PULSE + source_id_bytes + i];
            let difference = byte(&pair[1]).wrapping_sub(byte(&pair[0]));
            encoder.encode_symbol(model, difference.into()).unwrap();
        }
    }
    [records[0].clone(), finished(encoder)].concat()
}

fn symbols(symbols: u32) -> ArithmeticModel {
    ArithmeticModelBuilder::new(symbols).build()
}

/// Fields of a pulse record.
struct Fields {
    time: i64,
    offset: i64,
    anchor: [i32; 3],
    target: [i32; 3],
    first: u16,
    last: u16,
    descriptor: u8,
    flags: u8,
    intensity: u8,
    class: u8,
}

impl Fields {
    fn of(record: &[u8]) -> Fields {
        let i64_at = |at: usize| i64::from_le_bytes(record[at..at + 8].try_into().unwrap());
        let i32_at = |at: usize| i32::from_le_bytes(record[at..at + 4].try_into().unwrap());
        let u16_at = |at: usize| u16::from_le_bytes([record[at], record[at + 1]]);
        Fields {
            time: i64_at(0),
            offset: i64_at(8),
            anchor: [16, 20, 24].map(i32_at),
            target: [28, 32, 36].map(i32_at),
            first: u16_at(40),
            last: u16_at(42),
            descriptor: record[44],
            flags: record[45],
            intensity: record[46],
            class: record[47],
        }
    }
}

/// Models by context, made when they are needed.
struct Models(u32, BTreeMap<usize, ArithmeticModel>);

impl Models {
    fn of(&mut self, context: usize) -> &mut ArithmeticModel {
        self.1.entry(context).or_insert_with(|| symbols(self.0))
    }
}

/// Contexts of values, in the order in which they occur.
#[derive(Default)]
struct Contexts(BTreeMap<usize, usize>);

impl Contexts {
    fn of(&mut self, value: usize) -> usize {
        let count = self.0.len();
        *self.0.entry(value).or_insert(count % 128)
    }
}

/// Encoder of pulse records without source IDs and extra bytes.
struct Pulses {
    descriptor_context: usize,
    flags_have_changed: usize,
    contexts: [Contexts; 3],
    changes: Models,
    descriptors: Models,
    flags: Models,
    classes: Models,
    intensities: IntegerCompressor,
    firsts: IntegerCompressor,
    lasts: IntegerCompressor,
    time_difference: i32,
    odd_differences: u32,
    time_changes: ArithmeticModel,
    time_multiples: ArithmeticModel,
    times: IntegerCompressor,
    offset_differences: (BTreeMap<usize, i32>, i32, IntegerCompressor),
    anchor_differences: [(BTreeMap<usize, i32>, i32, IntegerCompressor); 3],
    targets: [IntegerCompressor; 3],
}

impl Pulses {
    fn new() -> Pulses {
        Pulses {
            descriptor_context: 0,
            flags_have_changed: 0,
            contexts: Default::default(),
            changes: Models(64, BTreeMap::new()),
            descriptors: Models(256, BTreeMap::new()),
            flags: Models(256, BTreeMap::new()),
            classes: Models(256, BTreeMap::new()),
            intensities: integers(8, 256),
            firsts: integers(16, 512),
            lasts: integers(16, 512),
            time_difference: 0,
            odd_differences: 0,
            time_changes: symbols(3),
            time_multiples: symbols(256),
            times: integers(32, 9),
            offset_differences: (BTreeMap::new(), 0, integers(32, 128)),
            anchor_differences: std::array::from_fn(|_| (BTreeMap::new(), 0, integers(32, 4))),
            targets: std::array::from_fn(|_| integers(32, 4)),
        }
    }

    fn add(&mut self, encoder: &mut Encoder, from: &Fields, to: &Fields) {
        let spread = i32::from(from.last) - i32::from(from.first);
        let predicted = (spread + i32::from(to.first)).clamp(i16::MIN.into(), i16::MAX.into());
        let changed = |is_changed: bool, bit: usize| if is_changed { bit } else { 0 };
        let mut changes = changed(from.first != to.first, 32)
            | changed(from.descriptor != to.descriptor, 8)
            | changed(from.flags != to.flags, 4)
            | changed(from.intensity != to.intensity, 2)
            | changed(from.class != to.class, 1);
        let is_predicted = if changes == 0 { from.last == to.last } else { predicted as u16 == to.last };
        changes |= changed(!is_predicted, 16);
        let mut context = self.flags_have_changed | self.descriptor_context;
        let anchor_context = changed(self.flags_have_changed != 0, 1) | changed(changes & 4 != 0, 2);
        encoder.encode_symbol(self.changes.of(context), changes as u32).unwrap();
        if changes & 8 != 0 {
            encoder.encode_symbol(self.descriptors.of(context), to.descriptor.into()).unwrap();
            self.descriptor_context = self.contexts[0].of(to.descriptor.into());
            context = self.flags_have_changed | self.descriptor_context;
        }
        let mut of_samples = context;
        if changes & 4 != 0 {
            let model = self.contexts[1].of(context << 8 | usize::from(from.flags));
            encoder.encode_symbol(self.flags.of(model), to.flags.into()).unwrap();
            self.flags_have_changed = 128;
            of_samples |= 256;
        }
        if changes & 2 != 0 {
            let (from, to) = (from.intensity.into(), to.intensity.into());
            self.intensities.compress(encoder, from, to, self.descriptor_context as u32).unwrap();
        }
        if changes & 1 != 0 {
            let model = self.contexts[2].of(context << 8 | usize::from(from.class));
            encoder.encode_symbol(self.classes.of(model), to.class.into()).unwrap();
        }
        if changes & 32 != 0 {
            self.firsts.compress(encoder, from.first.into(), to.first.into(), of_samples as u32).unwrap();
        }
        if changes & 16 != 0 {
            self.lasts.compress(encoder, predicted, to.last.into(), of_samples as u32).unwrap();
        }
        self.add_time(encoder, to.time.wrapping_sub(from.time), to.time);
        let context = self.descriptor_context;
        let (known, last, numbers) = &mut self.offset_differences;
        let prediction = known.get(&context).copied().unwrap_or(*last);
        match i32::try_from(to.offset.wrapping_sub(from.offset)) {
            Ok(difference) if difference != i32::MIN => {
                numbers.compress(encoder, prediction, difference, context as u32).unwrap();
                remember(known, last, context, difference);
            }
            _ => {
                numbers.compress(encoder, prediction, i32::MIN, context as u32).unwrap();
                encoder.write_int64(to.offset as u64).unwrap();
            }
        }
        let mut differences = [0; 3];
        for (axis, to_target) in differences.iter_mut().enumerate() {
            let (known, last, numbers) = &mut self.anchor_differences[axis];
            let prediction = known.get(&anchor_context).copied().unwrap_or(*last);
            let difference = to.anchor[axis].wrapping_sub(from.anchor[axis]);
            numbers.compress(encoder, prediction, difference, anchor_context as u32).unwrap();
            remember(known, last, anchor_context, difference);
            *to_target = difference;
        }
        for (axis, difference) in differences.into_iter().enumerate() {
            let prediction = from.target[axis].wrapping_add(difference);
            self.targets[axis].compress(encoder, prediction, to.target[axis], 0).unwrap();
        }
    }

    fn add_time(&mut self, encoder: &mut Encoder, difference: i64, time: i64) {
        let last = self.time_difference;
        let Ok(difference) = i32::try_from(difference) else {
            match last {
                0 => encoder.encode_symbol(&mut self.time_changes, 2).unwrap(),
                _ => encoder.encode_symbol(&mut self.time_multiples, 255).unwrap(),
            }
            return encoder.write_int64(time as u64).unwrap();
        };
        if last == 0 {
            encoder.encode_symbol(&mut self.time_changes, u32::from(difference != 0)).unwrap();
            if difference != 0 {
                self.times.compress(encoder, 0, difference, 0).unwrap();
                (self.time_difference, self.odd_differences) = (difference, 0);
            }
            return;
        }
        if difference == last {
            self.odd_differences = 0;
            return encoder.encode_symbol(&mut self.time_multiples, 254).unwrap();
        }
        let multiple = ((difference as f32 / last as f32).round() as i32).clamp(-10, 243);
        let symbol = if multiple < 0 { 243 - multiple } else { multiple };
        let context = match multiple {
            0 => 7,
            1 => 1,
            2..10 => 2,
            10..243 => 3,
            243 => 4,
            -10 => 6,
            _ => 5,
        };
        encoder.encode_symbol(&mut self.time_multiples, symbol as u32).unwrap();
        self.times.compress(encoder, multiple.wrapping_mul(last), difference, context).unwrap();
        match multiple {
            1 => self.odd_differences = 0,
            0 | 243 | -10 => self.odd_differences += 1,
            _ => {}
        }
        if self.odd_differences > 3 {
            (self.time_difference, self.odd_differences) = (difference, 0);
        }
    }
}

fn remember(known: &mut BTreeMap<usize, i32>, last: &mut i32, context: usize, difference: i32) {
    known.insert(context, difference);
    if difference == i32::MAX {
        known.remove(&context);
    }
    *last = difference;
}

/// Encoder of source IDs.
struct SourceIds {
    bytes: usize,
    last: u32,
    earlier: Vec<u32>,
    oldest: usize,
    choice: ArithmeticModel,
    new: IntegerCompressor,
}

impl SourceIds {
    fn new(first: &[u8], bytes: usize) -> SourceIds {
        let bits = 8 * bytes.max(2) as u32;
        SourceIds {
            bytes,
            last: source_id(first, bytes),
            earlier: (0..bits).collect(),
            oldest: 0,
            choice: symbols(bits + 2),
            new: integers(bits, 1),
        }
    }

    fn add(&mut self, encoder: &mut Encoder, record: &[u8]) {
        let id = source_id(record, self.bytes);
        if id == self.last {
            return encoder.encode_symbol(&mut self.choice, 0).unwrap();
        }
        match self.earlier.iter().position(|earlier| *earlier == id) {
            Some(number) => encoder.encode_symbol(&mut self.choice, number as u32 + 2).unwrap(),
            None => {
                encoder.encode_symbol(&mut self.choice, 1).unwrap();
                self.new.compress(encoder, self.last as i32, id as i32, 0).unwrap();
                self.earlier[self.oldest] = self.last;
                self.oldest = (self.oldest + 1) % self.earlier.len();
            }
        }
        self.last = id;
    }
}

fn source_id(record: &[u8], bytes: usize) -> u32 {
    record[PULSE..PULSE + bytes].iter().rev().fold(0, |id, &byte| id << 8 | u32::from(byte))
}
