"""Simulates large-footprint waveforms with truth; writes HDF5 in the layout of GEDI01_B.

The physics is written here from textbooks and from statistics of recorded waveforms. It shares nothing
with the simulator of the program under test.

Conventions
- A surface lies at the sample where the reference point of its echo is. The reference point is the centre
  of a Gaussian fitted to the outgoing pulse (`tx_gloc`, 0-based within the shot's outgoing samples).
- `ground_m` is the mean elevation of the ground that the light reaches. Under crowns on a slope it differs
  from `ground_centre_m`, the elevation of the ground at the footprint's centre.
- `rh[k]` is the height over `ground_m` below which k % of the reflected energy lies, before the pulse and
  the noise. RH0 and RH100 are taken at 0.1 % and 99.9 %. `rh_waveform` is the same from the waveform
  without noise: its heights include the width of the pulse.
- `cover` is the share of the light that foliage intercepts.
- `sensitivity` is the cover at which ground of foliage's reflectance is detected in 90 % of shots at 5 % false
  alarms in a search window of 200 samples (30 m): 1 - (3.48 + 1.28) x SD x W / E. E is the received energy,
  SD the noise before smoothing, W = 28.4 ns the equivalent width of a smoothed ground echo. W is fitted: it
  reproduces 1 - sensitivity of 164 recorded shots to 7 % (SD). `sensitivity_slope` replaces W and the reflectance by
  those of the shot's own ground.
"""

import argparse
from pathlib import Path

import numpy as np

import footprint_file

STEPS, BINS, ORIGIN = 4, 4096, 3000  # profile bins per sample; bins; bin of the ground
LENGTH, PAD = 2048, 4                # samples simulated; samples before the first one recorded
SAMPLE_M = 299_792_458.0 / 1.00025 * 0.5e-9
BEAM_SD_M = 25.0 / 4.0               # 1/e^2 diameter 25 m
RAYS = 256
# Smoothing of the recorded samples: its autocorrelation is 0.92 0.72 0.48 0.25 0.10, as that of recorded noise.
HALF_KERNEL = np.array([0.2155, 0.1947, 0.1343, 0.0686, -0.0053])
KERNEL = np.concatenate([HALF_KERNEL[:0:-1], HALF_KERNEL]) / (2 * HALF_KERNEL.sum() - HALF_KERNEL[0])
# A recorded file states the SD of noise before smoothing; it is 1.76 times the SD of the samples.
STATED_NOISE = 1.76
FALSE_ALARM_SD, DETECTION_SD, ECHO_WIDTH = 3.48, 1.28, 28.4
# Pulse per beam: SD of a Gaussian and decay of an exponential, samples; noise mean and SD, DN.
WIDE, NARROW = (4.36, 7.5), (3.60, 5.9)
# Recorded outgoing pulses fall to 0.3-1 % of their peak 50 samples later, and then by half in 25 samples or more.
TAIL_SHARE, TAIL_DECAY = 0.04, 35.0
BEAMS = {
    "BEAM0000": (WIDE, 231.0, 1.60), "BEAM0001": (WIDE, 245.5, 1.65), "BEAM0010": (WIDE, 241.0, 1.42),
    "BEAM0011": (WIDE, 238.2, 1.50), "BEAM0101": (WIDE, 204.9, 1.86), "BEAM0110": (WIDE, 215.3, 1.80),
    "BEAM1000": (NARROW, 254.7, 1.73), "BEAM1011": (NARROW, 249.1, 1.70),
}  # fmt: skip
COVER_CLASSES = np.array([0.0, 0.3, 0.6, 0.8, 0.9, 0.95, 1.0])  # upper bounds; class 0 is bare ground
KINDS = ("bare", "gaussians", "crowns")


def gaussian_centre(samples):
    """Centre and SD of the Gaussian that fits the samples best."""
    at = np.arange(samples.size)
    height, centre, sd = samples.max(), float(samples.argmax()), 6.0
    for _ in range(30):
        scaled = (at - centre) / sd
        bell = np.exp(-0.5 * scaled**2)
        design = np.stack([bell, height * bell * scaled / sd, height * bell * scaled**2 / sd], axis=1)
        step = np.linalg.lstsq(design, samples - height * bell, rcond=None)[0]
        height, centre, sd = height + step[0], centre + step[1], sd + step[2]
    return centre, sd


def transfer(frequency, shape, stretch, tail):
    """Spectrum of the outgoing pulse of unit energy.

    A Gaussian convolved with an exponential; a share of it decays slowly (`tail`).
    """
    sd, decay = shape[0] * stretch[:, None], shape[1] * stretch[:, None]
    slow = 1 - tail + tail / (1 + 2j * np.pi * frequency * TAIL_DECAY)
    return slow * np.exp(-2 * (np.pi * frequency * sd) ** 2) / (1 + 2j * np.pi * frequency * decay)


def smoothed(samples):
    """Convolution along the last axis with the kernel; the length stays."""
    padded = np.pad(samples, [(0, 0), (PAD, PAD)], mode="edge")
    return sum(weight * padded[:, k : k + samples.shape[1]] for k, weight in enumerate(KERNEL))


def reference_offsets(shape, stretch, tail):
    """Distance from the Gaussian part of the pulse to its reference point, and its fitted SD, per shot."""
    grid = np.linspace(0.85, 1.15, 7)
    frequency = np.fft.rfftfreq(512)
    pulse = np.fft.irfft(transfer(frequency, shape, grid, tail) * np.exp(-2j * np.pi * frequency * 200), 512)
    fits = np.array([gaussian_centre(row) for row in smoothed(pulse)])
    return np.interp(stretch, grid, fits[:, 0] - 200), np.interp(stretch, grid, fits[:, 1])


def spread(position, weight, rows, columns, row=0):
    """Histogram of weights at fractional columns, shared between the two nearest."""
    low = np.clip(np.floor(position).astype(np.int64), 0, columns - 2)
    part = position - low
    flat = row * columns + low
    sums = np.bincount(flat, weight * (1 - part), rows * columns)
    return (sums + np.bincount(flat + 1, weight * part, rows * columns)).reshape(rows, columns)


def layer_profile(random, shot, height):
    """Foliage of Gaussian layers over flat ground: energy per bin of a shot, ordered from the top."""
    top = shot["canopy_top_m"]
    centre = np.array([random.uniform(0.60, 0.85), random.uniform(0.05, 0.20),
                       random.uniform(0.35, 0.60), random.uniform(0.20, 0.40)])  # fmt: skip
    sd = np.array([random.uniform(0.08, 0.20), random.uniform(0.03, 0.10), *random.uniform(0.06, 0.15, 2)])
    weight = random.dirichlet([2.0, 1.0, 1.0, 1.0][: shot["layers"]])
    used = slice(0, shot["layers"])
    scaled = (height[:, None] - top * centre[used]) / (top * sd[used])
    density = (np.exp(-0.5 * scaled**2) / sd[used]) @ weight * ((height > 0.3) & (height < top))
    depth = -np.log1p(-shot["cover"]) * np.cumsum(density) / density.sum()
    return -np.diff(np.exp(-depth), prepend=1.0)


def crown_profile(random, shot, step_m):
    """Foliage of ellipsoidal crowns over a slope, by rays.

    Returns foliage and ground energy per bin, and changes cover, top and the offset of the ground of the shot.
    """
    number = np.arange(RAYS)
    first, second = ((random.random(2)[:, None] + number * np.array([[0.7548776662], [0.5698402910]])) % 1.0)
    radius = BEAM_SD_M * np.sqrt(-2 * np.log(np.maximum(first, 1e-6)))
    ray = np.stack([radius * np.cos(2 * np.pi * second), radius * np.sin(2 * np.pi * second)])
    gradient = np.array([shot["gradient_x"], shot["gradient_y"]])
    floor = gradient @ ray + shot["roughness_m"] * random.normal(size=RAYS)

    closure = (0.3 + random.uniform(1.3, 2.5) * -np.log1p(-shot["cover"])) * random.dirichlet([2.0] * shot["layers"])
    crowns = []
    for layer, share in enumerate(closure):
        tall = max(shot["canopy_top_m"] * (1.0, 0.55, 0.2)[layer], 1.5)
        wide = np.clip(tall * random.uniform(0.12, 0.22), 1.2, 6.0)
        many = 1 + min(random.poisson(share * (18.0 / wide) ** 2), 500)
        top = tall * np.where(np.arange(many) == 0, 1.0, random.uniform(0.75, 1.0, many))
        half = top * random.uniform(0.15, 0.40, many)
        where, angle = 18.0 * np.sqrt(random.random(many)), random.uniform(0, 2 * np.pi, many)
        if layer == 0:
            where[0] *= 0.3  # the tallest crown is inside the footprint
        crowns.append([where * np.cos(angle), where * np.sin(angle), top - half, half,
                       wide * random.uniform(0.7, 1.3, many), random.lognormal(0.0, 0.3, many)])  # fmt: skip
    x, y, middle, half, wide, density = np.concatenate(crowns, axis=1)
    middle = middle + gradient @ np.stack([x, y])
    off = ((ray[0][:, None] - x) ** 2 + (ray[1][:, None] - y) ** 2) / wide**2
    hit, crown = np.nonzero(off < 1)
    chord = half[crown] * np.sqrt(1 - off[hit, crown])
    # Positions count samples downwards; foliage below the ground is cut.
    floor_at = ORIGIN / STEPS - floor / step_m
    upper = np.minimum(ORIGIN / STEPS - (middle[crown] + chord) / step_m, floor_at[hit])
    lower = np.minimum(ORIGIN / STEPS - (middle[crown] - chord) / step_m, floor_at[hit])
    total = np.bincount(hit, density[crown] * (lower - upper), RAYS)
    low, high = -9.0, 5.0  # logarithm of the density that gives the wanted cover
    for _ in range(40):
        scale = np.exp(0.5 * (low + high))
        low, high = (low, np.log(scale)) if 1 - np.exp(-scale * total).mean() > shot["cover"] else (np.log(scale), high)
    gap = np.exp(-scale * total)
    # The second derivative of the depth has a step where a chord starts and where it ends.
    base = int(upper.min(initial=floor_at.min())) - 2
    columns = int(floor_at.max()) + 4 - base
    ends, weight = np.concatenate([upper, lower]) + 1 - base, scale * density[crown]
    bends = spread(ends, np.concatenate([weight, -weight]), RAYS, columns, np.concatenate([hit, hit]))
    lost = -np.diff(np.exp(-np.cumsum(np.cumsum(bends, axis=1), axis=1)).mean(axis=0), prepend=1.0)
    # An entry is what foliage takes between the sample before it and its own.
    start = STEPS * (base - 1) + 1
    foliage = np.zeros(BINS)
    foliage[start : start + STEPS * columns] = np.repeat(lost, STEPS) / STEPS
    ground = spread(STEPS * floor_at, gap / RAYS, 1, BINS)[0]
    shot["cover"] = 1 - gap.mean()
    shot["ground_offset_m"] = (gap * floor).sum() / gap.sum()
    shot["canopy_top_m"] = crowns[0][2][0] + crowns[0][3][0]
    return foliage, ground


def draw(random, shots, kind, beams, slope_max):
    """Parameters of the shots, a dictionary of arrays."""
    mixed = np.where(random.random(shots) < 0.15, 0, random.integers(1, 3, shots))
    kinds = mixed if kind == "mixed" else np.full(shots, KINDS.index(kind))
    bare = kinds == 0
    slope = slope_max * random.random(shots) ** 2  # half of them below a quarter of the largest
    aspect, azimuth = random.uniform(0, 2 * np.pi, (2, shots))
    off_nadir = random.uniform(0, 6.0, shots)
    rise, lean = np.tan(np.radians(slope)), np.tan(np.radians(off_nadir))
    layers = np.where(kinds == 2, random.integers(1, 4, shots), random.integers(1, 5, shots))
    return {
        "beam": np.sort(np.resize(beams, shots)), "kind": kinds, "layers": np.where(bare, 0, layers),
        "cover": np.where(bare, 0.0, np.maximum(0.99 * random.random(shots) ** 0.7, 0.01)),
        "canopy_top_m": np.where(bare, 0.0, np.exp(random.uniform(np.log(4), np.log(48), shots))),
        "slope_deg": slope, "roughness_m": random.uniform(0, 0.3, shots),
        "off_nadir_deg": off_nadir, "azimuth_rad": azimuth,
        # Rise of the ground against the plane across the beam.
        "gradient_x": rise * np.cos(aspect) + lean * np.cos(azimuth),
        "gradient_y": rise * np.sin(aspect) + lean * np.sin(azimuth),
        "reflectance_ratio": random.uniform(0.5, 1.5, shots), "ground_offset_m": np.zeros(shots),
        "sensitivity": random.uniform(0.90, 0.99, shots),
        "stretch": np.clip(1 + 0.03 * random.normal(size=shots), 0.9, 1.1),
        "noise_sd_dn": 0.04 * random.normal(size=shots) + 1.0, "noise_mean_dn": 0.5 * random.normal(size=shots),
    }  # fmt: skip


def profiles(random, table):
    """Energy per bin of every shot, which sums to 1, the share of the ground, and the SD of the ground."""
    shots = table["cover"].size
    step_m = SAMPLE_M * np.cos(np.radians(table["off_nadir_deg"]))
    canopy, ground = np.zeros((2, shots, BINS))
    for k in range(shots):
        shot = {name: column[k] for name, column in table.items()}
        if shot["kind"] == 2:
            canopy[k], ground[k] = crown_profile(random, shot, step_m[k])
            for name in ("cover", "ground_offset_m", "canopy_top_m"):
                table[name][k] = shot[name]
        else:
            ground[k, ORIGIN] = 1 - shot["cover"]
            if shot["kind"] == 1:
                canopy[k] = layer_profile(random, shot, (ORIGIN - np.arange(BINS)) * step_m[k] / STEPS)
    # Layers and bare ground lie flat so far: the slope spreads them over the footprint.
    slope_sd = BEAM_SD_M * np.hypot(table["gradient_x"], table["gradient_y"])
    frequency = np.fft.rfftfreq(BINS, 1 / STEPS)
    for kind, rough in ((canopy, 0.0), (ground, table["roughness_m"])):
        flat = table["kind"] != 2
        sd = (np.sqrt(slope_sd**2 + rough**2) / step_m)[flat, None]
        kind[flat] = np.fft.irfft(np.fft.rfft(kind[flat]) * np.exp(-2 * (np.pi * frequency * sd) ** 2), BINS)
    ground, canopy = np.maximum(ground, 0), np.maximum(canopy, 0) * table["reflectance_ratio"][:, None]
    total = (ground + canopy).sum(axis=1)
    ground_sd = np.hypot(slope_sd, table["roughness_m"]) / step_m
    return (ground + canopy) / total[:, None], ground / total[:, None], ground_sd


def relative_heights(energy, edges):
    """Heights of 0 to 100 % of the energy, from below; edges of the bins are in descending order."""
    parts = np.concatenate([[0.001], np.arange(1, 100) / 100, [0.999]])
    result = np.empty((energy.shape[0], parts.size), dtype=np.float32)
    for k, row in enumerate(energy):
        below = np.concatenate([[0.0], np.cumsum(row[::-1])])
        result[k] = np.interp(parts * below[-1], below, edges[k, ::-1])
    return result


def simulate(random, table, drift=0.0, shot_noise=0.0, tail=TAIL_SHARE):
    """Adds received and outgoing samples and the truth to the table."""
    shots = table["cover"].size
    profile, ground_part, ground_sd = profiles(random, table)
    step_m = SAMPLE_M * np.cos(np.radians(table["off_nadir_deg"]))
    setting = [BEAMS[beam] for beam in table["beam"]]
    table["noise_sd_dn"] *= np.array([beam[2] for beam in setting])
    table["noise_mean_dn"] += np.array([beam[1] for beam in setting])
    need = (FALSE_ALARM_SD + DETECTION_SD) * ECHO_WIDTH * STATED_NOISE * table["noise_sd_dn"]
    energy = need / (1 - table["sensitivity"])
    least = np.hypot(ECHO_WIDTH / np.sqrt(2 * np.pi), ground_sd) / (ECHO_WIDTH / np.sqrt(2 * np.pi)) * need / energy
    table["sensitivity_slope"] = (1 - least) / (1 - least + least * table["reflectance_ratio"])
    table["ground_share"] = ground_part.sum(axis=1)
    table["cover_class"] = np.where(table["kind"] == 0, 0, np.searchsorted(COVER_CLASSES, table["cover"]))

    # Room above the highest and below the lowest energy, and a place for the ground in what remains.
    first = (profile > 1e-9).argmax(axis=1) / STEPS
    last = BINS / STEPS - (profile[:, ::-1] > 1e-9).argmax(axis=1) / STEPS
    above, below = ORIGIN / STEPS - first + 70, last - ORIGIN / STEPS + 110
    count = np.maximum(random.integers(700, 1401, shots), np.ceil(above + below).astype(int))
    centre = above + random.random(shots) * (count - above - below)
    table["count"], table["centre_sample"] = count, centre
    table["ground_sample"] = centre - table["ground_offset_m"] / step_m
    shapes = np.array([beam[0] for beam in setting]).T[:, :, None]
    offset, table["tx_sd"] = np.empty((2, shots))
    for shape in (WIDE, NARROW):
        own = [beam[0] == shape for beam in setting]
        offset[own], table["tx_sd"][own] = reference_offsets(shape, table["stretch"][own], tail)

    table["tx_gaussian"], table["tx_decay"] = shapes[:, :, 0] * table["stretch"]
    white = table["noise_sd_dn"] / np.sqrt((KERNEL**2).sum())

    def recorded(clean, k):
        """Noise, digitisation and smoothing of the samples of shots."""
        raw = clean + table["noise_mean_dn"][k, None] + white[k, None] * random.normal(size=clean.shape)
        raw += np.sqrt(np.maximum(shot_noise * clean, 0)) * random.normal(size=clean.shape)
        return smoothed(np.clip(np.rint(raw), 0, 4095))

    table["rx"], table["tx"] = [], []
    edges = (ORIGIN + 0.5 - np.arange(BINS + 1)) / STEPS * step_m[:, None] - table["ground_offset_m"][:, None]
    table["rh"] = relative_heights(profile, edges)
    table["rh_waveform"] = np.empty((shots, 101), dtype=np.float32)
    peak, ground_peak = np.empty((2, shots))
    table["tx_gloc"] = random.uniform(52, 62, shots)
    frequency, tx_frequency = np.fft.rfftfreq(LENGTH * STEPS, 1 / STEPS), np.fft.rfftfreq(512)
    for start in range(0, shots, 250):
        k = np.arange(start, min(start + 250, shots))
        response = transfer(frequency, shapes[:, k], table["stretch"][k], tail)
        delay = centre[k] + PAD - ORIGIN / STEPS - offset[k]
        response *= np.exp(-2j * np.pi * frequency * delay[:, None]) * STEPS * energy[k, None]
        clean, ground = (np.fft.irfft(np.fft.rfft(part[k], LENGTH * STEPS) * response)[:, ::STEPS]
                         for part in (profile, ground_part))  # fmt: skip
        perfect = smoothed(clean)
        peak[k], ground_peak[k] = perfect.max(axis=1), smoothed(ground).max(axis=1)
        edges = (table["ground_sample"][k, None] + PAD + 0.5 - np.arange(LENGTH + 1)) * step_m[k, None]
        table["rh_waveform"][k] = relative_heights(np.maximum(perfect, 0), edges)
        wave = 2 * np.pi * (np.arange(LENGTH) / random.uniform(300, 1200, (k.size, 1)) + random.random((k.size, 1)))
        samples = recorded(clean + drift * np.sin(wave), k).astype(np.float32)
        table["rx"] += [row[PAD : PAD + count[j]] for row, j in zip(samples, k)]
        pulse = transfer(tx_frequency, shapes[:, k], table["stretch"][k], tail)
        pulse *= np.exp(-2j * np.pi * tx_frequency * (table["tx_gloc"][k] + PAD - offset[k])[:, None])
        outgoing = 18000.0 * np.fft.irfft(pulse, 512)[:, : 128 + 2 * PAD]
        table["tx"] += list(recorded(outgoing, k)[:, PAD : PAD + 128].astype(np.float32))
    table["energy_dn"] = energy
    table["snr"], table["ground_snr"] = peak / table["noise_sd_dn"], ground_peak / table["noise_sd_dn"]
    return table


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shots", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=(*KINDS, "mixed"), default="mixed", help="mixed: 15 %% bare ground")
    parser.add_argument("--beams", nargs="+", choices=BEAMS, default=["BEAM0001", "BEAM0101", "BEAM1000", "BEAM1011"])
    parser.add_argument("--slope-max", type=float, default=40.0, help="degrees")
    parser.add_argument("--drift", type=float, default=0.0, help="amplitude of a slow drift of the baseline, DN")
    parser.add_argument("--shot-noise", type=float, default=0.0, help="variance of the signal per DN, before smoothing")
    parser.add_argument("--tail", type=float, default=TAIL_SHARE, help="share of the pulse that decays slowly")
    parser.add_argument("--out", type=Path, default=Path("footprints.h5"), help="the truth is written as OUT_truth.npz")
    options = parser.parse_args()
    random = np.random.default_rng(options.seed)
    table = simulate(random, draw(random, options.shots, options.kind, options.beams, options.slope_max),
                     options.drift, options.shot_noise, options.tail)  # fmt: skip
    truth = footprint_file.write(options.out, table, SAMPLE_M, STATED_NOISE)
    truth["kind"] = np.array(KINDS)[truth["kind"]]
    np.savez_compressed(options.out.with_name(options.out.stem + "_truth.npz"), **truth)


if __name__ == "__main__":
    main()
