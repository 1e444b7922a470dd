"""Land with solids, woods and wires, scanned by beams: points with truth. Shares no code with wavex.

A scanner at 800 m flies over a land. Beams are followed in steps: solids end them, leaves and wires take returns from
them and end some of them. `with_noise` adds noise below and above. `check_noise.py` and `check_ground.py` use it.
"""

import numpy as np

ORIGIN = np.array([412000.0, 5806000.0, 0.0])
FLYING_M = 800.0
STEP_M = 0.5
# Beams are followed from the highest point of nine blocks of this edge.
BLOCK_M = 40.0
KINDS = ["", "ground", "building", "chimney", "mast", "bridge", "leaves", "wire"]
GROUND = 1
# Kinds of noise, from 100.
NOISE = ["low single", "high single", "multipath", "low cluster", "bird", "cloud", "zone, single", "zone, block"]
NAMES = dict([*enumerate(KINDS), *enumerate(NOISE, 100)])


class Land:
    """Hills with terraces, a cliff of 45 m, a shaft, a valley with a bridge, houses, a tower, and a wood with understory."""

    size_m = (340.0, 240.0)
    chimneys = [(60, 60, 2.5, 70), (95, 40, 1.2, 45), (150, 75, 0.8, 30)]
    masts = [(180, 30, 0.25, 55), (30, 140, 0.15, 25)]
    # West, south, width, depth, height.
    houses = [(20, 20, 12, 9, 8), (45, 20, 14, 10, 11), (20, 90, 10, 16, 7), (120, 20, 18, 18, 100), (80, 90, 30, 12, 22)]
    # Middle from west, south and north end, half width, height of the deck above the bank.
    bridge = (100.0, 184.0, 216.0, 5.0, 2.0)
    # Offset from `wires_m` and height.
    wires = [(offset, height) for offset in (-6.0, 0.0, 6.0) for height in (26.0, 30.0)]
    wires_m = 230.0

    def ground_m(self, x, y):
        z = 60 + 3 * np.sin(x / 41) * np.cos(y / 29) + 0.05 * x
        terraces = (x > 200) & (x < 260)
        z = np.where(terraces, z + 2.5 * np.floor((x - 200) / 12), z)
        z = np.where(x >= 260, z + 12.5 + 45, z)
        shaft = (abs(x - 165) < 4) & (abs(y - 130) < 4)
        valley = (abs(y - 200) < 15) & (x < 190)
        return np.where(shaft, z - 25, np.where(valley, z - 18 * np.cos((y - 200) / 15 * np.pi / 2), z))

    def leaves(self, x, y, above):
        """Probability of a leaf in a step, and of the pulse to go on after it."""
        of_plot = (x > 90) & (x < 200) & (y > 110) & (y < 180) & ~((abs(x - 165) < 9) & (abs(y - 130) < 9))
        chance = np.where((above > 9) & (above < 24), 0.03, np.where((above > 0.4) & (above < 3), 0.3, 0.0))
        return np.where(of_plot | (x > 270) & (y > 60), chance, 0.0), 0.6

    def wire_height_m(self, y, height):
        return 75 + height + 8 * ((y % 120 - 60) / 60) ** 2

    def solid(self, x, y, z):
        """Kind of the solid at places: 0 none, 1 ground, 2 building, 3 chimney, 4 mast, 5 bridge."""
        ground = self.ground_m(x, y)
        kind = np.where(z <= ground, 1, 0)
        for (west, south, width, depth, _), top in zip(self.houses, self.roofs_m):
            kind[(x > west) & (x < west + width) & (y > south) & (y < south + depth) & (z <= top)] = 2
        for (east, north, radius, height), number in self.posts:
            top = self.ground_m(east, north) + height
            kind[((x - east) ** 2 + (y - north) ** 2 < radius**2) & (z <= top) & (z > ground)] = number
        east, south, north, half, _ = self.bridge
        kind[(abs(x - east) < half) & (y > south) & (y < north) & (abs(z - self.deck_m + 0.5) < 0.6)] = 5
        return kind

    def __init__(self, size_m=None):
        self.size_m = size_m or self.size_m
        self.posts = [(post, 3) for post in self.chimneys] + [(post, 4) for post in self.masts]
        self.roofs_m = [self.ground_m(w + a / 2, s + b / 2) + h for w, s, a, b, h in self.houses]
        self.deck_m = self.ground_m(self.bridge[0], self.bridge[1] - 1) + self.bridge[4]
        x, y = np.meshgrid(np.arange(-60.0, self.size_m[0] + 60, 1.0), np.arange(-60.0, self.size_m[1] + 60, 1.0))
        ground = self.ground_m(x, y)
        self.lowest_m = ground.min()
        # Crowns are at most 24 m high.
        top = np.where(self.leaves(x, y, 15.0)[0] > 0, ground + 24, ground + 4)
        for (west, south, width, depth, _), roof in zip(self.houses, self.roofs_m):
            top[(x > west - 1) & (x < west + width + 1) & (y > south - 1) & (y < south + depth + 1)] = roof + 1
        for (east, north, radius, height), _ in self.posts:
            top[np.hypot(x - east, y - north) < radius + 2] = self.ground_m(east, north) + height + 1
        top[abs(x - self.bridge[0]) < self.bridge[3] + 1] += self.bridge[4] + 20
        for offset, height in self.wires:
            top[abs(x - self.wires_m - offset) < 2] = 75 + height + 9
        block = int(BLOCK_M)
        high, wide = (side // block + 1 for side in top.shape)
        padded = np.full((high * block, wide * block), -np.inf)
        padded[: top.shape[0], : top.shape[1]] = top
        tops = padded.reshape(high, block, wide, block).max(axis=(1, 3))
        tops = np.pad(tops, 1, constant_values=-np.inf)
        self.tops = np.max([tops[i : i + high, j : j + wide] for i in range(3) for j in range(3)], axis=0)

    def top_near_m(self, x, y):
        """Height that nothing exceeds within 40 m."""
        row, column = ((value + 60) // BLOCK_M for value in (y, x))
        return self.tops[np.clip(row, 0, self.tops.shape[0] - 1).astype(int), np.clip(column, 0, self.tops.shape[1] - 1).astype(int)]


def fly(random, land, density):
    """Shots and returns: origins, directions, and rows (shot, range, kind)."""
    size_m = land.size_m
    per_line, lines = int(size_m[0] * np.sqrt(density)), int(size_m[1] * np.sqrt(density))
    middle = size_m[0] / 2
    across = (np.arange(per_line) + 0.5) / per_line * size_m[0]
    shot = np.arange(per_line * lines)
    y0 = (shot // per_line + random.uniform(-0.1, 0.1, len(shot))) / lines * size_m[1]
    target = across[shot % per_line] + random.uniform(-0.1, 0.1, len(shot))
    origin = np.c_[np.full(len(shot), middle), y0, np.full(len(shot), 60 + FLYING_M)]
    direction = np.c_[target - middle, 0.05 * FLYING_M * np.ones(len(shot)), -FLYING_M * np.ones(len(shot))]
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    rows = []
    for part in np.array_split(shot, max(1, len(shot) // 40000)):
        rows.append(trace(random, land, part, origin[part], direction[part]))
    return origin, direction, np.concatenate(rows)


def trace(random, land, shot, origin, direction):
    # From where the beam is at 60 m, it is within 40 m at all heights of a land.
    level = origin + ((origin[:, 2] - 60) / -direction[:, 2])[:, None] * direction
    reach = (origin[:, 2] - land.top_near_m(level[:, 0], level[:, 1])) / -direction[:, 2]
    alive, left = np.ones(len(shot), bool), np.full(len(shot), 4)
    last = np.full(len(shot), -np.inf)
    found = []
    for step in range(2000):
        at = reach + step * STEP_M
        index = np.flatnonzero(alive)
        if len(index) == 0:
            break
        x, y, z = (origin[index] + at[index, None] * direction[index]).T
        hit = land.solid(x, y, z)
        index_hit = index[hit > 0]
        if len(index_hit):
            low, high = at[index_hit] - STEP_M, at[index_hit].copy()
            for _ in range(8):
                half = 0.5 * (low + high)
                inside = land.solid(*(origin[index_hit] + half[:, None] * direction[index_hit]).T) > 0
                low, high = np.where(inside, low, half), np.where(inside, half, high)
            found.append(np.c_[shot[index_hit], high + 0.02 * random.normal(size=len(high)), hit[hit > 0]])
            alive[index_hit] = False
        chance, goes_on = land.leaves(x, y, z - land.ground_m(x, y))
        goes_on = np.broadcast_to(goes_on, x.shape)
        leaf = (hit == 0) & (random.uniform(size=len(x)) < chance)
        wire = np.zeros(len(x), bool)
        for offset, height in land.wires:
            top = land.wire_height_m(y, height)
            # The footprint is 0.4 m wide, and the wire crosses it somewhere within a step.
            wire |= (abs(x - land.wires_m - offset) < 0.2) & (z <= top) & (z - top > STEP_M * direction[index, 2])
        for is_hit, kind in [(leaf, 6), (wire & ~leaf, 7)]:
            chosen = index[is_hit]
            usable = (left[chosen] > 1) & (at[chosen] - last[chosen] > 1.2)
            chosen, share = chosen[usable], goes_on[is_hit][usable]
            if len(chosen):
                found.append(np.c_[shot[chosen], at[chosen], np.full(len(chosen), kind)])
                left[chosen] -= 1
                last[chosen] = at[chosen]
                # Some pulses are used up.
                alive[chosen] = random.uniform(size=len(chosen)) < share
    return np.concatenate(found) if found else np.empty((0, 3))


def with_noise(random, origin, direction, rows):
    """Rows (shot, range, kind) with noise of kinds from 100."""
    n = len(origin)
    ground_range = (origin[:, 2] - 60) / -direction[:, 2]
    rows = rows.copy()
    extra = []

    def add(shot, reach, kind):
        extra.append(np.c_[shot, reach, np.full(len(shot), 100 + kind)])

    def some(rate):
        return random.choice(n, max(1, int(rate * n)), replace=False)

    order = np.lexsort((rows[:, 1], rows[:, 0]))
    rows = rows[order]
    is_last = np.r_[rows[1:, 0] != rows[:-1, 0], True]
    last = np.full(n, np.nan)
    last[rows[is_last, 0].astype(int)] = rows[is_last, 1]
    is_ground = np.zeros(n, bool)
    is_ground[rows[is_last, 0].astype(int)] = rows[is_last, 2] == 1
    # Heights of noise are those above the last return.
    ground_range = np.where(np.isnan(last), ground_range, last)
    shot = some(0.004)
    add(shot, ground_range[shot] + random.uniform(20, 560, len(shot)), 0)
    shot = some(0.004)
    add(shot, ground_range[shot] - random.uniform(5, 700, len(shot)), 1)
    shot = some(0.0005)
    shot = shot[is_ground[shot]]
    add(shot, last[shot] + random.uniform(1.5, 12, len(shot)), 2)
    places = origin + ground_range[:, None] * direction
    for _ in range(max(2, n // 60000)):
        middle, depth = places[random.integers(n)], random.uniform(4, 45)
        shot = np.flatnonzero(np.hypot(*(places - middle)[:, :2].T) < random.uniform(1, 3))
        shot = shot[is_ground[shot] & (random.uniform(size=len(shot)) < 0.7)]
        add(shot, last[shot] + depth + random.uniform(0, 1.5, len(shot)), 3)
    for _ in range(max(10, n // 8000)):
        height = random.uniform(30, 200)
        reach = ground_range - height
        at = origin + reach[:, None] * direction
        shot = np.flatnonzero(np.hypot(*(at - at[random.integers(n)])[:, :2].T) < random.uniform(0.3, 0.8))[:5]
        reach = reach[shot] + random.uniform(-0.2, 0.2, len(shot))
        add(shot, reach, 4)
        rows = rows[~np.isin(rows[:, 0], shot[random.uniform(size=len(shot)) < 0.3])]
    for _ in range(max(1, n // 150000)):
        height, radius = random.uniform(230, 600), random.uniform(15, 40)
        reach = ground_range - height
        at = origin + reach[:, None] * direction
        shot = np.flatnonzero(np.hypot(*(at - at[random.integers(n)])[:, :2].T) < radius)
        shot = shot[random.uniform(size=len(shot)) < 0.5]
        add(shot, reach[shot] - random.uniform(0, 20, len(shot)), 5)
        rows = rows[~np.isin(rows[:, 0], shot[random.uniform(size=len(shot)) < 0.6])]
    # Ambiguity intervals of pulse rates of 400 to 100 kHz; whole shots are displaced.
    wrong = [(some(0.001), 6)]
    for _ in range(max(3, n // 30000)):
        first = random.integers(n)
        block = np.arange(first, min(first + random.integers(20, 1500), n))
        wrong.append((block[random.uniform(size=len(block)) < random.uniform(0.2, 1)], 7))
    for shot, kind in wrong:
        shift = random.uniform(375, 1500) * random.choice([-1, 1])
        moved = np.isin(rows[:, 0], shot) & (rows[:, 2] < 100)
        rows[moved, 1] += shift
        rows[moved, 2] = 100 + kind
    rows = np.concatenate([rows] + extra)
    rows = rows[rows[:, 1] > 1]
    return rows[np.lexsort((rows[:, 1], rows[:, 0]))]


def cloud(seed, land, density):
    """Rows of 9 doubles (position, beam, number of the return, number of returns, strip), and the kinds."""
    random = np.random.default_rng(seed)
    origin, direction, rows = fly(random, land, density)
    rows = with_noise(random, origin, direction, rows)
    shot = rows[:, 0].astype(int)
    places = ORIGIN + origin[shot] + rows[:, 1, None] * direction[shot]
    counts = np.bincount(shot, minlength=len(origin))
    starts = np.r_[0, np.cumsum(counts)[:-1]]
    number = np.arange(len(shot)) - starts[shot] + 1
    table = np.c_[places, direction[shot], number, counts[shot], np.zeros(len(shot))]
    # The order of points has no meaning.
    order = random.permutation(len(table))
    return table[order], rows[order, 2].astype(int)
