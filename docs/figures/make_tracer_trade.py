"""Draw tracer_trade.svg: lengths against U(ECC), of plans and of what no plan can beat.

For each required uncertainty the goals of config/ are planned as 'rotcal plan tracer' does it, in
one search; all figures are printed as well. Takes two minutes of processor time.
"""

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from rotcal_design.goal import goal_settings
from rotcal_design.settings import SHARED, TracerDesignSettings
from rotcal_design.tracer.ordering import ordered_design
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods.figures.style import BLUE, GREEN, GREY, ORANGE, RED, grid, house_style, svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HERE = Path(__file__).parent
CONFIG = HERE.parents[1] / "config"
WANTED = (0.7, 0.85, 1.0, 1.2, 1.5, 2.0)
IN_BLOCK = (1.2, 1.5, 2.0)
"""Of hundreds of lengths the search takes long."""
PAPER = (1.202, 704)
VOLUME = "volume, a zero per station"
BLOCK = "paper's block, one zero and circle, repeats"


class Point(NamedTuple):
    """A plan: wanted and reached U (arcsec, rms), lengths, and the bound of any plan."""

    wanted: float
    reached: float
    lengths: int
    bound: int


def points(name: str, settings: TracerDesignSettings) -> list[Point]:
    """Plan ``settings`` for all that is wanted, as far as it can be had; print and return it."""
    found: list[Point] = []
    for wanted in IN_BLOCK if name == BLOCK else WANTED:
        asked = replace(
            settings, need_arcsec=wanted, need_largest_arcsec=None, starts=1, exchanges=300
        )
        try:
            data = ordered_design(asked).to_dict()
        except PlanError as error:
            sys.stdout.write(f"{name}, {wanted} arcsec: {error}\n")
            continue
        point = Point(wanted, data["expanded_rms_arcsec"], data["lengths"], data["bound"])
        sys.stdout.write(f"{name}, {wanted} arcsec: {point}\n")
        sys.stdout.flush()
        found.append(point)
    return found


def fewest(found: list[Point]) -> list[Point]:
    """Return the points by U without those that another beats in both U and lengths."""
    kept: list[Point] = []
    for point in sorted(found, key=lambda point: (point.reached, point.lengths)):
        if not kept or point.lengths < kept[-1].lengths:
            kept.append(point)
    return kept


@house_style
def drawn(curves: dict[str, list[Point]]) -> str:
    """Return the drawing of plans and bounds by name."""
    [ax] = grid(height=4.2)
    colours = (BLUE, GREEN, ORANGE, RED)
    for (name, planned), colour in zip(curves.items(), colours, strict=True):
        found = fewest(planned)
        ax.plot(
            [point.reached for point in found], [point.lengths for point in found],
            "o-", color=colour, markersize=4, linewidth=1.3, label=name,
        )  # fmt: skip
    bounded(ax, curves[VOLUME], BLUE, "no plan in the volume below")
    bounded(ax, curves[BLOCK], RED, "no plan in the block below")
    ax.plot(*PAPER, "D", color=GREY, markersize=6, label="the paper's plan")
    ax.set(
        xscale="log", yscale="log", xlim=(0.5, 2.1), ylim=(5, 1100),
        xlabel="U(ECC), k = 2, rms over the angles [arcsec]", ylabel="lengths",
    )  # fmt: skip
    for axis, ticks in (
        (ax.xaxis, [0.6, 0.8, 1.0, 1.2, 1.5, 2.0]),
        (ax.yaxis, [10, 20, 50, 100, 200, 500, 1000]),
    ):
        axis.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
        axis.set_ticks([], minor=True)
    return svg(ax)


def bounded(ax: "Axes", found: list[Point], colour: str, label: str) -> None:
    """Draw the bound of the plans ``found`` and what lies below it."""
    wanted, bound = [point.wanted for point in found], [point.bound for point in found]
    ax.plot(wanted, bound, "--", color=colour, linewidth=1.2, label=label)
    ax.fill_between(wanted, bound, 1.0, color=colour, alpha=0.07, linewidth=0)


def main() -> None:
    """Plan, print, draw."""
    volume = goal_settings(None, CONFIG / "tracer_goal.yaml", [])
    circle = replace(volume, zero=SHARED, circle_std_m=7.0e-8)
    block = goal_settings(None, CONFIG / "tracer_block_goal.yaml", [])
    cases = {
        VOLUME: volume,
        "volume, one zero and circle": circle,
        "volume, one zero and circle, checking nothing": replace(circle, checked=False),
        BLOCK: block,
    }
    curves = {name: points(name, settings) for name, settings in cases.items()}
    (HERE / "tracer_trade.svg").write_text(drawn(curves) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
