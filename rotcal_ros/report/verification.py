"""The section "before and after compensation" of a report."""

from __future__ import annotations

from pathlib import Path

from markupsafe import escape
from matplotlib.axes import Axes

from rotcal_ros.compensation.earlier_export import effect_of_table_in_force
from rotcal_ros.evaluation.verification import ISO_FIGURES, Positioning, Verification
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.escapes import printable_lines
from rotcal_ros.foundation.in_force import describe, is_table_hash
from rotcal_ros.foundation.language import SPOKEN, phrase
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.figures import style
from rotcal_ros.report.template import render

TITLE = phrase("Before and after compensation")
_WORDS = {
    "accuracy": phrase("A, accuracy of positioning"),
    "repeatability": phrase("R, repeatability"),
    "systematic": phrase("E, systematic deviation"),
    "reversal": phrase("B, reversal"),
    "mean_range": phrase("M, mean bidirectional deviation"),
}


def verification_section(verification: Verification) -> tuple[str, str]:
    """Return title and HTML of the section."""
    before, after = verification.before, verification.after
    rows = [
        (phrase("E, range of the measured deviations"), before.systematic, after.systematic),
        (phrase("rms of the measured deviations"), before.rms, after.rms),
        (
            phrase("largest U (k = 2)"),
            *(COVERAGE_FACTOR * run.std.max() for run in (before, after)),
        ),
    ]
    if verification.iso:
        first, second = verification.iso["before"], verification.iso["after"]
        rows += [
            (phrase("{0} (true angle)", _WORDS[name]), getattr(first, name), getattr(second, name))
            for name in ISO_FIGURES
        ]
    section = render(
        "verification",
        text=_in_words(verification),
        verdict=phrase(verification.verdict),
        reserves=list(map(phrase, verification.reserves)),
        figure=draw_before_and_after(before, after),
        rows=[(name, f"{a / ARCSEC:.3f}", f"{b / ARCSEC:.3f}") for name, a, b in rows],
    )
    return TITLE, section


def table_in_force_section(result: Result, in_force: Path | None) -> list[tuple[str, str]]:
    """Return title and HTML that say whether the table in force acted on ``result``.

    Empty if there was no table, or it is unknown; ``in_force`` holds the table's files.
    """
    if in_force is not None:
        effect = effect_of_table_in_force(result, in_force)
        acts = (
            phrase("its corrections are too small to show it")
            if effect is None
            else phrase(effect.fault or effect.describe())
        )
    elif is_table_hash(result.measured_on):
        acts = phrase(
            "not tested: this also needs the files of the table (rotcal report --in-force "
            "FOLDER, rotcal export --add-to FOLDER)"
        )
    else:
        return []
    text = phrase("{0}. Does that table act? {1}.", describe(result.measured_on), acts)
    spoken = printable_lines(SPOKEN.get().say(text))
    return [(phrase("The table in force"), f"<p>{escape(spoken)}</p>")]


def _in_words(verification: Verification) -> str:
    text = phrase(
        "Measured, compensated, measured again: the range is {0} times smaller. Up to {1} arcsec "
        "were expected to be left: the uncertainty of both measurements and {2} arcsec of the "
        "table itself.", f"{verification.ratio:.0f}", f"{verification.expected / ARCSEC:.3f}",
        f"{verification.stated / ARCSEC:.3f}"
    )  # fmt: skip
    if verification.effect is not None:
        acts = phrase(verification.fault or verification.effect.describe())
        text = phrase("{0} Does the table act? {1}.", text, acts)
    if verification.again is None:
        return text
    left = f"{verification.again.systematic / ARCSEC:.3f}"
    return phrase(
        "{0} The rest was added to the table: measured again, the range is {1} arcsec.", text, left
    )


@style.house_style
def draw_before_and_after(before: Positioning, after: Positioning) -> str:
    """Draw both measured curves, and the second one again on its own scale."""
    whole, left = style.grid(2, height=2.4)
    _draw(whole, before, style.ORANGE, "before")
    for ax in (whole, left):
        _draw(ax, after, style.BLUE, "after")
        ax.set_ylabel("ECC / arcsec")
    style.angle_axis(left, before.angles / DEGREE)
    return style.svg(whole)


def _draw(ax: Axes, run: Positioning, colour: str, label: str) -> None:
    ax.errorbar(
        run.angles / DEGREE, run.deviation / ARCSEC, COVERAGE_FACTOR * run.std / ARCSEC,
        fmt="o-", color=colour, markersize=3.5, linewidth=1.2, capsize=2,
        label=phrase("{0}, k = 2", phrase(label)),
    )  # fmt: skip
