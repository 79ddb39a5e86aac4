"""``rotcal verify``: what it takes to be ok, and what it refuses."""

import numpy as np
import pytest
from click.testing import CliRunner

from rotcal_ros.cli.main import rotcal
from rotcal_ros.evaluation.iso230 import BidirectionalRuns, iso230
from rotcal_ros.evaluation.verification import Positioning, Verification
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.report.verification import verification_section

ANGLES = np.arange(12) * np.pi / 6


def run(amplitude_arcsec, std_arcsec=0.1):
    deviation = amplitude_arcsec * ARCSEC * np.cos(ANGLES)
    return Positioning(ANGLES, deviation, np.full(12, std_arcsec * ARCSEC))


@pytest.mark.parametrize(
    ("after", "verdict", "ratio"),
    [(0.3, "ok", 100.0), (0.8, "suspect", 37.5), (60.0, "failed", 0.5)],
)
def test_no_more_may_be_left_than_the_uncertainties_and_the_table_explain(after, verdict, ratio):
    verification = Verification(run(30.0), run(after), stated=0.1 * ARCSEC)
    # 4 x sqrt(0.1^2 + 0.1^2) + 0.1 = 0.666 arcsec
    assert verification.expected / ARCSEC == pytest.approx(0.665685, abs=1e-5)
    assert verification.verdict == verdict
    assert verification.ratio == pytest.approx(ratio)
    data = verification.to_dict()
    assert data["before"]["systematic_E_arcsec"] == pytest.approx(60.0)
    assert "iso230_2_arcsec" not in data


@pytest.mark.parametrize(("again", "verdict"), [(0.3, "ok"), (0.8, "suspect"), (60.0, "failed")])
def test_the_round_that_was_added_is_held_to_the_same_bound(again, verdict):
    verification = Verification(run(30.0), run(0.3), stated=0.1 * ARCSEC, again=run(again))
    assert verification.verdict == verdict
    assert verification.to_dict()["again"]["systematic_E_arcsec"] == pytest.approx(2 * again)
    assert f"the range is {2 * again:.3f} arcsec" in verification_section(verification)[1]


def test_the_section_shows_both_and_the_iso_figures():
    runs = np.array([[1.0, 1.2], [3.0, 3.1]]) * ARCSEC
    figures = iso230(BidirectionalRuns(np.array([0.0, 1.0]), runs, runs))
    iso = {"before": figures, "after": figures}
    verification = Verification(run(30.0), run(0.3), 0.0, iso)
    title, html = verification_section(verification)
    assert title == "Before and after compensation"
    for words in ("100 times smaller", "<svg", "60.000", "0.600", "A, accuracy of positioning"):
        assert words in html
    figures_out = verification.to_dict()["iso230_2_arcsec"]["after"]
    assert figures_out["systematic"] == pytest.approx(np.ptp(runs.mean(axis=1)) / ARCSEC)


def test_what_the_measurements_do_not_cover_is_told_beside_the_verdict():
    lines = {"before": "suspect. Not tested for: drift", "after": "ok. Not tested for: drift"}
    verification = Verification(run(30.0), run(0.3), 0.0, verdict_lines=lines)
    reserves = ("measurement before: suspect", "Not tested for: drift")
    assert verification.reserves == reserves
    assert verification.to_dict()["verdict_lines"] == lines
    section = verification_section(verification)[1]
    assert all(f"<p>{line}</p>" in section for line in reserves)


def test_what_only_one_measurement_does_not_cover_is_told_of_that_one():
    lines = {"before": "ok. Not tested for: knock, tilt", "after": "ok. Not tested for: tilt"}
    verification = Verification(run(30.0), run(0.3), 0.0, verdict_lines=lines)
    assert verification.reserves == (
        "measurement before: Not tested for: knock, tilt",
        "measurement after: Not tested for: tilt",
    )


def test_an_existing_folder_is_not_overwritten(tmp_path):
    pytest.importorskip("rclpy")
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "bag_0.mcap").write_bytes(b"somebody's")
    found = CliRunner().invoke(rotcal, ["verify", "config/verify_demo.yaml", "-o", str(tmp_path)])
    assert found.exit_code == 2
    assert "nothing is overwritten" in found.stderr
