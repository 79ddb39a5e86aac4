"""Hand-made streams of a small calibration, in which every kind of trouble can be placed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from rotcal_ros.capture import Capture, CaptureRules, CaptureSettings, Record
from rotcal_ros.foundation.observations import (
    Approach,
    LengthStatus,
    Observation,
    PointKind,
    ProbeSample,
    TableSample,
    TemperatureSample,
    TracerSample,
)
from rotcal_ros.methods import find_method
from rotcal_ros.planning.plan import Plan, Step

MS = 1_000_000
SECOND = 1000 * MS
METHODS = [find_method(n) for n in ("tracer_multistation", "ball_plate", "plane_mirror")]
RULES = CaptureRules(
    decide={kind: way for method in METHODS for kind, way in method.capture.decide.items()},
    checks=lambda plan: [check for method in METHODS for check in method.capture.checks(plan)],
)
"""Those of all methods, as if one plan could hold steps of every kind."""
ANGLES = (0.0, 0.5, 1.0)
TARGETS = ((0.0, 0.0, 1.0), (0.2, 0.0, 1.0), (0.2, 0.3, 1.1))
SETTINGS = CaptureSettings(
    position_tolerance_arcsec=20.0,
    settle_time_s=0.05,
    window_samples=20,
    step_timeout_s=0.6,
    clock_tolerance_s=100.0,
    temperature_lag_s=0.3,
    table_silence_s=0.1,
)


def make_plan(kind: PointKind = PointKind.REFLECTOR, n_points: int = 1) -> Plan:
    steps = tuple(
        Step(
            index=3 * t + a,
            table_position=a,
            table_angle=angle,
            approach=Approach.POSITIVE,
            kind=kind,
            target=t,
            position=target,
            n_points=n_points,
        )
        for t, target in enumerate(TARGETS)
        for a, angle in enumerate(ANGLES)
    )
    return Plan(method="test", table_angles=ANGLES, targets=TARGETS, steps=steps)


@dataclass
class Scene:
    """Four streams; step k is ordered at second k, the table arrives 0.1 s later (or at t0)."""

    tracer: list[TracerSample] = field(default_factory=list)
    table: list[TableSample] = field(default_factory=list)
    probe: list[ProbeSample] = field(default_factory=list)
    temperature: list[TemperatureSample] = field(default_factory=list)

    def streams(self) -> tuple[list[Record], ...]:
        return (self.tracer, self.table, self.probe, self.temperature)

    def by_stamp(self) -> list[Record]:
        return sorted((r for s in self.streams() for r in s), key=lambda r: r.stamp_ns)

    def edit(
        self, name: str, change: Callable[[Record], Record | None], begin: int, end: int
    ) -> None:
        """Change the records of a stream stamped in [begin, end); None removes one."""
        changed = [change(r) if begin <= r.stamp_ns < end else r for r in getattr(self, name)]
        setattr(self, name, [r for r in changed if r is not None])


def length_of(step: Step) -> float:
    """A length that fits the plan: the distance of the target from a point on the table."""
    x, y, z = step.position
    station = 0.06 * np.cos(step.table_angle), 0.06 * np.sin(step.table_angle)
    return float(np.hypot(np.hypot(x - station[0], y - station[1]), z)) - 1.0


def make_scene(plan: Plan, n_steps: int = 3, seed: int = 0, start_ns: int = 0) -> Scene:
    """Return undisturbed streams: tracer 1 kHz, table 100 Hz, temperature 10 Hz."""
    rng = np.random.default_rng(seed)
    scene = Scene()
    for k in range(-1, n_steps):
        step = plan.steps[max(k, 0)]
        begin = start_ns + k * SECOND
        noise = 1e-7 * rng.standard_normal(1000)
        for i in range(1000):
            stamp = begin + (i + 1) * MS
            value = length_of(step) + float(noise[i])
            sequence = (k + 1) * 1000 + i
            scene.tracer.append(TracerSample(stamp, sequence, value, 1e-7, LengthStatus.OK))
        for i in range(100):
            stamp = begin + 10 * i * MS + 1
            moving = i < 10
            angle = step.table_angle - (0.01 * (10 - i) if moving else 0.0)
            scene.table.append(TableSample(stamp, angle, 1.0 if moving else 0.0))
        for i in range(10):
            scene.temperature.append(
                TemperatureSample(begin + 100 * i * MS, "air", 20 + k + i / 10)
            )
        if k >= 0:
            scene.probe.append(probe_sample(step, begin + 150 * MS))
    return scene


def probe_sample(step: Step, stamp_ns: int, attempt: int = 0, point: int = 0) -> ProbeSample:
    return ProbeSample(
        stamp_ns=stamp_ns,
        sequence=step.index,
        step=step.index,
        attempt=attempt,
        kind=step.kind,
        target=step.target,
        station=step.station,
        point=point,
        position=step.position,
        position_std=(1e-6, 2e-6, 3e-6),
        tip_radius=0.0,
    )


def replay(
    plan: Plan, records: Iterable[Record], settings: CaptureSettings = SETTINGS
) -> tuple[Observation, ...]:
    capture = Capture(plan, settings, RULES)
    return tuple(o for record in records for o in capture.feed(record))


def table_off(arcsec: float) -> Callable[[Record], Record]:
    """Return a change that moves the table feedback away."""
    return lambda r: replace(r, angle=r.angle + np.deg2rad(arcsec / 3600))
