"""Ranges of a tracer on a table, and points of a tracker and a mirror, some of one place wrong.

Plain geometry: nothing of the solvers or of the simulation is used. Disturbed and sound lengths
have the same noise, so that what the disturbance causes is the difference of two results.
"""

from dataclasses import dataclass

import numpy as np

STATIONS, TARGETS = 11, 20
NOISE, TARGET_STD = 0.2e-6, 1e-6
PATTERNS = ("sector", "random", "half")
ARCSEC = np.pi / 180 / 3600


@dataclass(frozen=True)
class World:
    angles: np.ndarray  # (m,) commanded, rad
    truth: np.ndarray  # (m,) deviations from the first, rad
    targets: np.ndarray  # (n, 3) as the machine has them, m
    sound: np.ndarray  # (m, n) lengths, m
    error: np.ndarray  # (m, n) of the disturbance, m

    @property
    def disturbed(self):
        return self.sound + self.error


def around(n, rng):
    """Targets round the table, low and high."""
    angle = 2 * np.pi * (np.arange(n) + rng.uniform(-0.3, 0.3, n)) / n
    radius, height = rng.uniform(0.35, 0.6, n), rng.uniform(0.1, 0.7, n)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def above(n, rng):
    """Targets in a block above the table, as a measuring machine reaches them."""
    return rng.uniform([-0.3, -0.3, 0.4], [0.3, 0.3, 0.9], (n, 3))


def chosen(pattern, count, directions, rng):
    """Which beams (n,) are disturbed; `directions` (n, 3) from the station to the targets."""
    n = len(directions)
    if pattern == "random":
        return np.isin(np.arange(n), rng.permutation(n)[:count])
    if pattern == "half":
        return np.arange(n) % 2 == 0
    if pattern == "first":
        return np.arange(n) < count
    away = np.angle(np.exp(1j * np.arctan2(directions[:, 1], directions[:, 0]))
                    * np.exp(-1j * rng.uniform(-np.pi, np.pi)))  # fmt: skip
    return np.argsort(np.argsort(np.abs(away))) < count


def world(seed, pattern="sector", size=0.0, *, count=None, spread=0.0, n=TARGETS, one_zero=False,
          layout=around, noise=NOISE, target_std=TARGET_STD):  # fmt: skip
    """`size`: m, by how much `count` beams of one station are too long, more or less `spread`."""
    rng = np.random.default_rng([seed, n])
    m = STATIONS
    angles = np.radians(-150.0 + 30.0 * np.arange(m))
    deviation = 4 * ARCSEC * np.sin(angles + rng.uniform(0, 6)) + ARCSEC * np.cos(3 * angles)
    actual = angles + deviation
    stations = np.column_stack([0.1 * np.cos(actual), 0.1 * np.sin(actual), 0.15 + 0 * actual])
    targets = layout(n, rng)
    there = targets + rng.normal(scale=target_std, size=targets.shape)
    ranges = np.linalg.norm(stations[:, None] - there, axis=2)
    zeros = np.full((m, 1), 0.3) if one_zero else rng.uniform(0.2, 0.4, (m, 1))
    sound = ranges - zeros + rng.normal(scale=noise, size=ranges.shape)
    at = int(rng.integers(m))
    beams = chosen(pattern, count or 2 * n // 5, (targets - stations[at]), rng)
    error = np.zeros_like(sound)
    error[at, beams] = size * rng.uniform(1 - spread, 1 + spread, int(beams.sum()))
    return World(angles, deviation - deviation[0], targets, sound, error)


DIRECT, MIRRORED, NEST = 1, 2, 3
MIRROR_STATIONS = [range(first, min(first + 4, 17)) for first in range(0, 16, 3)]


@dataclass(frozen=True)
class MirrorWorld:
    """Points of a tracker round a table that carries a mirror, each in its station's frame."""

    angles: np.ndarray  # (N,) commanded, rad
    truth: np.ndarray  # (N,) deviations from the first, rad
    rows: np.ndarray  # (n, 4) position, station, kind, nest
    sound: np.ndarray  # (n, 3) m
    error: np.ndarray  # (n, 3) of the disturbance, m

    @property
    def disturbed(self):
        return self.sound + self.error


def beam_frame(points):
    """Unit vectors (n, 3, 3) along the beams to points (n, 3), level across them, and upwards."""
    along = points / np.linalg.norm(points, axis=1)[:, None]
    level = np.cross([0.0, 0.0, 1.0], along)
    level /= np.linalg.norm(level, axis=1)[:, None]
    return np.stack([along, level, np.cross(along, level)], axis=1)


def tracker_std(points):
    """Standard deviations (n, 3) along the beam and twice across it, m: what makers call usual."""
    r = np.linalg.norm(points, axis=1)
    across = 3.75e-6 + 1.5e-6 * r
    return np.column_stack([2.5e-6 + 0.25e-6 * r, across, across])


def mirror_and_glass(turned, leaning):
    """The mirror's normal, and where its glass stands, on a table that is turned by so much."""
    around = np.array([np.cos(turned), np.sin(turned)])
    return np.append(np.cos(leaning) * around, np.sin(leaning)), np.append(0.05 * around, 0.15)


def nests_around(count):
    """Places (count, 3), m, of nests: of different heights and distances, as nests should be."""
    k = np.arange(count)
    reach, turn = 1.6 + 0.17 * (k % 4), 2.0 * np.pi * k / count + 0.3
    return np.column_stack([reach * np.cos(turn), reach * np.sin(turn), 0.1 + 0.45 * (k % 3)])


def places_at(station, visit, head, nests, mirrors, spread, rounds):
    """Rows (position, station, kind, number) and places, m, in the order of a station."""
    look = [((-1, station, NEST, k), nest) for k, nest in enumerate(nests)]
    found = list(look)
    for visited, i in enumerate(visit, start=1):
        normal, glass = mirrors[i]
        beam = (glass - head) / np.linalg.norm(glass - head)
        back = beam - 2.0 * (beam @ normal) * normal
        for k, aside in enumerate(spread):
            there = glass + 1.5 * back + 0.02 * aside
            image = there - 2.0 * ((there - glass) @ normal) * normal
            found += [((i, station, DIRECT, k), there), ((i, station, MIRRORED, k), image)]
        if visited in rounds and visited < len(visit):
            found += look
    found += look
    return np.array([row for row, _ in found]), np.array([place for _, place in found])


def mirror_world(seed, pattern="half", size=0.0, *, place="position", reflectors=6, count=None,
                 direction=(0.0, 1.0, 0.0), swing=0.0, cycles=1.0, rounds=()):  # fmt: skip
    """`count` of the reflectors are seen wrongly in the mirror at one position or one station.

    `size`: standard deviations of such a reading, along `direction` in the beam's frame (None: any
    at random). `swing`: rad, the tracker's azimuth goes as a sine of so many `cycles` while it
    stands at each of its stations. `rounds`: after how many positions of a station the nests are
    measured, besides first and last.
    """
    rng = np.random.default_rng([seed, reflectors, 77])
    angles = np.arange(17) * np.pi / 8
    ecc = 4 * ARCSEC * np.sin(angles + rng.uniform(0, 6)) + ARCSEC * np.cos(3 * angles)
    nests = nests_around(6)
    tilt = rng.normal(scale=0.2 * ARCSEC, size=(17, 2))
    leaning = np.radians(1.4) + tilt[:, 0]
    mirrors = [mirror_and_glass(*pose) for pose in zip(angles + ecc, leaning, strict=True)]
    wrong_at = int(rng.integers(17)), int(rng.integers(len(MIRROR_STATIONS)))
    spread = rng.standard_normal((reflectors, 3))
    wrong = chosen(pattern, count or reflectors // 2, spread, rng)
    towards = rng.standard_normal(3) if direction is None else np.array(direction)
    towards = towards / np.linalg.norm(towards)
    rows, seen, error = [], [], []
    for s, visit in enumerate(MIRROR_STATIONS):
        middle = angles[list(visit)].mean()
        head = np.array([2.0 * np.cos(middle), 2.0 * np.sin(middle), 0.35])
        own, world = places_at(s, visit, head, nests, mirrors, spread, rounds)
        share = np.linspace(0.0, 1.0, len(own))
        heading = 2.3 * middle + 0.4 - swing * np.sin(2 * np.pi * cycles * share)
        away = world - head
        c, sn = np.cos(heading), np.sin(heading)
        exact = np.column_stack(
            [c * away[:, 0] + sn * away[:, 1], c * away[:, 1] - sn * away[:, 0], away[:, 2]]
        )
        frame, std = beam_frame(exact), tracker_std(exact)
        noise = np.einsum("na,nai->ni", std * rng.standard_normal(exact.shape), frame)
        rows.append(own)
        seen.append(exact + noise)
        here = own[:, 0] == wrong_at[0] if place == "position" else own[:, 1] == wrong_at[1]
        spoilt = here & (own[:, 2] == MIRRORED) & np.isin(own[:, 3], np.flatnonzero(wrong))
        off = np.einsum("na,nai->ni", size * std * towards, frame)
        error.append(np.where(spoilt[:, None], off, 0.0))
    points, errors = np.concatenate(seen), np.concatenate(error)
    return MirrorWorld(angles, ecc - ecc[0], np.concatenate(rows), points, errors)


def carried_world(seed, pattern="half", size=0.0, *, reflectors=6, count=None):
    """`count` of the reflectors that the table carries are off along its turn at one position.

    `size`: standard deviations of a reading across the beam.
    """
    rng = np.random.default_rng([seed, reflectors, 78])
    angles = np.arange(17) * np.pi / 8
    ecc = 4 * ARCSEC * np.sin(angles + rng.uniform(0, 6)) + ARCSEC * np.cos(3 * angles)
    turn = np.arange(6) * np.pi / 3 + 0.3
    nests = np.column_stack([1.8 * np.cos(turn), 1.8 * np.sin(turn), 0.1 + 0.4 * (turn % 1.0)])
    at = 2 * np.pi * np.arange(reflectors) / reflectors + rng.uniform(-0.2, 0.2, reflectors)
    height = rng.uniform(0.1, 0.2, reflectors)
    wrong_at = int(rng.integers(1, 16))
    places = np.column_stack([np.cos(at), np.sin(at), height])
    wrong = chosen(pattern, count or reflectors // 2, places, rng)
    rows, seen, error = [], [], []
    for s, visit in enumerate(MIRROR_STATIONS):
        middle = angles[list(visit)].mean()
        head = np.array([2.2 * np.cos(middle), 2.2 * np.sin(middle), 0.6])
        look = [((-1, s, NEST, k), nest, 0.0 * nest) for k, nest in enumerate(nests)]
        own = list(look)
        for i in visit:
            stands = angles[i] + ecc[i] + at
            there = np.column_stack([0.3 * np.cos(stands), 0.3 * np.sin(stands), height])
            along = np.column_stack([-np.sin(stands), np.cos(stands), 0 * stands])
            off = np.where(wrong[:, None] & (i == wrong_at), along, 0.0)
            own += [((i, s, DIRECT, k), there[k], off[k]) for k in range(reflectors)]
        own += look
        away = np.array([place for _, place, _ in own]) - head
        c, sn = np.cos(2.3 * middle), np.sin(2.3 * middle)
        into = np.array([[c, sn, 0.0], [-sn, c, 0.0], [0.0, 0.0, 1.0]])
        exact = away @ into.T
        std = tracker_std(exact)
        noise = np.einsum("na,nai->ni", std * rng.standard_normal(exact.shape), beam_frame(exact))
        rows.append(np.array([row for row, _, _ in own]))
        seen.append(exact + noise)
        error.append(size * std[:, 1:2] * (np.array([off for _, _, off in own]) @ into.T))
    points, errors = np.concatenate(seen), np.concatenate(error)
    return MirrorWorld(angles, ecc - ecc[0], np.concatenate(rows), points, errors)
