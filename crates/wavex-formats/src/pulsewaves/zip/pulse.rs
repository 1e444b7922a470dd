//! Pulse record type 0, predicted from the record before it.

use crate::arithmetic::{Decoder, IntegerDecoder, SymbolModel};

/// Number of contexts of descriptors, flags and classes; further values share them.
const CONTEXTS: usize = 128;
/// Context bit of a flags byte that has changed in an earlier pulse.
const FLAGS_HAVE_CHANGED: usize = 128;
/// Context bit of a flags byte that changes in this pulse.
const FLAGS_CHANGE: usize = 256;
/// Bits of the fields that change.
const CLASSIFICATION: usize = 1;
const INTENSITY: usize = 2;
const FLAGS: usize = 4;
const DESCRIPTOR: usize = 8;
const LAST_SAMPLE: usize = 16;
const FIRST_SAMPLE: usize = 32;
/// Number of combinations of fields that change.
const CHANGES: usize = 64;

/// Largest multiple of the last time difference with a symbol of its own.
const LARGEST_MULTIPLE: i32 = 243;
/// Smallest multiple of the last time difference.
const SMALLEST_MULTIPLE: i32 = -10;
/// Symbol of an equal time difference.
const SAME_DIFFERENCE: usize = 254;
/// Symbol of a time that is stored whole.
const WHOLE_TIME: usize = 255;
/// Number of time differences that are no multiples until the reference changes.
const ODD_DIFFERENCES: u32 = 4;

/// Decoder of pulse records.
pub(super) struct Pulse {
    time: i64,
    offset: i64,
    anchor: [i32; 3],
    target: [i32; 3],
    first_sample: u16,
    last_sample: u16,
    descriptor: u8,
    flags: u8,
    intensity: u8,
    classification: u8,

    descriptor_context: usize,
    flags_have_changed: usize,
    descriptor_contexts: ContextMap,
    flags_contexts: ContextMap,
    class_contexts: ContextMap,
    changes: Vec<SymbolModel>,
    descriptors: Vec<SymbolModel>,
    all_flags: Vec<SymbolModel>,
    classes: Vec<SymbolModel>,
    intensities: IntegerDecoder,
    first_samples: IntegerDecoder,
    last_samples: IntegerDecoder,

    time_difference: i32,
    odd_differences: u32,
    time_changes: SymbolModel,
    time_multiples: SymbolModel,
    times: IntegerDecoder,

    /// Last differences of the offset to waves, by context and of all.
    offset_differences: Differences,
    anchor_differences: [Differences; 3],
    targets: [IntegerDecoder; 3],
}

/// Contexts of values, numbered in the order in which they occur.
struct ContextMap {
    contexts: Vec<Option<u8>>,
    count: usize,
}

impl ContextMap {
    fn new(values: usize) -> ContextMap {
        ContextMap { contexts: vec![None; values], count: 0 }
    }

    fn of(&mut self, value: usize) -> usize {
        let context = self.contexts[value].get_or_insert_with(|| {
            self.count += 1;
            ((self.count - 1) % CONTEXTS) as u8
        });
        usize::from(*context)
    }
}

/// Differences, each predicted by the last one of its context.
struct Differences {
    /// Last difference of each context.
    of_contexts: Vec<Option<i32>>,
    last: i32,
    numbers: IntegerDecoder,
}

impl Differences {
    fn new(contexts: usize) -> Differences {
        Differences { of_contexts: vec![None; contexts], last: 0, numbers: IntegerDecoder::new(32, contexts) }
    }

    /// Decodes a difference, without remembering it.
    fn next(&mut self, input: &mut Decoder, context: usize) -> i32 {
        let prediction = self.of_contexts[context].unwrap_or(self.last);
        self.numbers.number(input, prediction, context)
    }

    fn remember(&mut self, context: usize, difference: i32) {
        // In the format, the largest number means that there is none.
        self.of_contexts[context] = Some(difference).filter(|&difference| difference != i32::MAX);
        self.last = difference;
    }
}

impl Pulse {
    /// Starts after the record `first`.
    pub(super) fn new(first: &[u8]) -> Pulse {
        let mut record = [0; super::super::header::PULSE_BYTES as usize];
        record.iter_mut().zip(first).for_each(|(to, byte)| *to = *byte);
        let i64_at = |at: usize| i64::from_le_bytes(std::array::from_fn(|i| record[at + i]));
        let i32_at = |at: usize| i32::from_le_bytes(std::array::from_fn(|i| record[at + i]));
        let u16_at = |at: usize| u16::from_le_bytes([record[at], record[at + 1]]);
        let models = |number: usize, symbols: usize| vec![SymbolModel::new(symbols); number];
        Pulse {
            time: i64_at(0),
            offset: i64_at(8),
            anchor: [16, 20, 24].map(i32_at),
            target: [28, 32, 36].map(i32_at),
            first_sample: u16_at(40),
            last_sample: u16_at(42),
            descriptor: record[44],
            flags: record[45],
            intensity: record[46],
            classification: record[47],
            descriptor_context: 0,
            flags_have_changed: 0,
            descriptor_contexts: ContextMap::new(1 << 8),
            flags_contexts: ContextMap::new(1 << 16),
            class_contexts: ContextMap::new(1 << 16),
            changes: models(2 * CONTEXTS, CHANGES),
            descriptors: models(2 * CONTEXTS, 256),
            all_flags: models(CONTEXTS, 256),
            classes: models(CONTEXTS, 256),
            intensities: IntegerDecoder::new(8, CONTEXTS),
            first_samples: IntegerDecoder::new(16, 4 * CONTEXTS),
            last_samples: IntegerDecoder::new(16, 4 * CONTEXTS),
            time_difference: 0,
            odd_differences: 0,
            time_changes: SymbolModel::new(3),
            time_multiples: SymbolModel::new(WHOLE_TIME + 1),
            times: IntegerDecoder::new(32, 9),
            offset_differences: Differences::new(CONTEXTS),
            anchor_differences: std::array::from_fn(|_| Differences::new(4)),
            targets: std::array::from_fn(|_| IntegerDecoder::new(32, 1)),
        }
    }

    /// Decodes the next record and appends it to `records`.
    pub(super) fn next(&mut self, input: &mut Decoder, records: &mut Vec<u8>) {
        let changes = input.symbol(&mut self.changes[self.flags_have_changed | self.descriptor_context]);
        let anchor_context =
            usize::from(self.flags_have_changed != 0) | if changes & FLAGS != 0 { 2 } else { 0 };
        if changes != 0 {
            self.change(changes, input);
        }
        self.next_time(input);
        self.next_offset(input);
        for axis in 0..3 {
            let differences = &mut self.anchor_differences[axis];
            let difference = differences.next(input, anchor_context);
            differences.remember(anchor_context, difference);
            self.anchor[axis] = self.anchor[axis].wrapping_add(difference);
            self.target[axis] = self.target[axis].wrapping_add(difference);
        }
        for (target, numbers) in self.target.iter_mut().zip(&mut self.targets) {
            *target = numbers.number(input, *target, 0);
        }
        records.extend(self.time.to_le_bytes());
        records.extend(self.offset.to_le_bytes());
        self.anchor.iter().chain(&self.target).for_each(|value| records.extend(value.to_le_bytes()));
        records.extend(self.first_sample.to_le_bytes());
        records.extend(self.last_sample.to_le_bytes());
        records.extend([self.descriptor, self.flags, self.intensity, self.classification]);
    }

    /// Decodes the fields that change.
    fn change(&mut self, changes: usize, input: &mut Decoder) {
        let changed = |field: usize| changes & field != 0;
        let mut context = self.flags_have_changed | self.descriptor_context;
        if changed(DESCRIPTOR) {
            self.descriptor = input.symbol(&mut self.descriptors[context]) as u8;
            self.descriptor_context = self.descriptor_contexts.of(self.descriptor.into());
            context = self.flags_have_changed | self.descriptor_context;
        }
        let mut samples_context = context;
        if changed(FLAGS) {
            let model = self.flags_contexts.of(context << 8 | usize::from(self.flags));
            self.flags = input.symbol(&mut self.all_flags[model]) as u8;
            // The format never forgets a change within a chunk.
            self.flags_have_changed = FLAGS_HAVE_CHANGED;
            samples_context |= FLAGS_CHANGE;
        }
        if changed(INTENSITY) {
            let intensity = self.intensities.number(input, self.intensity.into(), self.descriptor_context);
            self.intensity = intensity as u8;
        }
        if changed(CLASSIFICATION) {
            let model = self.class_contexts.of(context << 8 | usize::from(self.classification));
            self.classification = input.symbol(&mut self.classes[model]) as u8;
        }
        let spread = i32::from(self.last_sample) - i32::from(self.first_sample);
        if changed(FIRST_SAMPLE) {
            let first = self.first_samples.number(input, self.first_sample.into(), samples_context);
            self.first_sample = first as u16;
        }
        let range = i32::from(i16::MIN)..=i32::from(i16::MAX);
        let prediction = (spread + i32::from(self.first_sample)).clamp(*range.start(), *range.end());
        self.last_sample = match changed(LAST_SAMPLE) {
            true => self.last_samples.number(input, prediction, samples_context) as u16,
            false => prediction as u16,
        };
    }

    fn next_time(&mut self, input: &mut Decoder) {
        if self.time_difference == 0 {
            match input.symbol(&mut self.time_changes) {
                0 => {}
                1 => {
                    self.time_difference = self.times.number(input, 0, 0);
                    self.odd_differences = 0;
                    self.time = self.time.wrapping_add(self.time_difference.into());
                }
                _ => self.time = input.i64(),
            }
            return;
        }
        let symbol = input.symbol(&mut self.time_multiples);
        let multiple = match symbol as i32 {
            multiple if multiple <= LARGEST_MULTIPLE => multiple,
            symbol => LARGEST_MULTIPLE - symbol,
        };
        // Multiples that may be larger than the symbol says count towards a new reference.
        let (context, is_odd) = match multiple {
            _ if symbol == WHOLE_TIME => {
                self.time = input.i64();
                return;
            }
            _ if symbol == SAME_DIFFERENCE => {
                self.odd_differences = 0;
                self.time = self.time.wrapping_add(self.time_difference.into());
                return;
            }
            0 => (7, true),
            1 => {
                self.odd_differences = 0;
                (1, false)
            }
            2..10 => (2, false),
            10..LARGEST_MULTIPLE => (3, false),
            LARGEST_MULTIPLE => (4, true),
            SMALLEST_MULTIPLE => (6, true),
            _ => (5, false),
        };
        let prediction = multiple.wrapping_mul(self.time_difference);
        let difference = self.times.number(input, prediction, context);
        self.time = self.time.wrapping_add(difference.into());
        if is_odd {
            self.odd_differences += 1;
            if self.odd_differences == ODD_DIFFERENCES {
                self.time_difference = difference;
                self.odd_differences = 0;
            }
        }
    }

    fn next_offset(&mut self, input: &mut Decoder) {
        let context = self.descriptor_context;
        match self.offset_differences.next(input, context) {
            // PulseTools writes the offset itself where a difference has more than 32 bits.
            i32::MIN => self.offset = input.i64(),
            difference => {
                self.offset = self.offset.wrapping_add(difference.into());
                self.offset_differences.remember(context, difference);
            }
        }
    }
}
