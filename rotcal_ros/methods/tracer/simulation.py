"""The simulated laser tracer on the table, live and spoiled on purpose.

The tracer has noise, spikes, drop-outs and a beam that is blocked at times. Its zero changes
whenever the beam was broken, and by a fringe when the counter slips. The machine carries its
reflector. :data:`DISTURBANCES` measures a plan again with one thing wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import dist, log, nan
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints, Stamps
from rotcal_ros.foundation.observations import (
    Command,
    LengthStatus,
    Observation,
    PointKind,
    ProbeSample,
    TracerSample,
)
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE, NANOSECOND
from rotcal_ros.geometry.rotations import rotation_about_z, rotation_from_vector
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.disturbance import (
    ALL_AXES,
    PPM,
    Disturbance,
    Disturbances,
    DisturbedMeasurement,
    Sizes,
    Streams,
    arrival_errors,
    error_motion,
    random_streams,
    relative_times,
    repeatability,
    scatter_in_plane,
    tilt,
)
from rotcal_ros.methods.simulation.air import SimulatedAir, SimulatedTemperature
from rotcal_ros.methods.simulation.instrument import SimulatedInstrument, Table, Ticks
from rotcal_ros.methods.simulation.motion import Motion, MotionLimits
from rotcal_ros.methods.simulation.noise import IndexedNoise, NoiseSource
from rotcal_ros.methods.tracer.settings import (
    FaultSettings,
    LengthsSimulationSettings,
    SimulatedReadingsSettings,
)
from rotcal_ros.planning.plan import Plan
from rotcal_ros.planning.sequence_time import Drive, TimeModel

_FRINGE_UM: Final = 0.3164
"""Half a wavelength of a HeNe laser."""


TANGENTIAL: Final = Disturbance(
    "tangential motion",
    "mount or cable shift the tracer along its circle, by so much times the cosine of twice the "
    "table's angle",
    "um", MICROMETRE, 0.1, 10.0,
)  # fmt: skip
SECTOR: Final = 0.4
"""Share of a station's beams that warm air or a person may reach."""


class SimulatedTracer:
    """Turns true distances into readings; they are asked for in their order.

    Reading k depends on k, and its zero on how often the beam was broken before.
    """

    def __init__(
        self,
        settings: SimulatedReadingsSettings,
        faults: FaultSettings,
        seed: int,
        start_ns: int = 0,
    ) -> None:
        self.settings, self._faults = settings, faults
        shift_um = settings.zero_shift_um * np.random.default_rng([seed, start_ns]).normal()
        self._dead_distance_m = settings.dead_distance_m + shift_um * MICROMETRE
        self._noise = IndexedNoise(seed, NoiseSource.TRACER)
        self._spike = IndexedNoise(seed, NoiseSource.SPIKE)
        self._spike_sign = IndexedNoise(seed, NoiseSource.SPIKE_SIGN)
        self._dropout = IndexedNoise(seed, NoiseSource.DROPOUT)
        self._non_finite = IndexedNoise(seed, NoiseSource.NON_FINITE)
        self._break = IndexedNoise(seed, NoiseSource.BREAK)
        self._break_shift = IndexedNoise(seed, NoiseSource.BREAK_SHIFT)
        self._slip = IndexedNoise(seed, NoiseSource.SLIP)
        self._breaks, self._slips, self._dark = 0, 0, False
        self._air = IndexedNoise(seed, NoiseSource.DRIFTING)
        self._jitter = IndexedNoise(seed, NoiseSource.JITTER)
        self._keeps = float(np.exp(-1.0 / (settings.rate_hz * settings.drifting_s)))
        self._drifted: Floats | None = None  # the state of that filter
        self._entered, self._inside, self._dead_to_ns = 0, False, start_ns

    def read_at(self, first: int, stamps: Stamps) -> Stamps:
        """Return when the readings number ``first`` and following, of ``stamps`` (n,), are of."""
        settings = self.settings
        if not (settings.lag_s or settings.jitter_s):
            return stamps
        late = settings.lag_s + settings.jitter_s * self._jitter.normal(first, len(stamps))
        return np.asarray(stamps - np.round(late / NANOSECOND).astype(np.int64))

    def blocked(self, table_angles_deg: Floats, target: int) -> Bools:
        """Return whether the beam to ``target`` is blocked at the table angles (n,), in order."""
        faults = self._faults
        width = (faults.blocked_to_deg - faults.blocked_from_deg) % 360.0
        meant = faults.blocked_targets == (-1,) or target in faults.blocked_targets
        if not meant or faults.blocked_from_deg == faults.blocked_to_deg:
            return np.zeros(len(table_angles_deg), dtype=bool)
        inside: Bools = (table_angles_deg - faults.blocked_from_deg) % 360.0 <= width
        if not faults.blocked_times or not len(inside):
            return inside
        entered = self._entered + np.cumsum(inside & ~np.append(self._inside, inside[:-1]))
        self._entered, self._inside = int(entered[-1]), bool(inside[-1])
        return np.asarray(inside & (entered <= faults.blocked_times))

    def readings(
        self, first: int, stamps: Stamps, distances: Floats, drifts: Floats, broken: Floats
    ) -> tuple[TracerSample, ...]:
        """Return the readings number ``first`` and following that are not lost.

        ``distances`` (m), ``drifts`` (m, to be added) and ``broken`` (0 or 1) have shape (n,).
        """
        count, faults = len(stamps), self._faults
        if faults.break_probability > 0:
            hit = self._break.uniform(first, count) < faults.break_probability
            broken = np.maximum(broken, hit)
        broken = self._until_locked(stamps, broken)
        std = (self.settings.noise_um + self.settings.noise_um_per_m * distances) * MICROMETRE
        length = distances - self._dead_distance_m + drifts
        length += std * self._noise.normal(first, count)
        length += self._drift(first, count)
        length += self._zero_changes(first, broken > 0)
        if faults.spike_probability > 0:
            hit = self._spike.uniform(first, count) < faults.spike_probability
            sign = np.where(self._spike_sign.uniform(first, count) < 0.5, -1.0, 1.0)
            length += hit * sign * faults.spike_um * MICROMETRE
        if faults.non_finite_probability > 0:
            length[self._non_finite.uniform(first, count) < faults.non_finite_probability] = nan
        length[broken > 0] = nan
        rows = zip(stamps.tolist(), length.tolist(), std.tolist(), broken.tolist(), strict=True)
        lost = self._lost(first, count).tolist()
        return tuple(
            TracerSample(
                stamp,
                (first + number) % (1 << 32),
                value,
                deviation,
                LengthStatus.BEAM_BROKEN if dark else LengthStatus.OK,
            )
            for number, (stamp, value, deviation, dark) in enumerate(rows)
            if not lost[number]
        )

    def _until_locked(self, stamps: Stamps, broken: Floats) -> Floats:
        """Return what is ``broken`` (n,), with the dead time behind each break."""
        dead_ns = round(self.settings.dead_time_s / NANOSECOND)
        if not dead_ns or not len(stamps):
            return broken
        last = np.maximum.accumulate(np.where(broken > 0, stamps + dead_ns, self._dead_to_ns))
        self._dead_to_ns = int(last[-1])
        return np.asarray(np.maximum(broken, stamps < last))

    def _drift(self, first: int, count: int) -> Floats:
        """Return what the air adds to readings, an autoregression of the first order, m."""
        if not (self.settings.drifting_um and count):
            return np.zeros(count)
        # Solving a bag loads the simulated instrument, and needs no filter.
        from scipy.signal import lfilter

        new = np.sqrt(1.0 - self._keeps**2) * self._air.normal(first, count)
        if self._drifted is None:
            self._drifted = self._keeps * self._air.normal(first, 1)
        found, self._drifted = lfilter([1.0], [1.0, -self._keeps], new, zi=self._drifted)
        return np.asarray(self.settings.drifting_um * MICROMETRE * found)

    def _zero_changes(self, first: int, broken: Bools) -> Floats:
        """Return by how much (n,) breaks and slips so far have changed the zero, m."""
        faults, count = self._faults, len(broken)
        back = np.append(self._dark, broken[:-1]) & ~broken
        breaks = self._breaks + np.cumsum(back)
        self._breaks, self._dark = int(breaks[-1]), bool(broken[-1])
        changes = np.zeros(count)
        if faults.break_shift_um > 0 and self._breaks:
            shifts = np.append(0.0, self._break_shift.normal(0, self._breaks))
            changes += faults.break_shift_um * np.cumsum(shifts)[breaks]
        if faults.slip_probability > 0:
            hit = self._slip.uniform(first, count) < faults.slip_probability
            slips = self._slips + np.cumsum(hit)
            self._slips = int(slips[-1])
            changes += _FRINGE_UM * slips
        return changes * MICROMETRE

    def _lost(self, first: int, count: int) -> Bools:
        """Return which of the readings fall into a drop-out."""
        length = self._faults.dropout_samples
        if self._faults.dropout_probability <= 0:
            return np.zeros(count, dtype=bool)
        before = min(first, length - 1)
        starts = self._dropout.uniform(first - before, count + before)
        hits = np.concatenate([[0], np.cumsum(starts < self._faults.dropout_probability)])
        number = np.arange(before, before + count)
        lost: Bools = hits[number + 1] > hits[np.maximum(number + 1 - length, 0)]
        return lost


class TracerAndReflector(SimulatedInstrument):
    """A reflector on a probe that moves on straight lines, and the tracer that measures to it.

    The tracer rides on the table. The machine reports where it believes the probe to be: the
    ordered position and a following error. The reflector is elsewhere: by a systematic error, the
    same at each visit of a target, and by a random one of this arrival.
    """

    streams_lengths = True

    def __init__(
        self,
        settings: LengthsSimulationSettings,
        mount_m: tuple[float, float, float],
        table: Table,
        temperature: SimulatedTemperature,
        start_ns: int,
    ) -> None:
        super().__init__(start_ns)
        tracer, probe, seed = settings.tracer, settings.probe, settings.noise_seed
        self._table, self._temperature = table, temperature
        self._air = SimulatedAir(settings.air, temperature, seed, start_ns)
        self._mount = np.array(mount_m)
        self._zero_m = 0.0
        self._tracer = SimulatedTracer(tracer, settings.faults, seed, start_ns)
        self._ticks = Ticks(start_ns, tracer.rate_hz)
        self.settings = probe
        self._limits = MotionLimits(
            speed=probe.speed_m_s,
            acceleration=probe.acceleration_m_s2,
            lag=probe.settling_um * MICROMETRE,
            settling_time=probe.settling_time_s,
        )
        self._target_noise = IndexedNoise(settings.seed, NoiseSource.TARGET)
        self._repeat_noise = IndexedNoise(seed, NoiseSource.PROBE_REPEAT)
        self._following_noise = IndexedNoise(seed, NoiseSource.FOLLOWING)
        self._arrivals = 0
        self._ordered = probe.initial_position_m
        self._from = self._actual_to = self._reported = np.array(self._ordered)
        self._motion = Motion(start_ns, [0.0], self._limits)
        self.target = -1

    def order(self, now_ns: int, command: Command) -> None:
        """Go to the position of ``command`` and report it when there."""
        self.pending = command
        resting = now_ns >= self._motion.end_ns
        if not (resting and command.position == self._ordered and command.target == self.target):
            here = self.positions(np.array([now_ns]))[0]
            self._depart(now_ns, here, command)
        self.rest_ns = max(now_ns, self._motion.end_ns)

    def positions(self, stamps: Stamps) -> Floats:
        """Return the actual positions (n, 3) of the reflector, m, machine frame."""
        way = self._actual_to - self._from
        length = float(np.linalg.norm(way))
        if length == 0:
            return np.tile(self._actual_to, (len(stamps), 1))
        travelled = self._motion.state(stamps)[0]
        positions: Floats = self._from + np.multiply.outer(travelled / length, way)
        return positions

    def report(self, after_ns: int, now_ns: int, table_rest_ns: int) -> tuple[ProbeSample, ...]:
        """Return the point of the pending order when it falls in ``after_ns`` < t <= ``now_ns``.

        A reflector just stands there; any other kind is measured with the table at rest.
        """
        command = self.pending
        if command is None:
            return ()
        ready = self.rest_ns
        if command.kind != PointKind.REFLECTOR:
            ready = max(ready, table_rest_ns)
        stamp = max(ready + round(self.settings.report_delay_s / NANOSECOND), after_ns + 1)
        if stamp > now_ns:
            return ()
        self.pending = None
        std = float(np.hypot(self.settings.systematic_um, self.settings.repeatability_um))
        return (self.point(stamp, command, self._reported, std * MICROMETRE),)

    def distances(self, stamps: Stamps) -> Floats:
        """Return the true distances (n,) from the tracer to the reflector, m."""
        rotation, translation = self._table.poses(stamps)
        station = rotation @ self._mount + translation
        distances: Floats = np.linalg.norm(self.positions(stamps) - station, axis=1)
        return distances

    def lengths(self, now_ns: int) -> tuple[TracerSample, ...]:
        """Return the readings since the call before."""
        first, stamps = self._ticks.until(now_ns)
        if not len(stamps):
            return ()
        distances = self.distances(self._tracer.read_at(first, stamps))
        drifts = self._temperature.length_change(stamps, distances) + self._zero_m
        if self._air.settings.vacuum_lengths:
            drifts += (self._air.index(stamps) - 1.0) * distances
        angles_deg = self._table.angles(stamps) / DEGREE
        broken = self._tracer.blocked(angles_deg, self.target)
        return self._tracer.readings(first, stamps, distances, drifts, broken.astype(float))

    def _depart(self, now_ns: int, here: Floats, command: Command) -> None:
        self._arrivals += 1
        settings, order = self.settings, np.array(command.position)
        self._reported = order + settings.following_um * MICROMETRE * _triple(
            self._following_noise, self._arrivals
        )
        missed = settings.systematic_um * _triple(self._target_noise, command.target)
        missed = missed + settings.repeatability_um * _triple(self._repeat_noise, self._arrivals)
        self._from, self._actual_to = here, self._reported + missed * MICROMETRE
        self._motion = Motion(now_ns, [0.0, dist(self._from, self._actual_to)], self._limits)
        self._ordered, self.target = command.position, command.target


def _triple(noise: IndexedNoise, number: int) -> Floats:
    return noise.normal(3 * number, 3)


def _error_motion(configuration: Configuration) -> float:
    """Return the stated error motion (m, k = 1), none where it is left to the circle."""
    stated: float | None = configuration.solver.error_motion_std_m
    return 0.0 if stated is None else stated


def length_disturbances(drift: float, knock: float, air: float) -> tuple[Disturbance, ...]:
    """Return what spoils lengths of a tracer on the table, wherever it stands.

    Worth a search from these sizes on: ``drift`` and ``knock`` in um, ``air`` in ppm (per metre).
    """
    return (
        Disturbance(
            "drift",
            "the origin of the machine drifts along x, y and z alike, linearly over the whole run",
            "um", MICROMETRE, drift, 100.0,
        ),
        Disturbance(
            "knock",
            "the tracer is shifted on the table, along x, y and z alike, half-way through the run",
            "um", MICROMETRE, knock, 100.0,
        ),
        Disturbance(
            "axis noise",
            "the machine's errors along z are so many times the stated ones",
            "times", 1.0, 1.5, 100.0, scatters=True,
        ),
        Disturbance(
            "refraction",
            "the index of the air changes with the height by so much per metre",
            "ppm/m", PPM, air, 1000.0,
        ),
        Disturbance(
            "one place",
            "two fifths of the beams of one station, all in one sector, are too long by so much",
            "um", MICROMETRE, 1.0, 100.0,
        ),
        Disturbance(
            "scale", "the tracer's lengths are too long by so much", "ppm", PPM, air, 1000.0
        ),
    )  # fmt: skip


def leaning_axis(largest: float) -> Disturbance:
    """Return the lean of the table's axis, up to ``largest`` arcsec."""
    what = "the table's axis leans by so much against the machine's z axis"
    return Disturbance("gauge", what, "arcsec", ARCSEC, 100.0, largest)


def tangential_shift(turned: Floats, angle: Floats, sizes: Sizes) -> Floats:
    """Return by how much (n, 3), m, tracers at ``turned`` (n, 3) are shifted at an angle (n,)."""
    across = np.column_stack([-turned[:, 1], turned[:, 0], np.zeros(len(turned))])
    along = across * (np.cos(2.0 * angle) / np.hypot(*turned[:, :2].T))[:, None]
    return np.asarray(sizes.get(TANGENTIAL.effect, 0.0) * along, dtype=np.float64)


LISTED: Final = (
    *length_disturbances(1.0, 0.3, 1.0),
    error_motion(0.1, 100.0, _error_motion),
    repeatability(0.3, 100.0),
    tilt(0.3, 100.0),
    leaning_axis(3600.0),
    TANGENTIAL,
    Disturbance(
        "slip",
        "the zero of the lengths jumps by so much, at any moment of one turn",
        "um", MICROMETRE, 0.1, 100.0, of_turns=True,
    ),
    Disturbance(
        "lag",
        "the feedback is late by so much behind the lengths",
        "ms", 1e-3, 1.0, 100.0, of_turns=True,
    ),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class PlannedSteps:
    """The steps of a plan as arrays (n,): place of the tracer, table position, target, time.

    ``speed``, rad/s, 0 at rest; ``turn``: the number of the turn, -1 at rest.
    """

    place: Ints
    position: Ints
    target: Ints
    time: Floats
    speed: Floats
    turn: Ints

    @property
    def half_way(self) -> float:
        """When a knock comes: in the middle of the run, and of a turn."""
        return 0.5 + 0.5 / (self.turn.max() + 1) if self.turn.max() >= 0 else 0.5


def measure(
    configuration: Configuration, plan: Plan, sizes: Sizes, seed: int
) -> DisturbedMeasurement:
    """Return what a perfect table's tracer reads, with the stated noise and effects of ``sizes``.

    The tracer stands where the simulation mounts it. True deviations are zero.
    """
    noise, other = random_streams(seed)
    stations = _stations(configuration, plan, sizes, (noise, other))
    observations = observe_plan(configuration, plan, stations, sizes, (noise, other))
    return DisturbedMeasurement(observations, {"ECC": np.zeros(len(plan.table_angles))})


def observe_plan(
    configuration: Configuration, plan: Plan, stations: Floats, sizes: Sizes, streams: Streams
) -> tuple[Observation, ...]:
    """Return what a tracer observes that is at ``stations`` (n, 3), m, at the steps of ``plan``.

    ``streams``: of the stated noise, and of what is beside it.
    """
    noise, other = streams
    steps = steps_of(plan)
    places = _reflector_places(configuration, plan, steps, sizes, noise)
    read = _readings(configuration, stations, places, sizes, noise)
    # a station is one place of the tracer at one table position
    station = steps.place * len(plan.steps) + steps.position
    read += _in_a_sector(stations, places, station, sizes, other)
    if size := sizes.get("slip", 0.0):
        chosen = np.flatnonzero(steps.turn == other.choice(np.unique(steps.turn[steps.turn >= 0])))
        read[chosen[other.integers(1, len(chosen)) :]] += size
    return tuple(
        step.observed((value,)) for step, value in zip(plan.steps, read.tolist(), strict=True)
    )


def _readings(
    configuration: Configuration,
    stations: Floats,
    places: Floats,
    sizes: Sizes,
    noise: np.random.Generator,
) -> Floats:
    """Return the lengths (n,) read from ``stations`` (n, 3) to reflectors at ``places`` (n, 3)."""
    solver = configuration.solver
    distance = np.linalg.norm(places - stations, axis=1)
    height = 0.5 * (places[:, 2] + stations[:, 2])
    optical = distance * (1.0 + sizes.get("scale", 0.0))
    optical = optical * (1.0 + sizes.get("refraction", 0.0) * (height - height.mean()))
    std = np.hypot(solver.length_std_m, solver.length_std_relative * distance)
    read = optical + std * noise.standard_normal(len(distance))
    return np.asarray(read - configuration.simulation.tracer.dead_distance_m)


def _in_a_sector(
    stations: Floats, places: Floats, arrival: Ints, sizes: Sizes, rng: np.random.Generator
) -> Floats:
    """Return by how much the lengths (n,) of one station are too long in one sector, m.

    ``arrival`` (n,): which station each length belongs to; one of them is drawn, and the middle of
    the sector, which holds SECTOR of its beams.
    """
    found, size = np.zeros(len(arrival)), sizes.get("one place", 0.0)
    if size:
        chosen = np.flatnonzero(arrival == rng.choice(np.unique(arrival)))
        beams, middle = places[chosen] - stations[chosen], rng.uniform(-np.pi, np.pi)
        away = np.abs(np.angle(np.exp(1j * (np.arctan2(beams[:, 1], beams[:, 0]) - middle))))
        found[chosen[np.argsort(away)[: round(SECTOR * len(chosen))]]] = size
    return found


def steps_of(plan: Plan) -> PlannedSteps:
    """Return the steps of a plan as arrays."""
    turns = np.array([step.turn is not None for step in plan.steps])
    return PlannedSteps(
        place=np.array([step.station for step in plan.steps], dtype=np.int64),
        position=np.array([step.table_position for step in plan.steps], dtype=np.int64),
        target=np.array([step.target for step in plan.steps], dtype=np.int64),
        time=relative_times(plan),
        speed=np.array([0.0 if step.turn is None else step.turn.speed for step in plan.steps]),
        turn=np.where(turns, np.cumsum(~turns) - 1, -1),
    )


def _stations(configuration: Configuration, plan: Plan, sizes: Sizes, streams: Streams) -> Floats:
    """Return where the tracer is at every step (n, 3), m."""
    noise, other = streams
    steps = steps_of(plan)
    m = len(plan.table_angles)
    arrived = arrival_errors(plan, sizes, other)
    lean = scatter_in_plane(m, sizes.get("tilt", 0.0), other)
    shift = scatter_in_plane(m, _error_motion(configuration), noise)
    shift += scatter_in_plane(m, sizes.get("error motion", 0.0), other)
    knock = sizes.get("knock", 0.0) * np.outer(steps.time >= steps.half_way, ALL_AXES)
    mount = np.array(configuration.simulation.tracer.mount_m) + knock
    arrived = arrived + sizes.get("lag", 0.0) * steps.speed
    turn = rotation_about_z(np.array(plan.table_angles)[steps.position] + arrived)
    turned = np.einsum("nij,nj->ni", turn, mount)
    at = steps.position
    leant = np.einsum("nij,nj->ni", rotation_from_vector(lean)[at], turned)
    angle = np.array(plan.table_angles)[at]
    shifted = leant + shift[at] + tangential_shift(turned, angle, sizes)
    return np.asarray(shifted, dtype=np.float64)


def _reflector_places(
    configuration: Configuration,
    plan: Plan,
    steps: PlannedSteps,
    sizes: Sizes,
    noise: np.random.Generator,
) -> Floats:
    """Return where the reflector is at every step (n, 3) in the frame of the table's axis, m."""
    targets = np.array(plan.targets)
    error = configuration.solver.target_std_m * noise.standard_normal(targets.shape)
    error[:, 2] *= sizes.get("axis noise", 1.0)
    frame = rotation_from_vector(np.array([sizes.get("gauge", 0.0), 0.0, 0.0]))
    drift = sizes.get("drift", 0.0) * np.outer(steps.time, ALL_AXES)
    return np.asarray((targets + error)[steps.target] @ frame.T + drift, dtype=np.float64)


def cell_time(configuration: Configuration) -> TimeModel:
    """Return the time model of the simulated cell of ``configuration``, in machine time.

    The capture takes the table for at rest when its lag has decayed to the tolerances of place
    and speed; the feedback reports it half a period later. Then come the settle time and the
    window, which begins half a period of the tracer late, and the feedback that confirms the rest.
    """
    simulation, capture = configuration.simulation, configuration.capture
    table, probe, tracer = simulation.table, simulation.probe, simulation.tracer
    lag, decay = table.settling_arcsec * ARCSEC, table.settling_time_s
    excess = max(
        lag / (capture.position_tolerance_arcsec * ARCSEC),
        lag / decay / (capture.velocity_tolerance_deg_s * DEGREE),
        1.0,
    )
    feedback = 1.0 / table.feedback_rate_hz
    window = (capture.window_samples - 0.5) / tracer.rate_hz
    return TimeModel(
        table=Drive(
            table.speed_deg_s * DEGREE,
            table.acceleration_deg_s2 * DEGREE,
            settle=decay * log(excess),
        ),
        machine=Drive(probe.speed_m_s, probe.acceleration_m_s2),
        report=probe.report_delay_s,
        dwell=0.5 * feedback + capture.settle_time_s + window + 0.5 * feedback,
        overshoot=table.overshoot_deg * DEGREE,
    )


DISTURBANCES: Final = Disturbances(LISTED, measure)
