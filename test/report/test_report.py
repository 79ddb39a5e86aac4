import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.results import Rejection, Residuals, Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.goal import GoalStanding
from rotcal_ros.planning.plan import PlanComparison, PlanFigures
from rotcal_ros.report.page import ReportInput, render_report

pytestmark = pytest.mark.usefixtures("without_figures")


def tracer_result() -> Result:
    angles = np.arange(4) * 30.0 * DEGREE
    ecc = np.array([0.0, 5.9, 6.6, 6.2]) * ARCSEC
    return Result(
        method="tracer_multistation",
        angles=angles,
        deviations={"ECC": ecc},
        std={"ECC": np.array([0.0, 0.4, 0.4, 0.4]) * ARCSEC},
        covariance={},
        sigma0=1.02,
        dof=100,
        n_observations=8,
        rejected=(Rejection(3, "normalised residual 5.1 > 3.3"),),
        verdict="suspect",
        warnings=("more than 3 % <rejected>",),
        adjacent_deviations=np.diff(ecc),
        adjacent_std=np.full(3, 0.5) * ARCSEC,
        residuals=Residuals(
            table_position=np.tile(np.arange(4), 2),
            target=np.repeat(np.arange(2), 4),
            residual=np.linspace(-1e-6, 1e-6, 8),
            redundancy=np.full(8, 0.8),
            test_value=np.linspace(-2, 2, 8),
            used=np.arange(8) != 3,
        ),
        details={
            "stations": np.column_stack([np.cos(angles), np.sin(angles), np.zeros(4)]) * 0.065,
            "circle": {"centre": np.zeros(3), "radius": 0.065},
            "tilt": 2.5e-5,
        },
    )


REPORT = ReportInput(
    result=tracer_result(),
    title="Rotary table C",
    method_title="Laser tracer, multi-station",
    inputs=[("bag_0.mcap", "ab" * 32)],
    versions={"numpy": "2.0"},
    truth={"angles_rad": [0.0, 1.0], "deviations": {"ECC": [0.0, 1e-5]}},
)


def test_a_goal_is_shown_beside_the_papers_plan():
    own = PlanFigures(66, 0.71 * ARCSEC, 435.2, None)
    papers = PlanFigures(704, 0.79 * ARCSEC, 10545.0, 225.4)
    reason = "goal reached: U 0.7 <= 0.8"
    standing = GoalStanding(
        0.8 * ARCSEC, 0.7 * ARCSEC, 67, 2149, reason, PlanComparison(own, papers, 1.03e-7)
    )
    page = render_report(replace(REPORT, goal=standing))
    shown = re.sub(r"<[^>]*>", " ", page)
    for text in ("0.800 arcsec", "0.700 arcsec", "67 measured of 2149", "0.103 µm per length"):
        assert text in shown
    assert "goal reached: U 0.7 &lt;= 0.8" in shown
    row = next(line for line in page.splitlines() if "planner.step_s" in line)
    assert re.findall(r"\d+ s\b", row) == ["435 s", "10545 s"]
    assert "planner.step_s" not in render_report(REPORT)


class References(HTMLParser):
    """Collects everything a page would fetch from elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if (
                name in ("src", "href", "xlink:href")
                and value
                and not value.startswith(("#", "data:"))
            ):
                self.found.append(f"{tag} {value}")


def test_page_is_self_contained_and_says_the_numbers() -> None:
    page = render_report(REPORT)
    references = References()
    references.feed(page)
    assert references.found == []
    assert '<th scope="row">60</th><td>+6.60</td><td>–</td>' in page
    assert "Measurement: suspect" in page
    assert "normalised residual 5.1 &gt; 3.3" in page
    assert "&lt;rejected&gt;" in page
    assert "ab" * 32 in page
    assert page.count("<svg") == 6


def test_equal_inputs_give_the_equal_page() -> None:
    assert render_report(REPORT) == render_report(REPORT)


def test_figures_that_have_nothing_to_show_are_left_out() -> None:
    bare = Result(
        method="m", angles=np.arange(3.0), deviations={"EXC": np.zeros(3)},
        std={"EXC": np.ones(3) * 1e-6}, covariance={}, sigma0=1.0, dof=1, n_observations=3,
    )  # fmt: skip
    page = render_report(ReportInput(result=bare, title="t", method_title="m"))
    assert re.findall(r"<h2>(.*?)</h2>", page)[:2] == ["Result", "Uncertainty budget"]
    assert page.count("<svg") == 2


def trusting(*protections: Protection) -> str:
    result = replace(tracer_result(), verdict="ok", warnings=(), protections=protections)
    return render_report(replace(REPORT, result=result))


def test_an_ok_is_green_and_the_line_below_says_what_it_does_not_cover() -> None:
    bare = Protection("tilt", "not protected", "nothing sees <the table> lean")
    late = Protection("drift", "tested", "closure", error=2.14)
    whole = Protection("scale", "harmless", "a larger circle")
    page = trusting(bare, late, whole)
    assert '<span class="verdict ok">Measurement: ok</span>' in page
    assert '<span class="remark">Not tested for: drift, tilt</span>' in page
    assert "What could be wrong, and would it show?" in page
    assert (
        '<tr class="bare"><th scope="row">tilt</th><td>not protected</td>'
        "<td>nothing sees &lt;the table&gt; lean</td><td></td></tr>"
    ) in page
    assert (
        '<tr class="bare"><th scope="row">drift</th>'
        "<td>tested</td><td>closure</td><td>2.1</td></tr>"
    ) in page
    assert '<tr><th scope="row">scale</th>' in page
    assert '<span class="verdict ok">Measurement: ok</span>' in trusting(whole)
    assert "Not tested for" not in trusting(whole)


def test_a_method_that_states_nothing_is_told_from_one_that_is_protected() -> None:
    page = trusting()
    assert "Not tested for: drift and similar effects" in page
    assert "does not state what it does about drift" in page


def test_an_unfinished_session_says_how_it_goes_on() -> None:
    command = "rotcal run --resume '/data/my table'"
    page = render_report(replace(REPORT, go_on=command))
    shown = command.replace("'", "&#39;")
    assert f"<code>{shown}</code>" in page
    assert "not finished" not in render_report(REPORT)
