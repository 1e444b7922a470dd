//! Round trips with the encoder of the crate `laz`.

use laz::compressors::IntegerCompressor;
use laz::encoders::ArithmeticEncoder;
use laz::models::ArithmeticModelBuilder;
use proptest::prelude::*;

use super::{Decoder, IntegerDecoder, SymbolModel};

type Encoder = ArithmeticEncoder<Vec<u8>>;

fn finished(mut encoder: Encoder) -> Vec<u8> {
    encoder.done().unwrap();
    encoder.into_inner()
}

/// Encodes numbers of these bits, each predicted by the one before it, in contexts by turns.
fn encoded(bits: u32, contexts: u32, numbers: &[i32]) -> Vec<u8> {
    let (mut encoder, mut integers) =
        (Encoder::new(Vec::new()), IntegerCompressor::new(bits, contexts, 8, 0));
    integers.init();
    let mut last = 0;
    for (&number, context) in numbers.iter().zip((0..contexts).cycle()) {
        integers.compress(&mut encoder, last, number, context).unwrap();
        last = number;
    }
    finished(encoder)
}

fn decoded(
    bits: u32,
    contexts: usize,
    count: usize,
    bytes: &[u8],
) -> (Vec<i32>, Result<usize, &'static str>) {
    let (mut input, mut integers) = (Decoder::new(bytes), IntegerDecoder::new(bits, contexts));
    let mut last = 0;
    let numbers = (0..contexts).cycle().take(count).map(|context| {
        last = integers.number(&mut input, last, context);
        last
    });
    (numbers.collect(), input.check_end())
}

/// Numbers with noise, steps and extremes.
fn numbers(bits: u32) -> impl Strategy<Value = Vec<i32>> {
    let mask = u32::MAX >> (32 - bits);
    let one = prop_oneof![
        8 => (0..4u32).prop_map(|noise| 100 + noise),
        2 => 0..300u32,
        1 => any::<u32>(),
        1 => prop::sample::select(vec![0, u32::MAX, 1 << (bits - 1), (1 << (bits - 1)) - 1]),
    ];
    prop::collection::vec(one.prop_map(move |number| (number & mask) as i32), 0..600)
}

proptest! {
    #[test]
    fn numbers_survive(
        (bits, numbers) in prop::sample::select(vec![8u32, 12, 16, 32])
            .prop_flat_map(|bits| (Just(bits), numbers(bits))),
        contexts in 1..4u32,
    ) {
        let bytes = encoded(bits, contexts, &numbers);
        let length = bytes.len();
        let followed = [bytes, vec![7; 9]].concat();
        let found = decoded(bits, contexts as usize, numbers.len(), &followed);
        prop_assert_eq!(found, (numbers, Ok(length)));
    }

    #[test]
    fn any_bytes_are_decoded_without_panic(bytes in prop::collection::vec(any::<u8>(), 0..200), bits in 2..=32u32) {
        let (numbers, end) = decoded(bits, 2, 500, &bytes);
        prop_assert_eq!(numbers.len(), 500);
        prop_assert!(end.is_err() || end.unwrap() <= bytes.len());
        let mut input = Decoder::new(&bytes);
        let mut symbols = [3, 18, 64, 256].map(SymbolModel::new);
        for _ in 0..100 {
            for model in &mut symbols {
                let _ = input.symbol(model);
            }
            let _ = (input.bits(7), input.bits(32), input.i64());
        }
    }

    #[test]
    fn symbols_and_bits_survive(values in prop::collection::vec((0..18u32, any::<u8>(), 1..32u32, any::<u64>()), 0..300)) {
        let mut encoder = Encoder::new(Vec::new());
        let mut models = [18, 256].map(|symbols| ArithmeticModelBuilder::new(symbols).build());
        for &(small, large, bits, number) in &values {
            encoder.encode_symbol(&mut models[0], small).unwrap();
            encoder.encode_symbol(&mut models[1], large.into()).unwrap();
            encoder.write_bits(bits, number as u32 & (u32::MAX >> (32 - bits))).unwrap();
            encoder.write_int64(number).unwrap();
        }
        let bytes = finished(encoder);
        let mut input = Decoder::new(&bytes);
        let mut models = [18, 256].map(SymbolModel::new);
        for &(small, large, bits, number) in &values {
            prop_assert_eq!(input.symbol(&mut models[0]), small as usize);
            prop_assert_eq!(input.symbol(&mut models[1]), usize::from(large));
            prop_assert_eq!(input.bits(bits), number as u32 & (u32::MAX >> (32 - bits)));
            prop_assert_eq!(input.i64(), number as i64);
        }
        prop_assert_eq!(input.check_end(), Ok(bytes.len()));
    }
}

/// Counts are halved after 8192 bits and 32768 symbols.
#[test]
fn long_runs_survive() {
    let mut state = 1u32;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as i32
    };
    for (bits, range) in [(8, 1), (8, 2), (8, 3), (8, 7), (16, 100), (16, 256)] {
        let numbers: Vec<i32> = (0..150_000).map(|_| 20 + noise() % range).collect();
        let bytes = encoded(bits, 1, &numbers);
        assert_eq!(decoded(bits, 1, numbers.len(), &bytes), (numbers, Ok(bytes.len())), "{bits} bits");
    }
}

#[test]
fn a_restarted_decoder_is_like_a_new_one() {
    let bytes = encoded(16, 1, &[3, 3, 4, 70, 65_535, 3]);
    let mut integers = IntegerDecoder::new(16, 1);
    for _ in 0..3 {
        integers.restart();
        let mut samples = [0; 6];
        integers.samples(&mut Decoder::new(&bytes), 0, 0, &mut samples);
        assert_eq!(samples, [3, 3, 4, 70, 65_535, 3]);
    }
}

#[test]
fn missing_and_impossible_bytes_are_noticed() {
    let numbers: Vec<i32> = (0..300).map(|k| 9 + k * k % 23).collect();
    let bytes = encoded(8, 1, &numbers);
    for length in 0..bytes.len() {
        let (_, end) = decoded(8, 1, numbers.len(), &bytes[..length]);
        assert_eq!(end, Err("the encoded data end too early"), "{length} bytes");
    }
    let wrong = Err("no encoder writes these bytes");
    assert_eq!(decoded(8, 1, numbers.len() - 100, &bytes).1, wrong);
    assert_eq!(decoded(8, 1, 1, &[255; 20]).1, wrong);
    assert_eq!(Decoder::new(&[0; 4]).check_end(), Ok(4));
}
