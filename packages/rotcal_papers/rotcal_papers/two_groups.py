"""The paper on two groups: the closed form, half of the balls, and an autocollimator beside it.

The words stand in ``templates/two_groups.yaml``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from rotcal_papers.reproduction import PrintedTable, Reproduction
from rotcal_papers.simulated_plates import (
    PlateMeasurement,
    draw_components,
    largest_expanded,
    true_deviations,
)
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COMPONENTS, COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.methods.ball_plate.solver import closed_form, solve
from rotcal_ros.methods.ball_plate.solver.layout import PlateLayout
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, grid_angles
from rotcal_ros.methods.figures import Figure

GRID: Final = 12
TWELVE: Final = tuple(range(GRID))
SIX: Final = tuple(range(0, GRID, 2))
REPEATS: Final = 3
"""Times that the plate is set up and measured anew; the paper draws their mean."""
AUTOCOLLIMATOR_STD: Final = 0.1 * ARCSEC
"""Noise of a reading on a calibrated face; the paper states none."""


def reproduce() -> Reproduction:
    """Return the paper's figures and claims, computed again."""
    twelve, six = (measured_means(balls) for balls in (TWELVE, SIX))
    reference = autocollimator_readings()
    values = _values(twelve, six, reference)
    curves = {"12 balls": curve_of(twelve), "6 balls in two groups": curve_of(six)}
    return Reproduction.of(
        "two_groups", values, _tables(twelve, six, reference), _figures(curves, reference)
    )


def make_problems(balls: tuple[int, ...]) -> list[BallPlateProblem]:
    """Return the repeated measurements with these ``balls``, each newly set up."""
    return [
        PlateMeasurement(GRID, balls, seed=100 * len(balls) + k).problem(separate_groups=True)
        for k in range(REPEATS)
    ]


def measured_means(balls: tuple[int, ...]) -> list[Result]:
    """Return the results of the repeats."""
    return [solve(problem) for problem in make_problems(balls)]


def mean_of(results: list[Result], name: str) -> Floats:
    """Return the mean (n,) of a component over the repeats."""
    return np.asarray(np.mean([result.deviations[name] for result in results], axis=0))


def curve_of(results: list[Result]) -> tuple[Floats, dict[str, Floats]]:
    """Return the angles and the mean of each component."""
    return results[0].angles, {name: mean_of(results, name) for name in COMPONENTS}


def autocollimator_readings() -> Floats:
    """Return what an autocollimator reads of the table (n,), rad, on calibrated faces."""
    rng = np.random.default_rng(24)
    truth = true_deviations(grid_angles(GRID))["ECC"]
    return np.asarray(truth + AUTOCOLLIMATOR_STD * rng.standard_normal(GRID))


def _values(twelve: list[Result], six: list[Result], reference: Floats) -> dict[str, float]:
    def apart(*names: str) -> float:
        return max(
            float(np.abs(mean_of(twelve, name) - mean_of(six, name)).max()) for name in names
        )

    curve = mean_of(six, "ECC")
    off = reference - mean_of(twelve, "ECC")
    u_off = COVERAGE_FACTOR * np.hypot(
        AUTOCOLLIMATOR_STD, twelve[0].std["ECC"].max() / np.sqrt(REPEATS)
    )
    values = {
        "centres_twelve": GRID * GRID,
        "centres_six": GRID * len(SIX),
        "xy_um": apart("EXC", "EYC") / MICROMETRE,
        "z_um": apart("EZC") / MICROMETRE,
        "tilt_x_arcsec": apart("EAC") / ARCSEC,
        "tilt_y_arcsec": apart("EBC") / ARCSEC,
        "ecc_arcsec": apart("ECC") / ARCSEC,
        "exact_xy_um": group_bias() / MICROMETRE,
        "plane_variance": variance_ratio("EXC"),
        "axial_variance": variance_ratio("ECC"),
        "closed_form_apart": closed_form_apart(make_problems(TWELVE)[0]),
        "radius_share": radius_share(make_problems(TWELVE)[0]),
        "reference_arcsec": float(np.abs(off - off.mean()).max()) / ARCSEC,
        "u_reference_arcsec": u_off / ARCSEC,
        "en_printed": 3.9 * ARCSEC / u_off,
        "offset_arcsec": float(curve[::2].mean() - curve[1::2].mean()) / ARCSEC,
        "lost_z_um": unseen_group_offset("EZC") / MICROMETRE,
    }
    return {name: float(value) for name, value in values.items()}


def closed_form_apart(problem: BallPlateProblem) -> float:
    """Return by how much Eq. 1 to 12 differ from linear least squares at most, relatively."""
    means = closed_form(problem, nominal_radius=True)
    found = np.hstack([means.translation, means.rotation]).T
    expected = PlateLayout(problem).linear(problem.deviations).reshape(found.shape)
    return float((np.abs(found - expected).max(axis=1) / np.abs(expected).max(axis=1)).max())


def radius_share(problem: BallPlateProblem) -> float:
    """Return by which share the mean measured radius of Eq. 12 differs from the nominal one."""
    return abs(closed_form(problem).radius / problem.radius - 1.0)


def variance_ratio(name: str) -> float:
    """Return how many times the variance within a group is that with all balls, by the layouts."""
    of_group, of_whole = (
        closed_form(PlateMeasurement(count, tuple(range(count)), seed=1).problem()).unit_std
        for count in (GRID // 2, GRID)
    )
    return float((of_group / of_whole)[COMPONENTS.index(name)] ** 2)


def group_bias() -> float:
    """Return by how much groups differ from the whole in EXC and EYC without any noise, m."""
    whole, groups = (
        solve(PlateMeasurement(GRID, balls, seed=1, noisy=False).problem(separate_groups=True))
        for balls in (TWELVE, SIX)
    )
    return max(
        float(np.abs(whole.deviations[name] - groups.deviations[name]).max())
        for name in ("EXC", "EYC")
    )


def unseen_group_offset(name: str) -> float:
    """Return the true offset between even and odd positions, which no group of balls shows."""
    truth = true_deviations(grid_angles(GRID))[name]
    return abs(float(truth[::2].mean() - truth[1::2].mean()))


def _tables(twelve: list[Result], six: list[Result], reference: Floats) -> Iterator[PrintedTable]:
    units = [(name, *unit_of(name)) for name in COMPONENTS]
    yield PrintedTable.of(
        "Largest U (k = 2) of the mean of three measurements",
        ("balls", *(f"{name} / {unit}" for name, _, unit in units)),
        ("", *([".3f"] * 6)),
        [
            (words, *(largest_expanded(r[0])[n] / np.sqrt(REPEATS) / f for n, f, _ in units))
            for words, r in (("12", twelve), ("6, within a group", six))
        ],
    )
    curves = [mean_of(results, "ECC") / ARCSEC for results in (twelve, six)]
    yield PrintedTable.of(
        "Fig. 10: crz by the plate and by the autocollimator, arcsec (SIMULATED)",
        ("angle / °", "12 balls", "6 balls", "autocollimator"),
        (".0f", ".2f", ".2f", ".2f"),
        np.column_stack([np.degrees(grid_angles(GRID)), *curves, reference / ARCSEC]),
    )


def _figures(
    curves: Mapping[str, tuple[Floats, Mapping[str, Floats]]], reference: Floats
) -> tuple[Figure, ...]:
    angles = grid_angles(GRID)
    truth = {"injected": (angles, true_deviations(angles))}
    simulated = "SIMULATED: the paper prints no measurement. Means of three, newly set up."
    return (
        Figure(
            "Fig. 7: translations",
            simulated,
            draw_components({**curves, **truth}, ("EXC", "EYC", "EZC")),
        ),
        Figure(
            "Fig. 8: rotations",
            simulated,
            draw_components({**curves, **truth}, ("EAC", "EBC", "ECC")),
        ),
        Figure(
            "Fig. 10: positioning beside the autocollimator",
            "SIMULATED, with an assumed 0.1″ per reading. What the two methods differ by here is "
            "noise; in the paper it is 3.9″.",
            draw_components({**curves, "autocollimator": (angles, {"ECC": reference})}, ("ECC",)),
        ),
    )
