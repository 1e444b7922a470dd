//! Ground of `wavex classify` against the classes of others.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use flate2::read::GzDecoder;
use las::{Builder, Point, Reader, Transform, Vector, Writer};
use wavex_testkit::{TestFolder, data};

/// Samples of the ISPRS filter test (Sithole and Vosselman 2004) that are in the data.
const SAMPLES: [&str; 8] = ["12", "21", "23", "31", "41", "51", "53", "61"];

/// Numbers of points by truth, then by result: `[0]` ground, `[1]` object.
type Confusion = [[f64; 2]; 2];

fn total_error(counts: &Confusion) -> f64 {
    let all: f64 = counts.iter().flatten().sum();
    (counts[0][1] + counts[1][0]) / all
}

/// Cohen's kappa.
fn kappa(counts: &Confusion) -> f64 {
    let all: f64 = counts.iter().flatten().sum();
    let chance: f64 =
        (0..2).map(|k| (counts[k][0] + counts[k][1]) * (counts[0][k] + counts[1][k]) / (all * all)).sum();
    1.0 - total_error(counts) / (1.0 - chance)
}

/// Positions of a sample, and whether each is ground.
fn sample(path: &Path) -> (Vec<[f64; 3]>, Vec<bool>) {
    let mut text = String::new();
    GzDecoder::new(File::open(path).unwrap()).read_to_string(&mut text).unwrap();
    let line = |line: &str| {
        let values: Vec<f64> = line.split_whitespace().map(|value| value.parse().unwrap()).collect();
        ([values[0], values[1], values[2]], values[3] == 0.0)
    };
    text.lines().map(line).unzip()
}

fn write(path: &Path, positions_m: &[[f64; 3]]) {
    let mut builder = Builder::from((1, 4));
    let axis = Transform { scale: 0.01, offset: 0.0 };
    builder.transforms = Vector { x: axis, y: axis, z: axis };
    let mut writer = Writer::from_path(path, builder.into_header().unwrap()).unwrap();
    for &[x, y, z] in positions_m {
        writer.write_point(Point { x, y, z, ..Point::default() }).unwrap();
    }
    writer.close().unwrap();
}

fn classes(path: &Path) -> Vec<u8> {
    let mut reader = Reader::new(BufReader::new(File::open(path).unwrap())).unwrap();
    reader.read_all().unwrap().classification().collect()
}

fn confusion(truth: impl Iterator<Item = bool>, classes: &[u8]) -> Confusion {
    let mut counts = Confusion::default();
    for (is_ground, class) in truth.zip(classes) {
        counts[usize::from(!is_ground)][usize::from(*class != 2)] += 1.0;
    }
    counts
}

/// One set of parameters for all samples; points without beams and return numbers.
#[test]
fn ground_of_the_isprs_samples() {
    let Some(data) = data() else { return };
    let place = TestFolder::new();
    let mut all = Vec::new();
    for name in SAMPLES {
        let (positions_m, truth) = sample(&data.join(format!("isprs/samp{name}.txt.gz")));
        let [cloud, out] = [format!("{name}.las"), format!("{name}_ground.las")];
        write(&place.path(&cloud), &positions_m);
        assert_eq!(place.wavex(&["classify", &cloud, "-o", &out]).code, Some(0));
        let counts = confusion(truth.into_iter(), &classes(&place.path(&out)));
        println!(
            "sample {name}: type I {:.1} %, type II {:.1} %, total {:.2} %, kappa {:.1} %",
            100.0 * counts[0][1] / (counts[0][0] + counts[0][1]),
            100.0 * counts[1][0] / (counts[1][0] + counts[1][1]),
            100.0 * total_error(&counts),
            100.0 * kappa(&counts)
        );
        all.push(counts);
    }
    let mean = |of: fn(&Confusion) -> f64| all.iter().map(of).sum::<f64>() / all.len() as f64;
    let worst = all.iter().map(total_error).fold(0.0, f64::max);
    println!("mean total {:.2} %, kappa {:.1} %", 100.0 * mean(total_error), 100.0 * mean(kappa));
    assert!(mean(total_error) <= 0.027 && worst <= 0.06 && mean(kappa) >= 0.895);
}

/// The two strips of Golm, classified together, against the class 2 of the files.
#[test]
fn ground_of_golm() {
    let Some(data) = data() else { return };
    let place = TestFolder::new();
    let folder = data.join("golm");
    let outcome = place.wavex(&["classify", folder.to_str().unwrap(), "-o", "out"]);
    assert_eq!(outcome.code, Some(0), "{}", outcome.err);
    for name in ["strip04.laz", "strip05.laz"] {
        let truth = classes(&folder.join(name));
        let found = classes(&place.path(&format!("out/{name}")));
        let counts = confusion(truth.iter().map(|class| *class == 2), &found);
        let agreement = 1.0 - total_error(&counts);
        println!("{name}: {:.2} % agree, {counts:?}", 100.0 * agreement);
        assert!(agreement >= 0.97, "{name}: {agreement}");
    }
}
