#!/usr/bin/env python3
"""Is the new code as true, as watchful and as quick as the old one? Both measured side by side.

    python research/yardstick.py --old main --new HEAD
    python research/yardstick.py --old main --new . --plan tracer --part sound --runs 50

A code is a commit or a folder. Each works in processes of its own, on the same seeds. What was
measured is kept line by line in a file for each code: Ctrl-C loses nothing, and whoever runs the
same again goes on. The exit code is 1 if the new code misses anything.
"""

from __future__ import annotations

import argparse
import sys
import textwrap
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from yardstick_codes import (
    PAPERS,
    PARTS,
    PLANS,
    POWER_PLANS,
    ROOT,
    STARTED,
    TIMED,
    Code,
    Comparison,
    Record,
    of_angles,
    of_size,
    tried,
)

ALARMS, POWER = 0.03, 0.9
LOWEST, HIGHEST, WANTED = 93.0, 97.0, 95.0
HALF_OF_95_PERCENT: Final = 1.96
ERRORS: Final = 3
"""So many unnoticed errors have a root mean square."""
TOLERABLE: Final = 2.0
MISSED, BEFORE, OUTSIDE = "**missed**", "as old", "outside"

Cells = Sequence[tuple[str, ...]]
Found = tuple[tuple[str, ...], Cells, str]
"""A line: what was measured, the cells of each code, the mark."""


def alarms(compared: Comparison) -> Iterator[Found]:
    """Yield how many sound measurements are not ok."""
    for plan in compared.chosen(PLANS):
        found = compared.pairs("sound", plan)
        if runs := len(found[0]):
            counts = [sum(r["verdict"] != "ok" for r in records) for records in found]
            missed = counts[-1] > counts[0] + ALARMS * runs
            yield (plan, f"{runs}"), [(f"{n}",) for n in counts], MISSED * missed


def coverage(compared: Comparison) -> Iterator[Found]:
    """Yield how many of the intervals of each output hold the truth."""
    for plan in compared.chosen(PLANS):
        found = compared.pairs("sound", plan)
        for name in dict.fromkeys(name for r in found[0] for name in r["z"]):
            cells, shares = [], []
            for records in found:
                z = [np.array(r["z"][name]) for r in records if name in r["z"]] or [
                    np.full(1, 9.9)
                ]
                share = np.array([100.0 * np.mean(np.abs(x) <= HALF_OF_95_PERCENT) for x in z])
                shares.append((float(share.mean()), float(share.std()) / len(z) ** 0.5))
                rms = np.sqrt(np.mean(np.concatenate(z) ** 2))
                cells.append((f"{shares[-1][0]:.1f} ± {shares[-1][1]:.1f}", f"{rms:.2f}"))
            yield (plan, name), cells, _covered(*shares)


def _covered(*shares: tuple[float, float]) -> str:
    """Return the mark of shares in percent that lie outside by more than two standard errors."""
    clear = [s + 2.0 * e < LOWEST or s - 2.0 * e > HIGHEST for s, e in shares]
    if len(shares) == 1:
        return OUTSIDE * clear[0]
    (old, _), (new, error) = shares
    farther = abs(new - WANTED) > abs(old - WANTED) + 2.0 * error
    return "" if not clear[1] else BEFORE if clear[0] and not farther else MISSED


def effects(compared: Comparison) -> Iterator[Found]:
    """Yield how often an effect is noticed at the old code's size, and what it does until then."""
    for plan in compared.chosen(POWER_PLANS):
        for found in compared.old.sizes(plan):
            effect = found["case"]
            trials = {
                size: compared.pairs("power", plan, of_size(effect, size)) for size in tried(found)
            }
            if all(records[0] for records in trials.values()):
                limit = "" if found["reached"] else "up to "
                size = f"{limit}{found['tried'] / found['unit_si']:.3g} {found['unit']}"
                yield (plan, effect, size), *_effect(found, trials)


def _effect(found: Record, trials: dict[float, list[list[Record]]]) -> tuple[Cells, str]:
    """Return the cells of an effect, and the mark: noticed, else the error is named or not larger.

    The error is that of the size with most unnoticed trials, in proportion.
    """
    allowed, at = found["allowed"], trials[found["tried"]]
    noticed = [np.mean([r["noticed"] for r in records]) for records in at]
    best = allowed or max(trials, key=lambda size: len(_unnoticed(trials[size][0])))
    scale = (allowed or found["tried"]) / best
    errors = [scale * _largest_rms(_unnoticed(records)) for records in trials[best]]
    named = [records[0]["named"] for records in at]
    bound = TOLERABLE if np.isnan(errors[0]) or len(at) == 1 else 1.1 * errors[0] + 0.05
    mark = ""
    if found["reached"] and noticed[-1] < POWER:
        mark = BEFORE if noticed[-1] >= noticed[0] else MISSED
    if errors[-1] > bound and not named[-1]:
        mark = MISSED
    cells = [
        (f"{100.0 * share:.0f}", "-" if np.isnan(error) else f"{error:.2g}", "yes" * name)
        for share, error, name in zip(noticed, errors, named, strict=True)
    ]
    return cells, OUTSIDE if mark and len(at) == 1 else mark


def _unnoticed(records: list[Record]) -> list[list[float]]:
    return [r["error"] for r in records if not r["noticed"] and r["error"] is not None]


def _largest_rms(errors: list[list[float]]) -> float:
    """Return the largest root mean square over measurements; NaN for too few of them."""
    if len(errors) < ERRORS:
        return np.nan
    return float(np.sqrt(np.mean(np.square(errors), axis=0).max(initial=0.0)))


def times(compared: Comparison) -> Iterator[Found]:
    """Yield processor time and memory of whole solutions."""
    for plan, angles in TIMED:
        if compared.chosen([plan]):
            found = compared.pairs("time", plan, of_angles(angles) + compared.beside)
            if found[0]:
                yield (plan, of_angles(angles)), *_raced(found, 1.05 if angles else 1.5)


def _raced(found: list[list[Record]], most: float) -> tuple[Cells, str]:
    """Return the cells of what was timed, and the mark: new may take ``most`` times as long."""
    cells, spent = [], []
    for records in found:
        failed = [r["failed"] for r in records if "failed" in r]
        seconds = np.inf if failed else min(r["seconds"] for r in records)
        peak = np.inf if failed else min(r.get("peak_mb", 0.0) for r in records)
        spent.append((seconds, peak))
        cells.append((failed[0], "-") if failed else (f"{seconds:.3g}", f"{peak:.0f}"))
    slow = spent[-1][0] > most * spent[0][0] or spent[-1][1] > 1.1 * spent[0][1]
    return cells, MISSED * slow


def starts(compared: Comparison) -> Iterator[Found]:
    """Yield how long commands take, and by how much the new result of a recording differs."""
    for name in compared.chosen(STARTED):
        found = compared.pairs("start", name, compared.beside)
        if found[0]:
            cells, mark = _raced(found, 1.1)
            apart, another = _apart(found[0][0], found[-1][0])
            columns = [(cells[0][0], "-"), (cells[-1][0], apart)]
            yield (name, f"rotcal {STARTED[name][0]}"), columns[: len(found)], mark or another


def _apart(old: Record, new: Record) -> tuple[str, str]:
    """Return the largest difference of two results, in standard uncertainties, and its mark."""
    if old.get("verdict") != new.get("verdict") or old["code"] != new["code"]:
        return f"{old.get('verdict')}, now {new.get('verdict')}", MISSED
    most = 0.0
    for name, std in old.get("std", {}).items():
        felt = np.array(std) > 0.0
        moved = np.abs(np.subtract(new["deviations"][name], old["deviations"][name]))
        most = max(most, float(np.max(moved[felt] / np.array(std)[felt], initial=0.0)))
    return f"{most:.2g}", MISSED * (most > 1.0)


def claims(compared: Comparison) -> Iterator[Found]:
    """Yield how many claims of the papers there are, and how many are as before."""
    for paper in compared.chosen(PAPERS):
        found = compared.pairs("claims", paper)
        if found[0]:
            old, new = found[0][0]["claims"], found[-1][0]["claims"]
            alike = sum(any(_same(a, b) for b in new) for a in old)
            cells = [(f"{len(old)}",), (f"{alike}",)]
            yield (paper,), cells[: len(found)], MISSED * (alike < len(old))


def _same(old: list[Any], new: list[Any]) -> bool:
    """Whether two claims agree, numbers to a thousandth or to rounding."""
    if None in (old[-1], new[-1]):
        return old == new
    return old[:-1] == new[:-1] and bool(np.isclose(old[-1], new[-1], rtol=1e-3, atol=1e-12))


SECTIONS: Final = (
    ("sound", "False alarms", alarms, ("plan", "measurements"), ("not ok",),
     "Errors are drawn as they are stated. The new code may call 3 of 100 more not ok."),
    ("sound", "Coverage", coverage, ("plan", "output"), ("% held", "rms z"),
     "How many 95 % intervals hold the truth, with the standard error of that figure, and the "
     "root mean square of error / u. Wanted are 93 to 97 %; beyond by less than two standard "
     "errors counts as within. Steps are from angle to angle. Axes: "
     "`research/ball_coverage.py`. Where more is stated than is drawn, as of orders of motions "
     "and of a table that scatters, intervals hold more often."),
    ("power", "Effects", effects, ("plan", "effect", "size"), ("% not ok", "error / u", "named"),
     "Each effect at the size where the old code notices it in 95 of 100 measurements; \"up to\" "
     "is the largest that was tried, if none is. The new code must notice it in 90. "
     "The error of what stays ok must not grow, or the verdict names the effect."),
    ("time", "Time and memory", times, ("plan", "size"), ("s", "MB"),
     "Processor time of a whole solution, and the peak of memory. The new code may take 1.5 times "
     "as long for the demonstration, no longer for more angles, and no more memory."),
    ("start", "Commands", starts, ("recording", "command"), ("s", "difference / u"),
     "Processor time of a command from its start, and by how much the new result of the golden "
     "recording differs: not by a standard uncertainty, and with the same verdict."),
    ("claims", "Claims of the papers", claims, ("paper",), ("claims",),
     "What `rotcal reproduce` finds: the claims, and how many of them the new code finds alike."),
)  # fmt: skip
INTRODUCTION: Final = """# The yardstick

Before a part of the engine moves, the code before and the code after are measured side by side,
on the same seeds: `python research/yardstick.py --old main --new HEAD --page out/yardstick.md`.

* missed: the new code is not good enough
* as old: neither is good enough, and the new code is no worse
* outside: the old code alone is not good enough
"""


def page(compared: Comparison, parts: Collection[str]) -> str:
    """Return the page, of the plans and ``parts`` that were measured."""
    codes = f"Old: `{compared.old.name}`."
    if compared.new:
        codes += f" New: `{compared.new.name}`."
    texts = [INTRODUCTION, codes]
    for part, title, finding, left, columns, words in SECTIONS:
        lines = list(finding(compared)) if part in parts else []
        if not lines:
            continue
        sides = ("old: ", "new: ") if compared.new else ("",)
        head = [*left, *(side + column for side in sides for column in columns), ""]
        rows = [[*what, *(c for side in cells for c in side), mark] for what, cells, mark in lines]
        table = ["| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows)]
        texts += ["", f"## {title}", "", textwrap.fill(words, 100), "", *table]
    return "\n".join(texts) + "\n"


def main() -> int:
    """Measure, print the page or write it; return 1 if the new code misses anything."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = sorted({*PLANS, *STARTED, *PAPERS})
    parser.add_argument("--old", default="main", help="commit or folder")
    parser.add_argument("--new", help="commit or folder; without it the old code alone")
    parser.add_argument("--plan", choices=names, action="append", metavar="NAME", default=[],
                        help=f"default: all of {', '.join(names)}")  # fmt: skip
    parser.add_argument("--part", choices=PARTS, action="append", help="default: all")
    parser.add_argument("--runs", type=int, default=100, help="measurements of each kind")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time")
    parser.add_argument("--results", type=Path, default=ROOT / "out" / "yardstick")
    parser.add_argument("--no-more", action="store_true", help="only show what was measured")
    parser.add_argument("--page", type=Path, help="write this, instead of printing")
    given = parser.parse_args()
    given.results.mkdir(parents=True, exist_ok=True)
    old, new = Code.of(given.old, given.results), None
    if given.new:
        new = Code.of(given.new, given.results)
    compared = Comparison(old, new, tuple(given.plan), given.runs)
    try:
        if not given.no_more:
            compared.measure(given.part or PARTS, given.jobs)
    except KeyboardInterrupt:
        print("an interrupted run resumes with the same command", file=sys.stderr)
        return 130
    text = page(compared, given.part or PARTS)
    if given.page:
        given.page.write_text(text, encoding="utf-8")
    else:
        print(text)
    return int(MISSED in text)


if __name__ == "__main__":
    sys.exit(main())
