"""Makes surveys with known misalignment for check_alignment.py.

Geometry of its own: earth-centred coordinates by pyproj, rotations and intersections by numpy. No code of wavex takes
part. A survey is a folder with `survey.json` (what a user knows), `truth.json` (what check_alignment.py compares
with), and binary rows of doubles per strip (crates/wavex-align/examples/align_points.rs names the columns).

Only shots into windows of the ground are made, as if the rest of the survey had been thinned.

usage: make_alignment.py FOLDER [--seed N] [--terrain flat|hills|town] [--plan parallel|cross|corridor] [...]
"""

import argparse
import json
from pathlib import Path

import numpy
from pyproj import Transformer

TO_ECEF = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
TO_GEODETIC = Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
ORIGIN = (15.3, 48.2, 300.0)
MILLIDEGREE = numpy.radians(1e-3)


def rotations(axis, angles):
    """Rotation matrices about axis 0, 1 or 2."""
    sine, cosine = numpy.sin(angles), numpy.cos(angles)
    made = numpy.zeros((*numpy.shape(angles), 3, 3))
    made[..., axis, axis] = 1
    j, k = (axis + 1) % 3, (axis + 2) % 3
    made[..., j, j] = made[..., k, k] = cosine
    made[..., j, k], made[..., k, j] = -sine, sine
    return made


def roll_pitch_yaw(angles):
    """Rz(yaw) Ry(pitch) Rx(roll) of angles in the last axis."""
    angles = numpy.asarray(angles)
    return rotations(2, angles[..., 2]) @ rotations(1, angles[..., 1]) @ rotations(0, angles[..., 0])


def east_north_up(longitude, latitude):
    """Columns east, north, up in the earth-centred frame; angles in radians."""
    sl, cl, sb, cb = numpy.sin(longitude), numpy.cos(longitude), numpy.sin(latitude), numpy.cos(latitude)
    east = numpy.stack([-sl, cl, 0 * sl], -1)
    north = numpy.stack([-sb * cl, -sb * sl, cb], -1)
    up = numpy.stack([cb * cl, cb * sl, sb], -1)
    return numpy.stack([east, north, up], -1)


SCENE = east_north_up(numpy.radians(ORIGIN[0]), numpy.radians(ORIGIN[1]))
SCENE_ORIGIN = numpy.array(TO_ECEF.transform(*ORIGIN))


def ecef_of_scene(points):
    return SCENE_ORIGIN + points @ SCENE.T


class Terrain:
    """Heights over the scene's east and north, m."""

    def __init__(self, kind, random):
        self.kind = kind
        self.waves = []
        if kind != "flat":
            for length in (2300, 1100, 620, 340, 210):
                course = random.uniform(0, numpy.pi)
                height = 0.012 * length * random.uniform(0.6, 1.2)
                k = 2 * numpy.pi / length
                self.waves.append((height, k * numpy.cos(course), k * numpy.sin(course), random.uniform(0, 6.3)))
        self.turns = random.uniform(0, numpy.pi, (512, 512))
        self.shifts = random.uniform(-3, 3, (512, 512, 2))
        self.pitches = random.uniform(0.4, 0.9, (512, 512))

    def ground(self, x, y):
        z = numpy.zeros_like(x)
        for height, kx, ky, phase in self.waves:
            z += height * numpy.sin(kx * x + ky * y + phase)
        return z

    def hits(self, origins, directions, guess):
        """Distances along rays to the surface; NaN where a wall is hit."""
        t = guess
        for _ in range(8):
            at = origins + t[:, None] * directions
            t = t + (at[:, 2] - self.ground(at[:, 0], at[:, 1])) / -directions[:, 2]
        if self.kind != "town":
            return t
        # House of the place 5 m above the ground: gable roof over 10 m by 12 m, eaves 5 m above its centre.
        ground = origins + t[:, None] * directions
        at = ground + 5 / directions[:, 2:] * directions
        cell = numpy.floor(at[:, :2] / 40).astype(int)
        i, j = cell[:, 0] % 512, cell[:, 1] % 512
        centre = cell * 40 + 12 + self.shifts[i, j]
        base = self.ground(centre[:, 0], centre[:, 1])
        turn, slope = self.turns[i, j], numpy.tan(self.pitches[i, j])
        along = numpy.stack([numpy.cos(turn), numpy.sin(turn)], -1)
        across = numpy.stack([-numpy.sin(turn), numpy.cos(turn)], -1)

        def local(points):
            d = points[:, :2] - centre
            return (d * along).sum(-1), (d * across).sum(-1)

        u, v = local(ground)
        best = numpy.where((abs(u) < 6) & (abs(v) < 5), numpy.nan, t)
        roof = numpy.full_like(t, numpy.inf)
        for side in (-1, 1):
            # z = base + 5 + slope (5 - side v)
            _, v0 = local(origins)
            rise = base + 5 + slope * (5 - side * v0) - origins[:, 2]
            dv = (directions[:, :2] * across).sum(-1)
            hit = rise / (directions[:, 2] + slope * side * dv)
            u, v = local(origins + hit[:, None] * directions)
            inside = (abs(u) < 6) & (side * v >= 0) & (side * v < 5) & (hit > 0)
            roof = numpy.where(inside & (hit < roof), hit, roof)
        return numpy.where(numpy.isfinite(roof), roof, best)


class Strip:
    """Motion of the aircraft along a line of the scene: closed formulas of time."""

    def __init__(self, start, course, length, height, speed, start_s, sway, random):
        self.start, self.course, self.height, self.speed = numpy.asarray(start, float), course, height, speed
        self.span_s = (start_s, start_s + length / speed)
        self.sways = [
            [(sway * random.uniform(0.5, 1) * numpy.radians(a), 2 * numpy.pi / (p * random.uniform(0.8, 1.2)), random.uniform(0, 6.3))
             for a, p in ((1.2, 11), (0.4, 3.1))]
            for _ in range(3)
        ]
        self.crab = random.normal(0, numpy.radians(1.5))

    def position(self, t):
        along = self.speed * (t - self.span_s[0])
        x = self.start[0] + numpy.sin(self.course) * along
        y = self.start[1] + numpy.cos(self.course) * along
        return numpy.stack([x, y, self.height + 2 * numpy.sin(t / 9)], -1)

    def attitude(self, t):
        mean = (0, numpy.radians(1.5), self.course + self.crab)
        return numpy.stack(
            [m + sum(a * numpy.sin(w * t + p) for a, w, p in sways) for m, sways in zip(mean, self.sways)], -1
        )


class Errors:
    """Errors of a strip's trajectory: a constant and a wave of random phase, per component, and disturbances."""

    def __init__(self, constant_sds, wave_sds, period_s, random, disturbance):
        self.constants = random.normal(0, constant_sds)
        self.sines, self.cosines = random.normal(0, wave_sds), random.normal(0, wave_sds)
        self.w = 2 * numpy.pi / (period_s * random.uniform(0.8, 1.25, len(constant_sds)))
        self.disturbance = disturbance

    def at(self, t):
        t = numpy.asarray(t)[..., None]
        waves = self.sines * numpy.sin(self.w * t) + self.cosines * numpy.cos(self.w * t)
        return self.constants + waves + self.disturbance.at(t)


class Disturbance:
    """Errors that the stated SDs of the trajectories do not contain, from numbers of their own."""

    STEP_S = 0.5

    def __init__(self, options, span_s, random):
        count = int((span_s[1] - span_s[0] + 10) / self.STEP_S) + 2
        self.times_s = span_s[0] - 5 + self.STEP_S * numpy.arange(count)
        steps = random.normal(0, options.walk_m * numpy.sqrt(self.STEP_S / 60), (count, 3))
        self.walk_m = numpy.cumsum(steps, 0)
        self.walk_m -= self.walk_m.mean(0)
        self.jump_m = random.normal(0, options.jump_m, 3)
        self.middle_s = numpy.mean(span_s)
        self.drifts = random.normal(0, options.imu_drift_mdeg * numpy.array([1, 1, 3]) * MILLIDEGREE / 60)
        self.phase = random.uniform(0, 2 * numpy.pi)
        self.amplitude, self.period_s = options.oscillation[0] * MILLIDEGREE, options.oscillation[1]

    def at(self, t):
        found = numpy.zeros((*t.shape[:-1], 6))
        for axis in range(3):
            found[..., axis] = self.jump_m[axis] + numpy.interp(t[..., 0], self.times_s, self.walk_m[:, axis])
        found[..., 3:] = self.drifts * (t - self.middle_s)
        found[..., 5] += self.amplitude * numpy.sin(2 * numpy.pi * t[..., 0] / self.period_s + self.phase)
        return found


def frames(positions, attitudes):
    """Earth-centred positions and rotations from the body of geodetic places (rad, rad, m) and attitudes."""
    longitude, latitude, height = positions
    origin = numpy.stack(TO_ECEF.transform(numpy.degrees(longitude), numpy.degrees(latitude), height), -1)
    enu = east_north_up(longitude, latitude)
    ned = numpy.stack([enu[..., 1], enu[..., 0], -enu[..., 2]], -1)
    return origin, ned, ned @ roll_pitch_yaw(attitudes)


def geodetic(scene_points):
    longitude, latitude, height = TO_GEODETIC.transform(*ecef_of_scene(scene_points).T)
    return numpy.radians(longitude), numpy.radians(latitude), height


def locate(calibration, mount, origin, ecef_from_body, directions, ranges):
    """Ends of beams; raw ranges, low-power corrections left out."""
    body_from_scanner = mount @ roll_pitch_yaw(numpy.radians(calibration["boresight_deg"]))
    ranges = (1 + calibration.get("e1", 0)) * ranges + calibration["e0"]
    body = numpy.asarray(calibration["lever_arm_m"]) + ranges[:, None] * (directions @ body_from_scanner.T)
    return origin + (ecef_from_body @ body[..., None])[..., 0]


def plan_of(kind, height, length, spacing, random):
    """Start, course, length of each strip."""
    def line(offset, course, length, along=0):
        ahead, right = numpy.array([numpy.sin(course), numpy.cos(course)]), numpy.array([numpy.cos(course), -numpy.sin(course)])
        return right * offset - ahead * (length / 2 - along), course, length

    course = random.uniform(0, 2 * numpy.pi)
    opposite = course + numpy.pi
    if kind == "corridor":
        # The middle line back and forth, and a strip on each side.
        offsets = 0.5 * spacing * numpy.array([0, 0, -1, 1])
    else:
        offsets = (numpy.arange(4) - 1.5) * spacing
    lines = []
    for k, offset in enumerate(offsets):
        lines.append(line(offset if k % 2 == 0 else -offset, course if k % 2 == 0 else opposite, length))
    if kind == "cross":
        lines.append(line(0, course + numpy.pi / 2, 3 * spacing + 1.1 * height))
    return lines


MOUNTS_DEG = [[0.0, 0.0, 0.0], [0.0, 0.0, 180.0], [0.0, 8.0, 0.0]]


class Day:
    """An installation: its mount, true calibration, start values, and their SDs."""

    def __init__(self, options, mount_deg, random):
        self.mount_deg, self.mount = mount_deg, roll_pitch_yaw(numpy.radians(mount_deg))
        scale = options.misalignment
        self.nominal = nominal = {"lever_arm_m": [0.3, -0.2, 0.8], "boresight_deg": [0.0, 0.0, 0.0], "e0": 0.0}
        lever_sd, e0_sd, time_sd = 0.02, 0.03, 1e-3
        self.truth = truth = {
            "lever_arm_m": (nominal["lever_arm_m"] + scale * random.normal(0, lever_sd, 3)).tolist(),
            "boresight_deg": (scale * random.normal(0, [0.1, 0.1, 0.2])).tolist(),
            "e0": scale * random.normal(0, e0_sd),
            "time_offset_s": scale * random.normal(0, time_sd),
        }
        if options.boresight_deg:
            truth["boresight_deg"] = options.boresight_deg
        if options.shift_m:
            nominal["lever_arm_m"] = (numpy.array(truth["lever_arm_m"]) + options.shift_m).tolist()
        degrees = [0.3, 0.3, 0.6] if not options.boresight_deg else [1.0, 1.0, 3.0]
        lever_sds = [lever_sd] * 3 if not options.shift_m else [2.0] * 3
        self.prior_sds = [*lever_sds, *numpy.radians(degrees), e0_sd, 0, 0, 0, 0, 0, 0, time_sd]
        if options.aligned:
            # A survey that was aligned before: start values have the SDs of an alignment.
            self.prior_sds = [0.02, 0.02, 0.02, *numpy.radians(degrees), e0_sd, 0, 0, 0, 0, 0, 0, time_sd]
            nominal |= {key: truth[key] for key in ("lever_arm_m", "boresight_deg", "e0")}
            truth["time_offset_s"] = 0.0


def make(folder, options):
    random = numpy.random.default_rng(options.seed)
    folder.mkdir(parents=True, exist_ok=True)
    terrain = Terrain(options.terrain, random)
    # Numbers of their own: surveys without disturbances are those of the same seed with them.
    of_disturbances, of_days = (numpy.random.default_rng([options.seed, k]) for k in (1, 2))
    days = [Day(options, MOUNTS_DEG[day], random if day == 0 else of_days) for day in range(options.days)]
    constant_sds = options.trajectory * numpy.array([0.012, 0.012, 0.012, *(numpy.array([0.4, 0.4, 1.2]) * MILLIDEGREE)])
    wave_sds = options.trajectory * numpy.array([0.010, 0.010, 0.010, *(numpy.array([0.3, 0.3, 0.9]) * MILLIDEGREE)])
    total_sds = numpy.hypot(constant_sds, wave_sds)
    strips, truths, control = [], [], []
    start_s = 100000.0
    heights = terrain.ground(*numpy.meshgrid(numpy.arange(-3200, 3200, 10.0), numpy.arange(-3200, 3200, 10.0), indexing="ij"))
    lines_flown = plan_of(options.plan, options.height, options.length, options.spacing, random)
    for index, (start, course, length) in enumerate(lines_flown):
        installation = index * options.days // len(lines_flown)
        day = days[installation]
        mount, truth = day.mount, day.truth
        strip = Strip(start, course, length, options.height, options.speed, start_s, options.sway, random)
        disturbance = Disturbance(options, strip.span_s, of_disturbances)
        errors = Errors(constant_sds, wave_sds, 120.0, random, disturbance)
        start_s = strip.span_s[1] + 200
        # Trajectory as recorded.
        t = numpy.arange(strip.span_s[0] - 2, strip.span_s[1] + 2, 0.01)
        attitudes, error = strip.attitude(t), errors.at(t)
        origin, ned, _ = frames(geodetic(strip.position(t)), attitudes)
        recorded = TO_GEODETIC.transform(*(origin + (ned @ error[:, :3, None])[..., 0]).T)
        rows = numpy.column_stack(
            [t, numpy.radians(recorded[1]), numpy.radians(recorded[0]), recorded[2], attitudes + error[:, 3:]]
        )
        rows.astype("<f8").tofile(folder / f"trajectory{index}.bin")
        # Shots: all lines, then those into windows.
        step = 1 / numpy.sqrt(options.density)
        lines = numpy.arange(strip.span_s[0], strip.span_s[1], step / options.speed)
        angles = numpy.arange(-options.angle, options.angle, step / options.height)
        line_of, angle_of = [], []
        calibration = truth
        boresight = roll_pitch_yaw(numpy.radians(truth["boresight_deg"]))
        _, _, ecef_from_body = frames(geodetic(strip.position(lines)), strip.attitude(lines))
        scene_from_scanner = SCENE.T @ ecef_from_body @ mount @ boresight
        origins = strip.position(lines)
        for first in range(0, len(lines), 500):
            part = slice(first, first + 500)
            turn = scene_from_scanner[part].astype("f4")
            sine, cosine = numpy.sin(angles).astype("f4"), numpy.cos(angles).astype("f4")
            d = [turn[:, k, 1, None] * sine + turn[:, k, 2, None] * cosine for k in range(3)]
            far = -origins[part, 2, None].astype("f4") / d[2]
            for _ in range(2):
                x, y = (origins[part, k, None].astype("f4") + far * d[k] for k in range(2))
                i = numpy.clip(((x + 3200) / 10).astype(int), 0, 639)
                j = numpy.clip(((y + 3200) / 10).astype(int), 0, 639)
                far = (heights[i, j].astype("f4") - origins[part, 2, None].astype("f4")) / d[2]
            x, y = (origins[part, k, None].astype("f4") + far * d[k] for k in range(2))
            margin = 5
            is_near = ((x + margin) % options.pitch < options.window + 2 * margin) & ((y + margin) % options.pitch < options.window + 2 * margin)
            found = numpy.nonzero(is_near)
            line_of.append(found[0] + first)
            angle_of.append(found[1])
        line_of, angle_of = numpy.concatenate(line_of), numpy.concatenate(angle_of)
        shots = len(line_of)
        t = lines[line_of] + angles[angle_of] / (2 * options.angle) * step / options.speed * 0.9
        order = numpy.argsort(t, kind="stable")
        t, angle = t[order], angles[angle_of[order]]
        noise = random.normal(0, 0.2 * MILLIDEGREE, (shots, 2))
        directions = numpy.stack([0 * angle, numpy.sin(angle), numpy.cos(angle)], -1)
        recorded_angle = angle + noise[:, 0]
        recorded_directions = numpy.stack([noise[:, 1], numpy.sin(recorded_angle), numpy.cos(recorded_angle)], -1)
        recorded_directions /= numpy.linalg.norm(recorded_directions, axis=-1, keepdims=True)
        origin, _, ecef_from_body = frames(geodetic(strip.position(t)), strip.attitude(t))
        zero = locate(calibration | {"e0": 0}, mount, origin, ecef_from_body, directions, numpy.zeros(shots))
        one = locate(calibration | {"e0": 0}, mount, origin, ecef_from_body, directions, numpy.ones(shots))
        rays = (one - zero) @ SCENE
        starts = (zero - SCENE_ORIGIN) @ SCENE
        far = terrain.hits(starts, rays, -starts[:, 2] / rays[:, 2])
        at = starts + far[:, None] * rays
        keep = numpy.isfinite(far) & (at[:, 0] % options.pitch < options.window) & (at[:, 1] % options.pitch < options.window)
        keep &= numpy.isfinite(at).all(-1)
        at = numpy.where(keep[:, None], at, 0)
        # Trees in a tenth of the windows: several returns, rough; and cars, which only one strip sees.
        cell = numpy.floor(at[:, :2] / options.pitch).astype(numpy.int64)
        is_tree = (cell[:, 0] * 7 + cell[:, 1] * 13) % 10 == 0
        far = far - numpy.where(is_tree, random.uniform(0, 9, shots), 0)
        car = numpy.floor(at[:, :2] / 6).astype(numpy.int64)
        far = far - 1.4 * (((car[:, 0] * 31 + car[:, 1] * 17 + 5 * index) % 97) == 0)
        n_returns = numpy.where(is_tree & (random.uniform(size=shots) < 0.6), 2, 1)
        sd = 0.012
        raw = (far - truth["e0"] + random.normal(0, sd, shots)) / (1 + truth.get("e1", 0))
        columns = [t - truth["time_offset_s"], recorded_directions, raw, numpy.full(shots, sd), n_returns, numpy.zeros(shots)]
        numpy.column_stack(columns)[keep].astype("<f8").tofile(folder / f"points{index}.bin")
        strips.append({"points": f"points{index}.bin", "trajectory": f"trajectory{index}.bin", "installation": installation})
        # Truth for a few beams, and the corrections over time.
        sample = random.choice(numpy.nonzero(keep & ~is_tree)[0], 300, replace=False)
        exact = ecef_of_scene(starts[sample] + (far[sample, None]) * rays[sample])
        times = numpy.linspace(*strip.span_s, 41)
        truths.append({
            "sample_time_s": (t[sample] - truth["time_offset_s"]).tolist(),
            "sample_directions": directions[sample].tolist(),
            "sample_raw_m": ((far[sample] - truth["e0"]) / (1 + truth.get("e1", 0))).tolist(),
            "sample_ecef_m": exact.tolist(),
            "times_s": times.tolist(),
            "corrections": (-errors.at(times)).tolist(),
        })
    # Control points on the ground, in windows; some are wrong.
    random_control = numpy.random.default_rng(options.seed + 10 ** 6)
    wrong = []
    while len(control) < options.control:
        # Near the centre, where all strips are; not under trees and cars, and off houses.
        at = random_control.uniform(-0.3 * options.length, 0.3 * options.length, 2)
        cell = numpy.floor(at / options.pitch).astype(numpy.int64)
        at = cell * options.pitch + random_control.uniform(2, options.window - 2, 2)
        car = numpy.floor(at / 6).astype(numpy.int64)
        is_car = any((car[0] * 31 + car[1] * 17 + 5 * k) % 97 == 0 for k in range(len(strips)))
        house = numpy.floor(at / 40).astype(int)
        i, j = house % 512
        is_house = options.terrain == "town" and numpy.linalg.norm(at - house * 40 - 12 - terrain.shifts[i, j]) < 11
        if (cell[0] * 7 + cell[1] * 13) % 10 == 0 or is_car or is_house:
            continue
        sds = [0.02, 0.02, options.control_sd]
        place = numpy.array([*at, terrain.ground(*at[:, None])[0]])
        error = random_control.normal(0, sds)
        is_wrong = len(control) < options.wrong_control
        wrong.append(is_wrong)
        place = ecef_of_scene(place + error + [0, 0, 1.0 * is_wrong])
        control.append({"ecef_m": place.tolist(), "sd_m": sds})
    trajectory_sds = numpy.maximum(total_sds, 1e-9) * numpy.repeat(options.sd_factors, 3)
    survey = {
        "control": control, "fits_trajectory_sds": not options.given_sds,
        "installations": [
            {"calibration": day.nominal, "mount_deg": day.mount_deg, "prior_sds": list(map(float, day.prior_sds))} for day in days
        ],
        "trajectory_sds": trajectory_sds.tolist(), "correlation_s": [60.0, 60.0], "model": options.model,
        "knots_s": options.knots, "cell_m": options.cell, "most_pairs": options.pairs, "strips": strips,
    }
    (folder / "survey.json").write_text(json.dumps(survey, indent=1))
    (folder / "truth.json").write_text(json.dumps({"calibrations": [day.truth for day in days], "strips": truths, "wrong_control": wrong}))


def parser():
    made = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    made.add_argument("folder", type=Path)
    add_options(made)
    return made


def add_options(made):
    made.add_argument("--seed", type=int, default=1)
    made.add_argument("--terrain", choices=["flat", "hills", "town"], default="town")
    made.add_argument("--plan", choices=["parallel", "cross", "corridor"], default="cross")
    made.add_argument("--height", type=float, default=1000)
    made.add_argument("--length", type=float, default=3000)
    made.add_argument("--spacing", type=float, default=550)
    made.add_argument("--speed", type=float, default=60)
    made.add_argument("--angle", type=float, default=0.5, help="largest scan angle, rad")
    made.add_argument("--density", type=float, default=3, help="shots per square metre")
    made.add_argument("--window", type=float, default=24, help="edge of the windows of the ground, m")
    made.add_argument("--pitch", type=float, default=80, help="distance of the windows, m")
    made.add_argument("--misalignment", type=float, default=1, help="factor of calibration errors")
    made.add_argument("--trajectory", type=float, default=1, help="factor of trajectory errors")
    made.add_argument("--sway", type=float, default=1, help="factor of the sways of the aircraft")
    made.add_argument("--boresight-deg", type=float, nargs=3)
    made.add_argument("--shift-m", type=float, nargs=3, help="error of the given lever arm")
    made.add_argument("--aligned", action="store_true", help="give the true calibration as start values")
    made.add_argument("--model", choices=["none", "constant", "linear", "spline"], default="spline")
    made.add_argument("--knots", type=float, default=10)
    made.add_argument("--cell", type=float, default=3)
    made.add_argument("--pairs", type=int, default=3000)
    made.add_argument("--sd-factors", type=float, nargs=2, default=[1, 1], help="errors of the stated SDs of positions and attitudes")
    made.add_argument("--days", type=int, choices=[1, 2, 3], default=1, help="number of installations with mounts of their own")
    made.add_argument("--walk-m", type=float, default=0, help="SD of a random walk of the position after 60 s, m")
    made.add_argument("--imu-drift-mdeg", type=float, default=0, help="SD of the drift of roll and pitch in 60 s; three times of heading")
    made.add_argument("--oscillation", type=float, nargs=2, default=[0, 20], metavar=("MDEG", "S"),
                      help="amplitude and period of an oscillation of the heading")
    made.add_argument("--jump-m", type=float, default=0, help="SD of jumps of the position from strip to strip, m")
    made.add_argument("--given-sds", action="store_true", help="use the stated SDs of trajectories as they are")
    made.add_argument("--control", type=int, default=0, help="number of control points")
    made.add_argument("--control-sd", type=float, default=0.01, help="SD of their heights, m")
    made.add_argument("--wrong-control", type=int, default=0, help="number of control points that are 1 m too high")


if __name__ == "__main__":
    options = parser().parse_args()
    make(options.folder, options)
