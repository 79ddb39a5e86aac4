#!/usr/bin/env python3
"""Write docs/what_could_be_wrong.md: each effect, its treatment, its size when found, its error.

    python research/power_table.py --method tracer --runs 200 --output docs/what_could_be_wrong.md

Without --method all of them. The sections of other methods in the output stay, and with --effect
the other rows. The exit code is 1 when an effect misleads: it does more than the tolerable error,
unnoticed and unnamed.
"""

from __future__ import annotations

import argparse
import re
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path

from rotcal_ros.evaluation.power import PowerBench, PowerRow, power_rows
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.protection import ALL_EFFECTS, POWER, TOLERABLE
from rotcal_ros.methods import prepare, read_configuration

PLANS = Path(__file__).parent / "power_plans"
METHODS = ("tracer", "ball_plate", "plane_mirror", "angle_comparison", "table_balls")
PAGE = Path(__file__).parents[1] / "docs" / "what_could_be_wrong.md"
INTRODUCTION = f"""# What could be wrong, and would you see it?

Every effect that could spoil a calibration was added to simulated measurements of a small plan,
larger and larger, until the verdict was no longer `ok` in {100 * POWER:g} % of them.

* *Size* is where the verdict changes. If it never does, the largest size that was tried follows
  "not up to". "Allowed" is the allowance that the configuration states and the uncertainty
  contains. A knock beside the first or the last reading of a run is one reading that is off, and
  left out: where these are more than 5 % of all moments, no size turns the verdict.
* *Error* is what the effect does to the deviations unnoticed up to that size, in standard
  uncertainties: the root mean square over the measurements whose verdict stayed `ok`, at the worst
  component and angle. Effects that scatter count over all angles.
* *Named* says whether the verdict line names the effect ("Not tested for: ...").

No effect may do more than {TOLERABLE:g} standard uncertainties unnoticed and unnamed. The
effects are explained below the table, or else below the nearest table above.

Some errors have no size here, because no size changes the verdict:

* **An offset between parts of the table that nothing joins**
  ([groups](ball_plate.md#closed-form-and-groups)). Such a result is always `suspect`.
* **Positions of a table of lengths that are all numbered off by one**. The verdict line names
  `numbering` until `plan.tracer_m` states where the tracer stands.
* **A z axis that points down** in a table of ball centres, or of a tracer at several places. The
  verdict line names `sign of z`.
* **Readings of balls that are meant otherwise**: of the other sign, of a table that turns the
  other way, of an instrument that shows too little. They make a result `suspect` where [balls show
  it](table_balls.md#mistakes-of-the-set-up); else the verdict line names `sign of readings`,
  `sense`, `numbering`, `gain`.
* **Two circles**: settings that are numbered or exchanged, single readings and certificates that
  nothing checks, a reference that leans or gives way alike in all settings. The verdict line names
  `numbering`, `single readings`, `gauge`, `polygon tilt` and `slip`
  ([what tests them](angle_comparison.md#what-the-readings-cannot-show)).
* **A link that one input alone determines**, and a table of values that nothing measured again, in
  a [combination](evaluation.md#combination). The verdict line names `gauge`, `single readings`.

Sizes depend on the plan: lengths, redundancy, order. `make power` writes this page again;
`rotcal plan power CONFIG` measures your own plan. The words:
[conventions](conventions.md#uncertainty).
"""


def main() -> int:
    """Measure, write the page, name what misleads."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--method", choices=METHODS, action="append", help="default: all")
    parser.add_argument("--effect", action="append", default=[], help="default: all")
    parser.add_argument("--runs", type=int, default=100, help="measurements of each size")
    parser.add_argument("--output", type=Path, default=PAGE)
    chosen = parser.parse_args()
    misleading = []
    for plan in plans_of(chosen.method or METHODS):
        bench = PowerBench(prepare(read_configuration(plan)), chosen.runs)
        listed = {d.effect for d in bench.listed()}
        if chosen.effect and not listed & set(chosen.effect):
            continue
        rows = power_rows(
            bench,
            lambda row: print(*row.cells(), sep=", ", flush=True),
            [effect for effect in chosen.effect if effect in listed],
        )
        _put(chosen.output, title_of(plan), _section(bench, rows), bool(chosen.effect))
        misleading += [(plan.stem, row) for row in rows if row.misleads]
    for name, row in misleading:
        print(
            f"{name}: {row.effect} may do {row.error:.3g} standard uncertainties under a verdict "
            "that is ok and does not name it",
            file=sys.stderr,
        )
    return int(bool(misleading))


def plans_of(methods: Sequence[str]) -> list[Path]:
    """Return the configurations that begin with the names of ``methods``."""
    return [plan for name in methods for plan in sorted(PLANS.glob(f"{name}*.yaml"))]


def title_of(plan: Path) -> str:
    """Return the heading of a plan's section: the comment in its first line, else its name."""
    first = plan.read_text(encoding="utf-8").split("\n", 1)[0]
    return first.removeprefix("# ") if first.startswith("# ") else plan.stem


def _section(bench: PowerBench, rows: list[PowerRow]) -> str:
    """Return the table of one method, and what each effect is."""
    plan = bench.calibration.plan
    result = bench.plain(0)
    summary = (
        f"{bench.runs} measurements of each size, {len(plan.table_angles)} table angles, "
        f"{len(plan.steps)} steps. Without any effect {bench.false_alarms()} of {bench.runs} were "
        f"not ok. Verdict line: `{result.verdict_line}`."
    )
    lines = [
        textwrap.fill(summary, 100),
        "",
        "| effect | treatment | size | error / std | named |",
        "| --- | --- | --- | --- | --- |",
        *("| " + " | ".join(row.cells()) + " |" for row in rows),
        "",
        *(textwrap.fill(f"* {r.effect}: {r.what}", 100, subsequent_indent="  ") for r in rows),
    ]
    return "\n".join(lines) + "\n"


def _put(page: Path, title: str, section: str, beside: bool) -> None:
    """Write the page with ``section`` under its title, in place or ``beside`` what was there."""
    old = page.read_text(encoding="utf-8") if page.exists() else ""
    sections = dict(re.findall(r"^## (.*?)\n\n(.*?)(?=^## |\Z)", old, flags=re.M | re.S))
    beside = beside and title in sections
    sections[title] = (_joined(sections[title], section) if beside else section) + "\n"
    known = [title_of(plan) for plan in plans_of(METHODS)]
    order = [name for name in known if name in sections]
    order += [name for name in sections if name not in known]
    explained: dict[str, str] = {}
    texts = [f"## {name}\n\n{_once(sections[name], explained).rstrip()}\n" for name in order]
    write_atomically(page, "\n".join([INTRODUCTION, *texts]))


def _joined(old: str, new: str) -> str:
    """Return the section ``old``; rows and items of effects that ``new`` has are its own."""
    head = re.split(r"(?<=--- \|\n)", old)[0]
    rows, items = dict[str, str](), dict[str, str]()
    for section in (old, new):
        rows |= re.findall(r"^\| (.*?) (\|(?! treatment| ---).*)$", section, flags=re.M)
        items |= re.findall(r"^\* (.*?)(:.*?)(?=^\* |\Z)", section, flags=re.M | re.S)
    order = [effect for effect in ALL_EFFECTS if effect in rows]
    return "\n".join([
        head + "\n".join(f"| {effect} {rows[effect]}" for effect in order),
        "",
        *(f"* {effect}{items[effect].rstrip()}" for effect in order if effect in items),
        "",
    ])  # fmt: skip


def _once(section: str, explained: dict[str, str]) -> str:
    """Return ``section`` without what is ``explained`` by effect, and remember its own."""
    table, *items = re.split(r"^(?=\* )", section, flags=re.M)
    for item in items:
        effect, explanation = item.rstrip().split(":", 1)
        if explained.get(effect) != explanation:
            table += item
        explained[effect] = explanation
    return table


if __name__ == "__main__":
    sys.exit(main())
