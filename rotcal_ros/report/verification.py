"""The section "before and after compensation" of a report."""

from __future__ import annotations

from html import escape

from matplotlib.axes import Axes

from rotcal_ros.components import COVERAGE_FACTOR
from rotcal_ros.evaluation.verification import ISO_FIGURES, Positioning, Verification
from rotcal_ros.figures import style
from rotcal_ros.units import ARCSEC, DEGREE

TITLE = "Before and after compensation"
_WORDS = {
    "accuracy": "A, accuracy of positioning",
    "repeatability": "R, repeatability",
    "systematic": "E, systematic deviation",
    "reversal": "B, reversal",
    "mean_range": "M, mean bidirectional deviation",
}


def verification_section(verification: Verification) -> tuple[str, str]:
    """Return title and HTML of the section."""
    before, after = verification.before, verification.after
    rows = [
        ("E, range of the measured deviations", before.systematic, after.systematic),
        ("rms of the measured deviations", before.rms, after.rms),
        ("largest standard uncertainty (k = 1)", before.std.max(), after.std.max()),
    ]
    if verification.iso:
        first, second = verification.iso["before"], verification.iso["after"]
        rows += [
            (f"{_WORDS[name]} (true angle)", getattr(first, name), getattr(second, name))
            for name in ISO_FIGURES
        ]
    cells = "".join(
        f"<tr><td>{escape(name)}</td><td>{a / ARCSEC:.3f}</td><td>{b / ARCSEC:.3f}</td></tr>"
        for name, a, b in rows
    )
    text = (
        f"Measured, compensated, measured again: the range is {verification.ratio:.0f} times "
        f"smaller, verdict <b>{verification.verdict}</b>. Up to "
        f"{verification.expected / ARCSEC:.3f} arcsec were expected to be left: the uncertainty "
        f"of both measurements and {verification.stated / ARCSEC:.3f} arcsec of the table itself."
    )
    if verification.again is not None:
        text += (
            f" What was left was added to the table: measured again, the range is "
            f"{verification.again.systematic / ARCSEC:.3f} arcsec."
        )
    head = "<tr><th>arcsec</th><th>before</th><th>after</th></tr>"
    reserves = "".join(f"<p>{escape(line)}</p>" for line in verification.reserves)
    drawing = before_and_after(before, after)
    return TITLE, f"<p>{text}</p>{reserves}{drawing}<table>{head}{cells}</table>"


@style.styled
def before_and_after(before: Positioning, after: Positioning) -> str:
    """Draw both measured curves, and what is left once more on its own scale."""
    whole, left = style.grid(2, height=2.4)
    _draw(whole, before, style.ORANGE, "before")
    for ax in (whole, left):
        _draw(ax, after, style.BLUE, "after")
        ax.set_ylabel("ECC / arcsec")
    left.set_xlabel("commanded table angle / °")
    return style.svg(whole)


def _draw(ax: Axes, run: Positioning, colour: str, label: str) -> None:
    ax.errorbar(
        run.angles / DEGREE, run.deviation / ARCSEC, COVERAGE_FACTOR * run.std / ARCSEC,
        fmt="o-", color=colour, markersize=3.5, linewidth=1.2, capsize=2, label=f"{label}, k = 2",
    )  # fmt: skip
