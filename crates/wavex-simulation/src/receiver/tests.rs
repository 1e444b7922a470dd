use super::super::random::Purpose;
use super::*;

fn settings() -> ReceiverSettings {
    ReceiverSettings {
        interval_ns: 1.0,
        full_scale_dn: 255,
        background_dn: [2.0, 4.0],
        noise_sd_dn: 0.0,
        noise_autocorrelation: Vec::new(),
        odd_sample_shift: 0.0,
        response: PulseShape::gaussian(4.5),
        reference: PulseShape::gaussian(4.5),
        high_power: None,
    }
}

fn receiver() -> SimulatedReceiver {
    SimulatedReceiver::new(&settings()).unwrap()
}

fn random() -> Random {
    Random::of_shot(1, 0, 0, Purpose::Noise)
}

/// Echoes of flat targets at these times with these amplitudes.
fn echoes(receiver: &SimulatedReceiver, echoes: &[(f64, f64)]) -> Vec<ReceivedEcho> {
    let width = receiver.response().width(0.0);
    echoes.iter().map(|&(time_ns, amplitude_dn)| echo(time_ns, amplitude_dn, width)).collect()
}

fn echo(time_ns: f64, amplitude_dn: f64, width: WidthIndex) -> ReceivedEcho {
    ReceivedEcho { time_ns, amplitude_dn, high_power_dn: 0.1 * amplitude_dn, linear_dn: amplitude_dn, width }
}

/// Start and length of the blocks opened by echoes of 100 DN at these times.
fn windows(times_ns: &[f64]) -> Vec<(i64, i64)> {
    let (receiver, mut windows) = (receiver(), Vec::new());
    let strong: Vec<(f64, f64)> = times_ns.iter().map(|&time_ns| (time_ns, 100.0)).collect();
    receiver.windows(&echoes(&receiver, &strong), &mut windows);
    windows.iter().map(|window| (window.start, window.len)).collect()
}

#[test]
fn a_block_grows_while_echoes_come() {
    assert_eq!(windows(&[]), []);
    assert_eq!(windows(&[100.0]), [(82, 60)]);
    assert_eq!(windows(&[101.0]), [(84, 60)], "blocks start on even samples");
    assert_eq!(windows(&[100.0, 118.0]), [(82, 60)]);
    assert_eq!(windows(&[100.0, 120.0]), [(82, 120)], "24 samples are required after the second");
    assert_eq!(windows(&[100.0, 157.0]), [(82, 120)], "blocks do not overlap");
    assert_eq!(windows(&[100.0, 159.0]), [(82, 60), (142, 60)]);
    assert_eq!(windows(&[100.0, 150.0, 200.0]), [(82, 180)]);
}

#[test]
fn a_weak_echo_is_recorded_only_in_the_block_of_another() {
    let (receiver, mut windows) = (receiver(), Vec::new());
    let weak = echoes(&receiver, &[(60.0, 5.0), (100.0, 6.0), (120.0, 5.0), (300.0, 5.0)]);
    receiver.windows(&weak, &mut windows);
    assert_eq!(windows, [SampleWindow { start: 82, len: 60 }]);
    let inside: Vec<bool> = weak.iter().map(|echo| receiver.is_in(&windows[0], echo)).collect();
    assert_eq!(inside, [false, true, true, false]);
}

#[test]
fn samples_of_a_block_without_noise() {
    let (mut receiver, mut windows) = (receiver(), Vec::new());
    let one = echoes(&receiver, &[(100.375, 100.0)]);
    receiver.windows(&one, &mut windows);
    let (start_ns, samples) = receiver.record(&windows[0], &one, &mut random());
    assert_eq!((start_ns, samples.len()), (84.375, 60));
    // 100 DN at sample 16, above a background of 2 DN, and 100 * 2^-(2 k / 4.5)^2 at k samples
    // from it.
    assert_eq!(samples[8..25], [2, 4, 3, 7, 13, 33, 60, 91, 102, 91, 60, 33, 13, 7, 3, 4, 2]);
    assert!(samples[..8].chunks(2).chain(samples[26..].chunks(2)).all(|pair| pair == [2, 4]));
}

/// Odd samples are those of an echo that much earlier; even samples are on time.
#[test]
fn late_odd_samples_are_taken_at_their_own_time() {
    let late = ReceiverSettings { odd_sample_shift: 0.25, ..settings() };
    let recorded = |settings: &ReceiverSettings, time_ns: f64| {
        let mut receiver = SimulatedReceiver::new(settings).unwrap();
        let one = echoes(&receiver, &[(time_ns, 100.0)]);
        receiver.record(&SampleWindow { start: 84, len: 60 }, &one, &mut random()).1.to_vec()
    };
    let [on_time, earlier] = [100.375, 100.125].map(|time_ns| recorded(&settings(), time_ns));
    for (k, sample) in recorded(&late, 100.375).into_iter().enumerate() {
        assert_eq!(sample, if k % 2 == 0 { on_time[k] } else { earlier[k] }, "sample {k}");
    }
}

#[test]
fn an_echo_above_full_scale_is_clipped() {
    let (mut receiver, mut windows) = (receiver(), Vec::new());
    let strong = echoes(&receiver, &[(100.375, 1000.0)]);
    receiver.windows(&strong, &mut windows);
    let (_, samples) = receiver.record(&windows[0], &strong, &mut random());
    assert_eq!(samples[12..21], [114, 255, 255, 255, 255, 255, 255, 255, 114]);
}

#[test]
fn the_outgoing_pulse_begins_on_the_raster_and_lies_between_samples() {
    let mut receiver = receiver();
    let (start_ns, samples) = receiver.record_emission(0.5, 1.0, &mut random());
    assert_eq!((start_ns, samples.len()), (-10.0, 24));
    // 177 DN * 2^-(2 k / 4.5)^2 at k = 0.5, 1.5 and 2.5 samples from the peak, above 2 and 4
    // DN.
    assert_eq!(samples[8..14], [77, 134, 173, 175, 132, 79]);
}

#[test]
fn the_second_receiver_sees_strong_echoes_later_and_on_its_own_raster() {
    let high_power = HighPower { from_dn: 150.0, noise_sd_dn: 0.0, delay_ns: 0.43 };
    let mut receiver =
        SimulatedReceiver::new(&ReceiverSettings { high_power: Some(high_power), ..settings() }).unwrap();
    let mut windows = Vec::new();
    let strong = echoes(&receiver, &[(101.375, 1000.0)]);
    receiver.windows(&strong, &mut windows);
    assert!(receiver.is_strong(&windows[0], &strong));
    let (start_ns, samples) = receiver.record_high_power(&windows[0], &strong, &mut random()).unwrap();
    assert_eq!((start_ns, samples.len()), (84.375 + 1.43, 60));
    // 100 DN at 101.805 ns, which is sample 16.
    assert_eq!(samples[12..21], [13, 33, 60, 91, 102, 91, 60, 33, 13]);
    let weak = echoes(&receiver, &[(101.375, 149.0), (400.0, 500.0)]);
    assert!(!receiver.is_strong(&windows[0], &weak));
    assert!(self::receiver().record_high_power(&windows[0], &strong, &mut random()).is_none());
}

#[test]
fn rounding_is_part_of_the_recorded_noise() {
    let settings =
        |noise_sd_dn, rho| ReceiverSettings { noise_sd_dn, noise_autocorrelation: vec![rho], ..settings() };
    assert!(settings(0.0, 0.5).noise().unwrap().is_none());
    assert!(settings(0.93, 0.5).noise().unwrap().is_some());
    assert_eq!(settings(0.28, 0.0).noise().unwrap_err(), NoSuchNoise);
    // A correlation of 0.9 at 0.25 DN² would require 1.35 of the variance without rounding
    // (1/12).
    assert_eq!(settings(0.5, 0.9).noise().unwrap_err(), NoSuchNoise);
}
