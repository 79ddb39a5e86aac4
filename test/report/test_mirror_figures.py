"""Figures from the details of a plane-mirror result, fresh or read back from JSON."""

import json
from dataclasses import replace

import numpy as np
import pytest
from mirror_cell import measure, paper_cell

from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.plane_mirror import figures as mirror_figures
from rotcal_ros.methods.plane_mirror.solver import solve
from rotcal_ros.report.page import ReportInput, render_report

TITLES = ["The ways side by side", "Tracker stations and nests", "Angles of incidence",
          "Nest residuals"]  # fmt: skip


@pytest.fixture(scope="module")
def result() -> Result:
    problem = measure(paper_cell(), np.zeros((17, 6)), rng=np.random.default_rng(1))
    solved = solve(problem)
    way = {"way": "stitching", "angles_rad": solved.angles, "ecc_rad": solved.deviations["ECC"],
           "ecc_std_rad": solved.std["ECC"]}  # fmt: skip
    solved.details["ways"] = [way, {"way": "registration", "why_not": "no nests"}]
    return solved


@pytest.mark.slow
def test_every_section_is_drawn_from_the_result_and_from_its_json(result: Result) -> None:
    again = Result.from_dict(json.loads(result.to_json()))
    for source in (result, again):
        drawn = mirror_figures.figures(source)
        shown = [figure.title for figure in drawn if figure.svg.startswith("<svg")]
        assert shown == [*TITLES, "Residuals"]
    assert mirror_figures.figures(result) == mirror_figures.figures(again)


def test_details_without_mirror_draw_nothing() -> None:
    empty = Result("other", np.arange(3.0), {}, {}, {}, 1.0, 0, 0, details={"stations": []})
    assert all(figure.svg == "" for figure in mirror_figures.figures(empty))
    tracer = {"stations": np.zeros((4, 3)), "axis": [0, 0, 1]}
    assert mirror_figures.station_map(tracer) == ""


@pytest.mark.slow
def test_the_page_chooses_the_sections_by_what_the_details_hold(result: Result) -> None:
    page = render_report(ReportInput(result=result, title="Table", method_title="Mirror"))
    for title in TITLES:
        assert f"<h3>{title}</h3>" in page
    assert "Stations in plan view" not in page
    assert "Normalised residuals" not in page  # several residuals per position and nest


def test_the_map_shows_where_the_stations_stood(result: Result) -> None:
    """Stations of the paper's cell are 2 m from the axis: so are they from each other's chords."""
    places = np.array([stand["position_m"] for stand in result.details["stations"]])
    chord = np.linalg.norm(places[1] - places[0])
    assert chord == pytest.approx(2 * 2.0 * np.sin(np.radians(67.5 / 2)), abs=1e-4)
    nests = {n["nest"]: np.array(n["position_m"]) for n in result.details["nests"]}
    cell = paper_cell()
    expected = np.linalg.norm(cell.nests[0] - cell.nests[3])
    assert np.linalg.norm(nests[1] - nests[4]) == pytest.approx(expected, abs=1e-4)


def test_the_drift_is_drawn_where_nests_were_measured_again(result: Result) -> None:
    assert mirror_figures.drift(result.details) == ""
    station = {
        "station": "A",
        "knots": [0.0, 4.0, 10.0],
        "turn_rad": [[0.0, 1e-6, 5e-6], [1e-6, 0.0, -2e-6]],
        "turn_std_rad": [[1e-6] * 3] * 2,
        "range_m": [1e-6, 3e-6],
        "range_std_m": [1e-6] * 2,
    }
    drawn = mirror_figures.drift({"drift": [station, {**station, "station": "B"}]})
    assert drawn.startswith("<svg")
    for text in ("azimuth", "tilt y", "tracker station", "range / µm"):
        assert text in drawn


def test_a_way_that_finds_more_lies_above_the_one_that_is_used(
    result: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    (way, *_) = result.details["ways"]
    more = {**way, "ecc_rad": way["ecc_rad"] + 3.0 * ARCSEC}
    curves = {}

    def drawn(ax: object, _angles: object, curve: np.ndarray, *more: object) -> None:
        curves.setdefault(more[-1], []).append(curve)

    monkeypatch.setattr(mirror_figures.style, "curve_with_band", drawn)
    mirror_figures.ways(replace(result, details={**result.details, "ways": [more]}))
    own, other = curves["difference"]
    assert own == pytest.approx(0.0)
    assert other == pytest.approx(3.0)
