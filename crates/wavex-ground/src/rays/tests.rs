use super::*;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

/// Random numbers in 0..1.
struct Random(Xoshiro256PlusPlus);

impl Random {
    fn new(seed: u64) -> Random {
        Random(Xoshiro256PlusPlus::seed_from_u64(seed))
    }

    fn next(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }
}

/// Hilly ground of 100 x 100 m with four points per m², and a wire 25 m above it.
fn land(random: &mut Random) -> Vec<CloudPoint> {
    let ground = |x: f64, y: f64| 100.0 + 0.1 * x + 3.0 * libm::sin(y / 15.0);
    let mut points: Vec<CloudPoint> = (0..40_000)
        .map(|_| {
            let (x, y) = (random.between(0.0, 100.0), random.between(0.0, 100.0));
            CloudPoint::at([5e5 + x, 5.8e6 + y, ground(x, y) + random.between(-0.03, 0.03)])
        })
        .collect();
    points.extend((0..60).map(|k| {
        let x = f64::from(k) * 100.0 / 60.0;
        CloudPoint::at([5e5 + x, 5.8e6 + 50.0, ground(x, 50.0) + 25.0])
    }));
    points
}

fn classes_of(points: &[CloudPoint]) -> Vec<Class> {
    mark_noise(points, &NoiseSettings::default())
}

#[test]
fn low_and_high_noise_is_marked_and_land_and_wires_are_kept() {
    let mut random = Random::new(1);
    let mut points = land(&mut random);
    let n = points.len();
    // Single points, a dense cluster 20 m below, multipath 2 m below, a bird of four points, a cloud.
    let mut add = |x: f64, y: f64, z: f64| points.push(CloudPoint::at([5e5 + x, 5.8e6 + y, z]));
    add(20.0, 20.0, -400.0);
    add(40.0, 60.0, 60.0);
    (0..40).for_each(|k| add(70.0 + 0.05 * f64::from(k), 30.0 + 0.05 * f64::from(k % 7), 80.0));
    add(50.0, 20.0, 100.0 + 5.0 + 3.0 * libm::sin(20.0 / 15.0) - 2.0);
    let n_low = points.len();
    let mut add = |x: f64, y: f64, z: f64| points.push(CloudPoint::at([5e5 + x, 5.8e6 + y, z]));
    (0..4).for_each(|k| add(30.0 + 0.4 * f64::from(k), 80.0, 150.0));
    add(30.0, 10.0, 130.0);
    (0..500).for_each(|_| {
        add(random.between(40.0, 70.0), random.between(40.0, 90.0), random.between(300.0, 320.0))
    });
    let classes = classes_of(&points);
    assert!(classes[..n].iter().all(|class| *class == Class::Unclassified));
    assert!(classes[n..n_low].iter().all(|class| *class == Class::LowNoise), "{:?}", &classes[n..n_low]);
    assert!(
        classes[n_low..].iter().all(|class| *class == Class::HighNoise),
        "{:?}",
        &classes[n_low..n_low + 9]
    );

    // Another order of the same points gives the same classes.
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by_key(|&at| at.wrapping_mul(0x9e37_79b9) % 65_537);
    let shuffled: Vec<CloudPoint> = order.iter().map(|&at| points[at]).collect();
    let of_shuffled = classes_of(&shuffled);
    assert!(order.iter().zip(of_shuffled).all(|(&at, class)| classes[at] == class));
}

#[test]
fn pits_and_objects_that_nothing_passes_are_kept() {
    let mut random = Random::new(2);
    // A shaft of 8 x 8 m, 30 m deep, without walls, and a roof 100 m high that hides the ground below.
    let is_in = |x: f64, y: f64, low: f64, high: f64| (low..high).contains(&x) && (low..high).contains(&y);
    let points: Vec<CloudPoint> = land(&mut random)
        .into_iter()
        .map(|mut point| {
            let [x, y, z] = point.position_m;
            let (x, y) = (x - 5e5, y - 5.8e6);
            if is_in(x, y, 20.0, 28.0) {
                point.position_m[2] = z - 30.0;
            } else if is_in(x, y, 60.0, 80.0) {
                point.position_m[2] = 210.0;
            }
            point
        })
        .collect();
    assert!(classes_of(&points).iter().all(|class| *class == Class::Unclassified));
}

/// Beams that were inclined did not pass where a vertical line would.
#[test]
fn beams_decide_what_was_passed() {
    let mut random = Random::new(3);
    let mut points = land(&mut random);
    points.retain(|point| (point.position_m[2] - 100.0) < 20.0);
    let n = points.len();
    // A layer 100 m above the ground; inclined beams in its shadow reach the ground beside.
    let inclined = [0.6f32, 0.0, -0.8];
    for point in &mut points {
        point.beam = inclined;
    }
    let shadow = |x: f64| (30.0..60.0).contains(&x);
    let layer: Vec<CloudPoint> = points
        .iter()
        .filter(|point| shadow(point.position_m[0] - 5e5))
        .map(|point| {
            let [x, y, z] = point.position_m;
            CloudPoint { position_m: [x - 75.0, y, z + 100.0], ..*point }
        })
        .collect();
    let n_marked = |mut points: Vec<CloudPoint>| {
        let n = points.len();
        points.extend_from_slice(&layer);
        classes_of(&points)[n..].iter().filter(|class| **class == Class::HighNoise).count()
    };
    let is_hidden = |point: &&CloudPoint| shadow(point.position_m[0] - 5e5);
    let unhidden: Vec<CloudPoint> = points.iter().filter(|point| !is_hidden(point)).copied().collect();
    assert!(layer.len() > 10_000 && unhidden.len() + layer.len() == n);
    assert_eq!(n_marked(unhidden), 0, "no beam passed the layer");
    assert_eq!(n_marked(points), layer.len(), "as many beams passed the layer as hit it");
}

#[test]
fn anything_is_accepted_without_a_panic() {
    let nan = f64::NAN;
    assert!(classes_of(&[]).is_empty());
    assert_eq!(classes_of(&[CloudPoint::at([nan, 0.0, 0.0])]), [Class::Unclassified]);
    assert_eq!(classes_of(&[CloudPoint::at([1.0, 2.0, 3.0])]).len(), 1);
    let mut points = land(&mut Random::new(4));
    let n = points.len();
    for position_m in [
        [f64::INFINITY, 0.0, 0.0],
        [0.0; 3],
        [5e5 + 50.0, 5.8e6 + 50.0, 1e300],
        [1e300; 3],
        [-1e11, 1e11, -1e11],
        [5e5 + 50.0, 5.8e6 + 50.0, -1e9],
    ] {
        points.push(CloudPoint { beam: [f32::NAN; 3], ..CloudPoint::at(position_m) });
    }
    let classes = classes_of(&points);
    assert!(classes[..n].iter().all(|class| *class == Class::Unclassified));
    assert_eq!(classes[n], Class::Unclassified);
    assert_eq!((classes[n + 1], classes[n + 5]), (Class::LowNoise, Class::LowNoise));
}

#[test]
fn objects_of_chance_are_larger_where_noise_is_dense() {
    assert_eq!(fewest_points(0.0), 3);
    assert_eq!(fewest_points(0.02), 3);
    assert!(fewest_points(0.3) > 5 && fewest_points(5.0) == 12);
}
