#!/usr/bin/env python3
"""Errors that gather in one place: how often is the verdict ok although they spoil it.

    python research/gathered_table.py --runs 100

Worlds are drawn by plain geometry that shares no code with solvers and simulation
(test/methods/gathered_worlds.py, plate_disturbed.py, benchmarks/six_scene.py). Each is solved with
and without the disturbance, with the same noise. The tables of the page, between two marks, are
written again.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / part) for part in ("test/methods", "benchmarks", "research")]

import gathered_worlds as worlds  # noqa: E402
import plate_disturbed as plates  # noqa: E402
import six_scene  # noqa: E402

from rotcal_ros.foundation.arrays import Floats  # noqa: E402
from rotcal_ros.foundation.components import COMPONENTS  # noqa: E402
from rotcal_ros.foundation.errors import DataError  # noqa: E402
from rotcal_ros.foundation.observations import PointKind  # noqa: E402
from rotcal_ros.foundation.results import Result  # noqa: E402
from rotcal_ros.foundation.units import MICROMETRE  # noqa: E402
from rotcal_ros.methods.ball_plate import solver as ball_plate  # noqa: E402
from rotcal_ros.methods.plane_mirror import solver as plane_mirror  # noqa: E402
from rotcal_ros.methods.tracer import solver as tracer  # noqa: E402
from rotcal_ros.methods.tracer_six import solver as tracer_six  # noqa: E402

SIZES_UM = (0.3, 0.6, 0.8, 1.0, 1.5, 2.0, 3.0, 5.0)
SIZES_STD = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 10.0, 20.0)
"""Of what the mirror shows: in standard deviations of a reading across the beam."""
SIZES_PLATE_UM = (0.3, 0.5, 1.0)
LIMIT = 2.5
FIGURES = ROOT / "research" / "figures"


class Seen(NamedTuple):
    """What of a result is compared."""

    verdict: str
    deviations: dict[str, Floats]
    std: dict[str, Floats]


class Case(NamedTuple):
    """What is disturbed: ``name`` for people, and the two results of a size and a number.

    None: refused. Then the truth, as :func:`_curves` has it.
    """

    name: str
    solved: Callable[[float, int], tuple[Result | Seen | None, Result | Seen | None, Floats]]


def main() -> int:
    """Draw, solve, write the section."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=100, help="worlds of each size")
    parser.add_argument("--six-runs", type=int, default=20, help="the same, of six deviations")
    parser.add_argument("--cases", default="", help="only those whose name holds this")
    chosen = parser.parse_args()
    of_lengths = [case for case in cases() if chosen.cases in case.name]
    of_plate = [case for case in plate_cases() if chosen.cases in case.name]
    of_mirror = [case for case in mirror_cases() if chosen.cases in case.name]
    write("tracer", "zero, pattern", "um", SIZES_UM, of_lengths, chosen)
    write("ball_plate", "displaced", "um", SIZES_PLATE_UM, of_plate, chosen)
    write("plane_mirror", "place, pattern", "std", SIZES_STD, of_mirror, chosen)
    return 0


def write(
    method: str,
    first: str,
    unit: str,
    sizes: tuple[float, ...],
    chosen_cases: list[Case],
    chosen: argparse.Namespace,
) -> None:
    """Measure the cases and write the table of ``method``, where there are any."""
    if not chosen_cases:
        return
    rows = [[first, "worlds", "none", *(f"{size:g} {unit}" for size in sizes)]]
    scale = MICROMETRE if unit == "um" else 1.0
    for case in chosen_cases:
        runs = chosen.six_runs if case.name.startswith("six") else chosen.runs
        cells = [_sound(case, runs), *(_cell(case, size * scale, runs) for size in sizes)]
        rows.append([case.name, str(runs), *cells])
        print(" | ".join(rows[-1]), flush=True)
    with (FIGURES / f"gathered_{method}.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def cases() -> Iterator[Case]:
    """Return what is tried, in the order of the table."""
    for one_zero in (False, True):
        zero = "one zero" if one_zero else "own zeros"
        for name, options in {
            "sector": {},
            "sector, 0.5 to 1.5 times": {"spread": 0.5},
            "random subset": {"pattern": "random"},
            "every other beam": {"pattern": "half"},
            "sector, 16 of 48": {"n": 48},
        }.items():
            yield Case(f"{zero}, {name}", _tracer(one_zero, options))
    for zero in ("per_station", "per_run"):
        for pattern in ("sector", "random", "half"):
            yield Case(f"six deviations, {zero}, {pattern}", _six(zero, pattern))


def plate_cases() -> Iterator[Case]:
    """Return what is tried with a plate: some of eight balls at one position."""
    for count, pattern in (
        (2, "neighbours"),
        (2, "any"),
        (3, "neighbours"),
        (3, "any"),
        (4, "any"),
    ):
        yield Case(f"{count} of 8, {pattern}", _plate(count, pattern))


def _plate(count: int, pattern: str) -> Callable[[float, int], tuple]:
    """Return what solves a plate, seen at the position: of all 216 numbers one stands out."""

    def solve(size: float, number: int) -> tuple[Seen | None, Floats]:
        rng = np.random.default_rng([number, count])
        at, first = int(rng.integers(36)), int(rng.integers(8))
        which = [plates.EIGHT[(first + k) % 8] for k in range(count)]
        if pattern == "any":
            which = rng.choice(plates.EIGHT, count, replace=False)
        problem, truth = plates.at_one_place(number, which, size, at)
        curves = np.array([truth.component(name)[at : at + 1] for name in COMPONENTS])
        try:
            result = ball_plate.solve(problem)
        except DataError:
            return None, curves
        deviations = {name: result.deviations[name][at : at + 1] for name in COMPONENTS}
        std = {name: result.std[name][at : at + 1] for name in COMPONENTS}
        return Seen(result.verdict, deviations, std), curves

    @cache
    def sound(number: int) -> tuple[Seen | None, Floats]:
        return solve(0.0, number)

    def solved(size: float, number: int) -> tuple[Seen | None, Seen | None, Floats]:
        plain, truth = sound(number)
        return plain, solve(size, number)[0] if size else plain, truth

    return solved


def mirror_cases() -> Iterator[Case]:
    """Return what is tried with a mirror: half of six reflectors at one place, seen aside."""
    for place in ("position", "station"):
        for pattern in worlds.PATTERNS:
            yield Case(f"mirror, one {place}, {pattern}", _mirror(place, pattern))


def _mirror(place: str, pattern: str) -> Callable[[float, int], tuple]:
    kinds = {
        worlds.DIRECT: PointKind.DIRECT,
        worlds.MIRRORED: PointKind.MIRRORED,
        worlds.NEST: PointKind.NEST,
    }

    def solve(here: worlds.MirrorWorld, points: Floats) -> Result | None:
        position, station, kind, nest = here.rows.T
        problem = plane_mirror.PlaneMirrorProblem(
            angles=here.angles,
            position=position,
            station=station,
            kind=np.array([int(kinds[k]) for k in kind.tolist()]),
            nest=nest,
            xyz=points,
            uneven_drift_std=0.0,
        )
        try:
            return plane_mirror.solve(problem)
        except DataError:
            return None  # refused: nobody is misled

    @cache
    def sound(number: int) -> Result | None:
        here = worlds.mirror_world(number, pattern, place=place)
        return solve(here, here.sound)

    def solved(size: float, number: int) -> tuple[Result | None, Result | None, Floats]:
        here = worlds.mirror_world(number, pattern, size, place=place)
        plain = sound(number)
        return plain, solve(here, here.disturbed) if size else plain, here.truth[None]

    return solved


def _tracer(one_zero: bool, options: dict) -> Callable[[float, int], tuple]:
    def solve(here: worlds.World, lengths: Floats) -> Result:
        position, target = np.divmod(np.arange(lengths.size), lengths.shape[1])
        return tracer.solve(
            tracer.TracerProblem(
                position=position,
                target=target,
                length=lengths.ravel(),
                length_std=worlds.NOISE,
                targets=here.targets,
                target_std=worlds.TARGET_STD,
                table_angles=here.angles,
                segment=np.zeros(lengths.size, dtype=int) if one_zero else None,
                error_motion_std=0.0,
                variant="joint",
            )
        )

    @cache
    def sound(number: int) -> Result:
        here = worlds.world(number, one_zero=one_zero, **options)
        return solve(here, here.sound)

    def solved(size: float, number: int) -> tuple[Result, Result, Floats]:
        here = worlds.world(number, size=size, one_zero=one_zero, **options)
        plain = sound(number)
        other = solve(here, here.disturbed) if size else plain
        return plain, other, here.truth[None]

    return solved


def _six(zero: str, pattern: str) -> Callable[[float, int], tuple]:
    def solve(rows: dict, length: Floats) -> Result:
        known = {"scatter_translation_std": 0.0, "scatter_rotation_std": 0.0}
        return tracer_six.solve(tracer_six.SixProblem(**{**rows, "length": length}, **known))

    @cache
    def sound(number: int) -> Result:
        rows = six_scene.scene(np.random.default_rng(number), m=12, zero=zero).rows
        return solve(rows, rows["length"])

    def solved(size: float, number: int) -> tuple[Result, Result, Floats]:
        rng = np.random.default_rng(number)
        truth = six_scene.scene(rng, m=12, zero=zero)
        rows = truth.rows
        station = rows["place"] * 12 + rows["position"]
        mine = np.flatnonzero(station == rng.integers(station.max() + 1))
        angle, place = rows["table_angles"][rows["position"][mine[0]]], rows["place"][mine[0]]
        x, y, z = rows["places"][place]
        stands = np.array(
            [np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, z]
        )
        beams = rows["targets"][rows["target"][mine]] - stands
        disturbed = rows["length"].copy()
        disturbed[mine[worlds.chosen(pattern, 2 * len(mine) // 5, beams, rng)]] += size
        plain = sound(number)
        other = solve(rows, disturbed) if size else plain
        return plain, other, truth.truth

    return solved


def _curves(result: Result | Seen) -> tuple[Floats, Floats]:
    names = [name for name in COMPONENTS if name in result.deviations]
    deviations = np.array([result.deviations[name] for name in names])
    return deviations, np.array([result.std[name] for name in names])


def _worst(error: Floats, std: Floats) -> float:
    felt = std > 0.0
    return float((np.abs(error[felt]) / std[felt]).max())


def _sound(case: Case, runs: int) -> str:
    alarms, beyond = 0, 0
    for number in range(runs):
        result, _, truth = case.solved(0.0, number)
        if result is None:
            alarms += 1
            continue
        deviations, std = _curves(result)
        alarms += result.verdict != "ok"
        beyond += result.verdict == "ok" and _worst(deviations - truth, std) > LIMIT
    return f"{100 * alarms / runs:.0f}/{100 * beyond / runs:.0f}"


def _cell(case: Case, size: float, runs: int) -> str:
    caused, whole = 0, 0
    for number in range(runs):
        sound, result, truth = case.solved(size, number)
        if result is None or sound is None or result.verdict != "ok":
            continue
        deviations, std = _curves(result)
        caused += _worst(deviations - _curves(sound)[0], std) > LIMIT
        whole += _worst(deviations - truth, std) > LIMIT
    return f"{100 * caused / runs:.0f}/{100 * whole / runs:.0f}"


if __name__ == "__main__":
    sys.exit(main())
