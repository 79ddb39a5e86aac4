"""The plan of a quick check by laser tracer: from a configuration and an earlier curve."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from rotcal_design.settings import (
    CHECK_FILE,
    LEAST_REDUNDANCY,
    TracerDesignSettings,
)
from rotcal_design.tracer.candidates import candidates, make_scene
from rotcal_design.tracer.check_lengths import CheckLengths, fewest_lengths
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.curves.interpolation import without_harmonics
from rotcal_ros.foundation.curves.measured import MeasuredCurve
from rotcal_ros.foundation.errors import ConfigurationError, PlanError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.geometry.rotations import positions_on_table
from rotcal_ros.methods.configuration import Configuration, replaced
from rotcal_ros.methods.tracer.plan import LEAST_ANGLES
from rotcal_ros.methods.tracer.policy.exchange import Progress
from rotcal_ros.methods.tracer.policy.information import Scene, noisy_problem
from rotcal_ros.methods.tracer.policy.sequence import (
    Forecast,
    SequenceForecast,
    least_hidden,
    measuring_orders,
)
from rotcal_ros.methods.tracer.simulation import cell_time
from rotcal_ros.methods.tracer.solver.solve import METHOD
from rotcal_ros.methods.tracer.table import write_plan_files
from rotcal_ros.planning.check_rule import CheckRule
from rotcal_ros.planning.plan import Point

SEED: Final = 0
"""Seed of the noise with which orders are judged."""


@dataclass(frozen=True, eq=False)
class CheckPlan:
    """What to measure: ``angles`` (m,) rad, ``targets`` (n, 3) m, ``pairs`` (k, 2) in their order.

    A pair is a table position and a target. ``std`` (m,), rad: predicted standard uncertainty of
    each angle less their mean; ``acceptance`` (m,): up to which difference it will be still valid.
    ``assurance``: with what probability, at least, a table is found still valid that has only aged
    as stated. ``offered``: lengths there were to choose from. ``seconds`` from the end of the
    first length to that of the last, by the simulated cell's clock; ``unseen``: what a drift or
    knock could do in this order without a trace.
    """

    configuration: Configuration
    rule: CheckRule
    angles: Floats
    targets: Floats
    pairs: Ints
    std: Floats
    acceptance: Floats
    assurance: float
    least_redundancy: float
    offered: int
    seconds: float
    unseen: Forecast

    @property
    def at_each_angle(self) -> Ints:
        """How many lengths are measured at each angle (m,)."""
        return np.bincount(self.pairs[:, 0], minlength=len(self.angles))

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON, SI."""
        return {
            "lengths": len(self.pairs),
            "offered": self.offered,
            "duration_s": self.seconds,
            "unseen_std": self.unseen.to_dict(),
            "assurance": self.assurance,
            "least_redundancy": self.least_redundancy,
            "angles_rad": self.angles.tolist(),
            "predicted_std": self.std.tolist(),
            "acceptance": self.acceptance.tolist(),
            "targets_m": self.targets.tolist(),
            "pairs": self.pairs.tolist(),
        }

    def write(self, folder: Path) -> Path:
        """Write configuration, targets and pairs into ``folder``; return the configuration's path.

        Raises BagError where that is not possible.
        """
        plan = write_plan_files(folder, self.angles, self.targets, self.pairs)
        path = folder / CHECK_FILE
        write_atomically(path, replaced(self.configuration, "plan", plan))
        return path


def plan_check(
    configuration: Configuration,
    earlier: MeasuredCurve,
    rule: CheckRule,
    *,
    every: int = 1,
    offered: tuple[Point, ...] = (),
    room: TracerDesignSettings | None = None,
    least_redundancy: float = LEAST_REDUNDANCY,
    progress: Progress | None = None,
) -> CheckPlan:
    """Choose the fewest lengths that check ``earlier`` at each ``every``-th of its angles.

    ``earlier`` is a curve of ECC, rad. The tracer stands where the simulation of ``configuration``
    mounts it; its ``solver`` states the noise. The reflector may go to places ``offered`` (m), to
    the volume of ``room``, or to the targets of the configuration's block; with a ``room`` only
    to those with a free beam from all angles. Raises ConfigurationError for another method or
    variant and where the error motion is not stated, PlanError where no choice suffices.
    """
    _require_fitting(configuration)
    rows = np.arange(0, len(earlier.angles), every)
    if len(rows) < LEAST_ANGLES:
        raise PlanError(f"{len(rows)} angles to check: a circle needs at least {LEAST_ANGLES}")
    angles = earlier.angles[rows]
    scene = _scene(configuration, angles, _offered(configuration, angles, offered, room))
    expected = rule.expected(earlier.covariance[np.ix_(rows, rows)], without_harmonics(angles, 0))
    found = fewest_lengths(
        scene,
        rule,
        np.sqrt(np.diagonal(expected)),
        one_zero=configuration.solver.zero == "per_segment",
        least_redundancy=least_redundancy,
        progress=progress,
    )
    return _in_order(configuration, rule, scene, found)


def _in_order(
    configuration: Configuration, rule: CheckRule, scene: Scene, found: CheckLengths
) -> CheckPlan:
    """Return the plan of the lengths ``found``, to the targets in use, in their best order."""
    used, target = np.unique(found.lengths.target, return_inverse=True)
    pairs = np.column_stack([found.lengths.position, target])
    solver, angles, targets = configuration.solver, scene.table_angles, scene.targets[used]
    unseen = SequenceForecast(
        noisy_problem(
            scene, found.lengths, one_zero=solver.zero == "per_segment", seed=SEED,
            slip=solver.slip_m, limits=solver,
        )
    )  # fmt: skip
    costs = cell_time(configuration).costs(angles, targets, pairs[:, 0], pairs[:, 1])
    order = least_hidden(measuring_orders(pairs[:, 0], pairs[:, 1], costs, unseen))
    return CheckPlan(
        configuration=configuration,
        rule=rule,
        angles=angles,
        targets=targets,
        pairs=pairs[order.order],
        std=found.std,
        acceptance=rule.acceptance(found.std),
        assurance=found.assurance,
        least_redundancy=found.least_redundancy,
        offered=len(angles) * len(scene.targets),
        seconds=order.seconds,
        unseen=unseen(order.order),
    )


def _offered(
    configuration: Configuration,
    angles: Floats,
    listed: tuple[Point, ...],
    room: TracerDesignSettings | None,
) -> Floats:
    """Return the places (n, 3) of the reflector that are offered, m."""
    if room is None:
        return np.array(listed or configuration.plan.block)
    room = replace(
        room,
        table_angles_deg=tuple((angles / DEGREE).tolist()),
        mount_m=configuration.simulation.tracer.mount_m,
    )
    scene = make_scene(room, listed or None)
    seen = np.bincount(candidates(scene, room).target, minlength=len(scene.targets))
    places = np.asarray(scene.targets[seen == len(angles)], dtype=np.float64)
    if not len(places):
        raise PlanError(
            f"no target has a free beam from all {len(angles)} angles: see keep_out_m, "
            "blocked_azimuth_deg, min_elevation_deg, or check fewer angles"
        )
    return places


def _scene(configuration: Configuration, angles: Floats, offered: Floats) -> Scene:
    """Return the stations at ``angles`` (m,) rad, the targets offered, and the stated noise."""
    solver = configuration.solver
    return Scene(
        stations=positions_on_table(configuration.simulation.tracer.mount_m, angles),
        table_angles=angles,
        targets=offered,
        target_std=solver.target_std_m,
        length_std=solver.length_std_m,
        length_std_relative=solver.length_std_relative,
        circle_std=solver.circle_std_m,
        error_motion_std=solver.error_motion_std_m,
    )


def _require_fitting(configuration: Configuration) -> None:
    """Raise ConfigurationError unless what is planned is what will be solved."""
    solver, source = configuration.solver, configuration.source
    if configuration.method.name != METHOD:
        raise ConfigurationError(
            f"{source}: a quick check is planned for the methods {METHOD} and ball_plate, not for "
            f"{configuration.method.name}: judge any new result by `rotcal check`"
        )
    if (solver.variant, solver.datum) != ("joint", "prior"):
        raise ConfigurationError(
            f"{source}: solver: a quick check is planned for the variant joint with the datum "
            f"prior, found {solver.variant} and {solver.datum}: set both"
        )
    if solver.error_motion_std_m is None:
        raise ConfigurationError(
            f"{source}: solver.error_motion_std_m is absent, so the few stations of a quick check "
            "would have to determine it: state what the full calibration has found"
        )
