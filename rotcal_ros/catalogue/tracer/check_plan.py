"""The plan of a quick check by laser tracer: from a configuration and an earlier curve."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.catalogue.configuration import Configuration, replaced
from rotcal_ros.catalogue.tracer.plan import LEAST_ANGLES, block_of_targets
from rotcal_ros.catalogue.tracer.plan_tables import write_pairs, write_targets
from rotcal_ros.catalogue.tracer.timing import cell_time
from rotcal_ros.curves.interpolation import without_harmonics
from rotcal_ros.curves.measured import MeasuredCurve
from rotcal_ros.errors import ConfigurationError, PlanError
from rotcal_ros.files import write_atomically
from rotcal_ros.methods.tracer.problem import TracerProblem
from rotcal_ros.methods.tracer.solve import METHOD
from rotcal_ros.planning.check_rule import CheckRule
from rotcal_ros.planning.plan import Point
from rotcal_ros.planning.sequence_choice import MeasuringOrder, measuring_orders
from rotcal_ros.planning.sequence_forecast import Forecast, OrderForecast
from rotcal_ros.planning.tracer_design.check_lengths import (
    LEAST_REDUNDANCY,
    Progress,
    fewest_lengths,
)
from rotcal_ros.planning.tracer_design.scene import Scene, on_table
from rotcal_ros.protection import TOLERABLE
from rotcal_ros.units import DEGREE

CONFIGURATION_FILE: Final = "check.yaml"
TARGETS_FILE: Final = "targets.csv"
PAIRS_FILE: Final = "pairs.csv"


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
        folder.mkdir(parents=True, exist_ok=True)
        write_targets(folder / TARGETS_FILE, [_point(target) for target in self.targets])
        write_pairs(folder / PAIRS_FILE, [(int(j), int(i)) for j, i in self.pairs])
        plan = {
            "table_angles_deg": (self.angles / DEGREE).tolist(),
            "targets_file": TARGETS_FILE,
            "pairs_file": PAIRS_FILE,
        }
        path = folder / CONFIGURATION_FILE
        write_atomically(path, replaced(self.configuration, "plan", plan))
        return path


def plan_check(
    configuration: Configuration,
    earlier: MeasuredCurve,
    rule: CheckRule,
    *,
    every: int = 1,
    candidates: tuple[Point, ...] = (),
    least_redundancy: float = LEAST_REDUNDANCY,
    progress: Progress | None = None,
) -> CheckPlan:
    """Choose the fewest lengths that check ``earlier`` at each ``every``-th of its angles.

    ``earlier`` is a curve of ECC, rad. The tracer stands where the simulation of ``configuration``
    mounts it; its ``solver`` states the noise. The reflector may go to ``candidates`` (m), or to
    the targets of the configuration's block. Raises ConfigurationError for another method or
    variant and where the error motion is not stated, PlanError where no choice suffices.
    """
    _require_fitting(configuration)
    rows = np.arange(0, len(earlier.angles), every)
    if len(rows) < LEAST_ANGLES:
        raise PlanError(f"{len(rows)} angles to check: a circle needs at least {LEAST_ANGLES}")
    angles = earlier.angles[rows]
    offered = np.array(candidates or block_of_targets(configuration.plan))
    solver = configuration.solver
    scene = _scene(configuration, angles, offered)
    keep = without_harmonics(angles, 0)
    expected = rule.expected(earlier.covariance[np.ix_(rows, rows)], keep)
    found = fewest_lengths(
        scene,
        rule,
        np.sqrt(np.diagonal(expected)),
        one_zero=solver.zero == "per_segment",
        least_redundancy=least_redundancy,
        progress=progress,
    )
    used, target = np.unique(found.lengths.target, return_inverse=True)
    pairs = np.column_stack([found.lengths.position, target])
    segment = found.lengths.segment if solver.zero == "per_segment" else None
    unseen = OrderForecast(_exact_lengths(scene, offered[used], pairs, segment))
    costs = cell_time(configuration).costs(angles, offered[used], pairs[:, 0], pairs[:, 1])
    order = _order(costs, pairs, unseen)
    return CheckPlan(
        configuration=configuration,
        rule=rule,
        angles=angles,
        targets=offered[used],
        pairs=pairs[order.order],
        std=found.std,
        acceptance=rule.acceptance(found.std),
        assurance=found.assurance,
        least_redundancy=found.least_redundancy,
        offered=len(angles) * len(offered),
        seconds=order.seconds,
        unseen=unseen(order.order),
    )


def _scene(configuration: Configuration, angles: Floats, offered: Floats) -> Scene:
    """Return the stations at ``angles`` (m,) rad, the targets offered, and the stated noise."""
    solver = configuration.solver
    return Scene(
        stations=on_table(configuration.simulation.tracer.mount_m, angles),
        table_angles=angles,
        targets=offered,
        target_std=solver.target_std_m,
        length_std=solver.length_std_m,
        length_std_relative=solver.length_std_relative,
        error_motion_std=solver.error_motion_std_m,
    )


def _require_fitting(configuration: Configuration) -> None:
    """Raise ConfigurationError unless what is planned is what will be solved."""
    solver, source = configuration.solver, configuration.source
    if configuration.method.name != METHOD:
        raise ConfigurationError(
            f"{source}: a quick check is planned for the method {METHOD}, not for "
            f"{configuration.method.name}"
        )
    if (solver.variant, solver.datum) != ("joint", "prior"):
        raise ConfigurationError(
            f"{source}: solver: a quick check is planned for the variant joint with the datum "
            f"prior, found {solver.variant} and {solver.datum}"
        )
    if solver.error_motion_std_m is None:
        raise ConfigurationError(
            f"{source}: solver.error_motion_std_m is absent, so the few stations of a quick check "
            "would have to tell it: state what the full calibration has found"
        )


def _exact_lengths(
    scene: Scene, targets: Floats, pairs: Ints, segment: Ints | None
) -> TracerProblem:
    """Return the lengths of ``pairs`` (k, 2) as a problem without any error."""
    position, target = pairs.T
    distance = np.linalg.norm(scene.stations[position] - targets[target], axis=1)
    return TracerProblem(
        position=position,
        target=target,
        length=distance,
        length_std=np.hypot(scene.length_std, scene.length_std_relative * distance),
        targets=targets,
        target_std=np.broadcast_to(scene.target_std[0], targets.shape),
        table_angles=scene.table_angles,
        error_motion_std=scene.error_motion_std,
        start_stations=scene.stations,
        segment=segment,
    )


def _order(costs: Floats, pairs: Ints, forecast: OrderForecast) -> MeasuringOrder:
    """Return the quickest order that shows drift and knock, else the one that hides least."""

    def badness(way: MeasuringOrder) -> tuple[float, float]:
        unseen = way.forecast or forecast(way.order)
        return max(unseen.drift, unseen.knock, TOLERABLE), way.seconds

    return min(measuring_orders(pairs[:, 0], pairs[:, 1], costs, forecast), key=badness)


def _point(target: Floats) -> Point:
    x, y, z = target.tolist()
    return x, y, z
