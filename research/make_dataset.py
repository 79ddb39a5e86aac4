#!/usr/bin/env python3
"""Make the open data set: simulated calibrations of one table, each effect switched on in turn.

    python research/make_dataset.py out/dataset --page docs/data_set.md

The folder must not exist yet. Without --method and --effect all of them. What each file holds says
the README.md that is written along; its text and the plans are in research/data_set.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from itertools import product
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "examples" / "data"))
sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
from make_bag import START_NS, write_bag
from plain_solvers import ENTRIES
from threadpoolctl import threadpool_limits

import rotcal_ros as rc
from rotcal_ros.evaluation.truth_scores import (
    FORMATS,
    HEADINGS,
    NO_EFFECT,
    Score,
    leaderboard,
    score_folder,
)
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods import Method, changed, prepare
from rotcal_ros.methods.disturbance import Disturbance
from rotcal_ros.methods.simulated_run import disturb_events, simulated_run, visible_truth
from rotcal_ros.recordings.replay import Recording

HERE = Path(__file__).parent / "data_set"
SIZES: Mapping[str, Mapping[str, float]] = {
    "tracer": {
        "drift": 14.0, "knock": 2.1, "axis noise": 3.0, "error motion": 1.0,
        "repeatability": 3.5, "refraction": 26.0, "scale": 10.0, "tilt": 1.4, "gauge": 300.0,
        "tangential motion": 2.0, "one place": 2.0,
    },
    "tracer_six": {
        "drift": 0.6, "knock": 0.9, "axis noise": 5.0, "error motion": 1.0,
        "repeatability": 0.5, "refraction": 10.0, "scale": 13.0, "tilt": 1.0, "gauge": 300.0,
        "tangential motion": 1.0, "one place": 1.0,
    },
    "ball_plate": {
        "drift": 0.2, "knock": 0.1, "axis noise": 3.0, "error motion": 1.0,
        "repeatability": 0.1, "refraction": 1000.0, "scale": 20.0, "tilt": 1.0, "gauge": 50.0,
        "one place": 0.6,
    },
    "plane_mirror": {
        "drift": 2.6, "knock": 8.0, "axis noise": 1.5, "error motion": 10.0,
        "repeatability": 5.0, "refraction": 7.0, "scale": 100.0, "tilt": 0.3, "gauge": 300.0,
        "uneven drift": 0.5, "one place": 100.0,
    },
}  # fmt: skip
"""Plan -> effect -> its size, in the unit in which the method lists it."""
MEASURED = {"tracer": ("ECC",), "plane_mirror": ("ECC",)}
"""Plan -> the components that its method measures, where these are not all six."""
BOARD = HERE.parent / "figures" / "leaderboard.csv"
"""The leaderboard of the page, which `make docs` shows there."""
SUMS = "SHA256SUMS"
CASES = 100
"""Seeds from one measurement of a case to the next; every case has noise of its own."""
PAPERS = {
    "tracer": "solver.variant=station",
    "ball_plate": "solver.variant=closed_form",
    "plane_mirror": "solver.way=registration",
}
"""Plan -> the change that makes of our solver what the paper prints; papers give no verdict."""
LEGEND = """\
* *rotcal*: this package; *scipy*: least squares on the plain equations; *closed_form*: linear
  equations only; *paper*: the recipe that the paper prints, without a verdict.
* A *curve* is one component of one measurement. *rms* is over all cases, *plain rms* over those
  with nothing wrong.
* *say ok*: curves whose result says ok, or says nothing. *hold*: their intervals (U, k = 2) that
  hold the truth, where 95.4 % should, without curves that name the effect.
* *mislead*: they say ok, name no reason, and more intervals fail than chance explains (one sound
  curve of a hundred does). *named*: the same, but the verdict line names the effect.
* *alarms*: not ok, and right.

The plain equations of the ball plate know no axis that leans: *scipy* pays for it in the case
gauge."""


def main() -> int:
    """Make the folder, and the leaderboard of the page if one is given."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, nargs="?", default=Path("out/dataset"))
    parser.add_argument("--method", choices=[*SIZES], action="append", help="default: all")
    parser.add_argument("--effect", action="append", help=f"{NO_EFFECT}, drift, ...; default: all")
    parser.add_argument("--seeds", type=int, default=1, help="measurements of each case")
    parser.add_argument("--page", type=Path, help="page whose part Leaderboard is written anew")
    chosen = parser.parse_args()
    make(chosen.folder, chosen.method or [*SIZES], chosen.effect, range(1, chosen.seeds + 1))
    if chosen.page is not None:
        text = chosen.page.read_text(encoding="utf-8")
        head, _, _ = text.partition("## Leaderboard\n")
        scores = score_folder(chosen.folder)
        write_rows(BOARD, HEADINGS, board(scores))
        link = os.path.relpath(BOARD, chosen.page.parent)
        words = claims(scores)
        write_atomically(chosen.page, f"{head}## Leaderboard\n\n[Leaderboard]({link})\n\n{words}")
    return 0


def make(
    folder: Path, plans: Sequence[str], effects: Sequence[str] | None, seeds: Iterable[int]
) -> None:
    """Write the data set of some ``plans`` and ``effects`` into a new ``folder``."""
    folder.mkdir(parents=True)
    for plan, seed in product(plans, seeds):
        bench = Bench(plan, seed)
        for number, (effect, size) in enumerate({NO_EFFECT: 0.0, **SIZES[plan]}.items()):
            if effects is None or effect in effects:
                case = folder / plan / f"{effect.replace(' ', '_')}_{seed}"
                print(case.relative_to(folder), flush=True)
                bench.write(case, effect, size, CASES * seed + number)
    summarise(folder)


def summarise(folder: Path) -> None:
    """Write what all results are worth, the data descriptor, and the checksums."""
    scores = score_folder(folder)
    write_rows(folder / "results.csv", [*asdict(scores[0])], (asdict(s).values() for s in scores))
    rows = [row.row for row in leaderboard(scores)]
    write_rows(folder / "leaderboard.csv", HEADINGS, rows)
    write_readme(folder, scores)
    (folder / SUMS).unlink(missing_ok=True)
    sums = [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(folder)}\n"
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    ]
    write_atomically(folder / SUMS, "".join(sums))


class Bench:
    """One plan, and a run of it without error whose readings scatter by ``seed``."""

    def __init__(self, plan: str, seed: int) -> None:
        configuration = rc.read_configuration(HERE / f"{plan}.yaml", f"simulation.seed={seed}")
        self.plan, self.calibration = plan, prepare(configuration)
        events = simulated_run(self.calibration, START_NS)
        self.events = sorted(events, key=lambda event: event.time_ns)

    def write(self, case: Path, effect: str, size: float, noise: int) -> None:
        """Write one measurement, ``noise`` its seed: bag, tables, set-up, truth and results."""
        calibration, configuration = self.calibration, self.calibration.configuration
        what = disturbances_of(calibration.method).get(effect)
        sizes = {} if what is None else {what.effect: size * what.unit_si}
        measured = calibration.measured(sizes, noise)
        events = disturb_events(self.events, calibration, measured)
        case.mkdir(parents=True)
        write_bag(case / "bag", configuration, ((event.time_ns, event.what) for event in events))
        recording = rc.read_bag(case / "bag")
        write_tables(case, calibration.method.name, recording.observations)
        write_atomically(case / "setup.yaml", configuration.text)
        true, measures = visible_truth(calibration, measured), MEASURED.get(self.plan, COMPONENTS)
        truth = {
            "schema": 1,
            "method": calibration.method.name,
            "angles_rad": list(calibration.plan.distinct_angles),
            "deviations": {name: true[name].tolist() for name in measures},
            "effect": effect,
            "size": size,
            "unit": "" if what is None else what.unit,
            "what": "" if what is None else what.what,
            "seed": noise,
        }
        write_json(case / "truth.json", truth)
        for name, solve in solvers(case, self.plan, recording).items():
            write_result(case / f"result_{name}.json", solve)


def write_result(path: Path, solve: Callable[[], Mapping[str, Any]]) -> None:
    """Write what a solver finds; nothing where it finds no way."""
    try:
        with threadpool_limits(1, "blas"):  # else the last bits depend on the cores
            write_json(path, solve())
    except (RotcalError, np.linalg.LinAlgError) as error:
        print(f"no {path}: {error}", file=sys.stderr)


def solvers(
    case: Path, plan: str, recording: Recording
) -> dict[str, Callable[[], Mapping[str, Any]]]:
    """Return the solvers of one measurement by name."""

    def ours(*changes: str) -> Result:
        calibration = prepare(changed(recording.configuration, changes))
        return calibration.solve(recording.observations)

    found: dict[str, Callable[[], Mapping[str, Any]]] = {
        "rotcal": lambda: slim(ours(), "verdict", "verdict_line", "warnings", "not_protected")
    }
    if plan in PAPERS:
        found["paper"] = lambda: slim(ours(PAPERS[plan]))
    plain = ENTRIES[recording.configuration.method.name]
    return found | {name: partial(solve, case) for name, solve in plain.items()}


def slim(result: Result, *also: str) -> dict[str, Any]:
    """Return the entries of a result that are needed, and others."""
    whole = result.to_dict()
    needed = ("method", "angles_rad", "deviations", "std", "covariance")
    return {name: whole[name] for name in (*needed, *also)}


def write_tables(case: Path, method: str, observations: Sequence[Observation]) -> None:
    """Write the plain tables of docs/formats.md."""
    used = [o for o in observations if o.accepted]
    rows: list[tuple[Any, ...]]
    if method == "plane_mirror":
        rows = [(_position(o), o.station, o.kind.name.lower(), o.target, *o.mean) for o in used]
        write_lengths(case / "tracker.csv", "position,tracker_station,kind,nest,x_m,y_m,z_m", rows)
        return
    if method == "ball_plate":
        rows = [(o.table_position, o.target, *o.mean) for o in used]
        write_lengths(case / "balls.csv", "position,ball_step,x_m,y_m,z_m", rows)
        return
    if method == "tracer_six":
        rows = [(o.station, o.table_position, o.target, *o.mean, o.segment) for o in used]
        write_lengths(case / "lengths.csv", "place,position,target,length_m,segment", rows)
    else:
        rows = [(o.table_position, o.target, *o.mean) for o in used]
        write_lengths(case / "lengths.csv", "position,target,length_m", rows)
    targets = sorted({(o.target, *o.probe_position) for o in used})
    write_lengths(case / "targets.csv", "target,x_m,y_m,z_m", targets)


def _position(observation: Observation) -> int | str:
    return "" if observation.kind is PointKind.NEST else observation.table_position


def write_lengths(path: Path, header: str, rows: Iterable[Iterable[Any]]) -> None:
    """Write a table with lengths to 0.1 nm."""
    shown = ([f"{x:.10f}" if isinstance(x, float) else x for x in row] for row in rows)
    write_rows(path, header.split(","), shown)


def write_rows(path: Path, header: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a table, numbers with all digits."""
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file."""
    write_atomically(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def write_readme(folder: Path, scores: Sequence[Score]) -> None:
    """Write the data descriptor."""
    text = (HERE / "README.md.in").read_text(encoding="utf-8")
    bags = list(folder.rglob("*.mcap"))
    size = sum(bag.stat().st_size for bag in bags)
    rate = rc.read_configuration(HERE / "tracer.yaml").simulation.tracer.rate_hz
    text = text.format(
        version=rc.__version__,
        sizes=f"{len(bags)} bags, {size / 1e6:.1f} MB of them.",
        tracer_hz=rate,
        effects=effects_in_words(),
        found="\n\n".join([in_markdown([HEADINGS, *board(scores)]), claims(scores)]),
    )
    write_atomically(folder / "README.md", text)


def disturbances_of(method: Method) -> dict[str, Disturbance]:
    """Return the effects that a method lists, by name."""
    assert method.disturbances is not None
    return {disturbance.effect: disturbance for disturbance in method.disturbances.listed}


def effects_in_words() -> str:
    """Return what happens in each case, and how large it is."""
    lines = ["| method | case | size | what |", "| --- | --- | --- | --- |"]
    for plan, sizes in SIZES.items():
        listed = disturbances_of(rc.read_configuration(HERE / f"{plan}.yaml").method)
        lines += [
            f"| {plan} | {effect.replace(' ', '_')} | {size:g} {listed[effect].unit} | "
            f"{listed[effect].what} |"
            for effect, size in sizes.items()
        ]
    return "\n".join(lines)


def board(scores: Sequence[Score]) -> list[list[str]]:
    """Return the rows of the leaderboard as they are printed."""
    return [
        [format(x, f) if x is not None else "" for x, f in zip(row.row, FORMATS, strict=True)]
        for row in leaderboard(scores)
    ]


def in_markdown(rows: Sequence[Sequence[str]]) -> str:
    """Return a table, its head first."""
    head, *others = rows
    return "\n".join(f"| {' | '.join(row)} |" for row in [head, ["---"] * len(head), *others])


def claims(scores: Sequence[Score]) -> str:
    """Return the legend, and what misleads."""
    own = [s for s in scores if s.entry == "rotcal" and s.says_ok]
    silent = [s for s in own if not s.named]
    beyond = sum(s.held < s.n for s in silent)
    words = (
        f"*rotcal* says ok of {len(silent)} curves without naming the effect. {beyond} of them "
        "are off by more than U at some angle, where chance alone makes 43 % of sound curves of "
        "12 angles so. Beyond chance are, with the effect named or not:"
    )
    wrong = [fill(f"* {s.describe()}", 98, subsequent_indent="  ") for s in own if not s.agree]
    listed = "\n".join(wrong) or "* none"
    return f"{LEGEND}\n\n{fill(words, 98)}\n\n{listed}\n"


if __name__ == "__main__":
    sys.exit(main())
