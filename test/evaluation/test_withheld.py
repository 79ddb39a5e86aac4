"""A table whose error motion has a harmonic that the model of the tracer does not have."""

from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.evaluation.marks import uncovered_effects, why_withheld
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods import prepare
from rotcal_ros.methods.configuration import parse_configuration
from rotcal_ros.methods.tracer import simulation
from rotcal_ros.report.terminal import columns
from rotcal_ros.report.terminal.tables import print_result

TEXT = (Path(__file__).parents[2] / "config" / "tracer_demo.yaml").read_text()
CHANGES = {
    "policy: until_goal": "policy: as_listed",
    "box_points: [5, 4, 11]": "box_points: [4, 2, 4]",
}


def solved(radial: float):
    """Solve exact lengths with the stated noise of a table that runs out by ``radial`` (m).

    EXC = radial cos(2 angle) and nothing else, so that the true ECC is zero.
    """
    text = TEXT
    for old, new in CHANGES.items():
        assert old in text
        text = text.replace(old, new)
    lines = [line for line in text.splitlines() if not line.strip().startswith(("goal", "expect"))]
    configuration = parse_configuration("\n".join(lines), "the demonstration")
    calibration = prepare(configuration)
    noise = np.random.default_rng(1)
    angles = np.array([step.table_angle for step in calibration.plan.steps])
    mount = np.array(configuration.simulation.tracer.mount_m)
    stations = np.einsum("nij,j->ni", rotation_about_z(angles), mount)
    stations[:, 0] += radial * np.cos(2.0 * angles)
    streams = (noise, noise)  # nothing is drawn from the second
    return calibration.solve(
        simulation.observe_plan(configuration, calibration.plan, stations, {}, streams)
    )


@pytest.fixture(scope="module")
def harmonic():
    return solved(1.5 * MICROMETRE)


def test_a_radial_harmonic_of_1_5_um_leaves_no_valid_u(harmonic):
    error = np.abs(harmonic.deviations["ECC"])
    # U (k = 2) as it would be without the harmonic is 0.8 arcsec, and the error is 8 or more.
    assert error.max() > 8.0 * ARCSEC
    assert harmonic.verdict == "suspect"
    assert "the stations leave their circle" in why_withheld(harmonic)
    assert np.all(harmonic.std["ECC"][1:] > 0.0)  # the numbers stay in the result


@pytest.fixture
def printed(capsys, monkeypatch):
    """Return a function that prints a result as at a terminal, and gives back the text."""
    monkeypatch.setattr(columns, "is_terminal", lambda: True)

    def text(result) -> str:
        print_result(result)
        told = capsys.readouterr()
        return told.out + told.err

    return text


def test_the_terminal_says_so_where_the_number_stood(harmonic, printed):
    shown = printed(harmonic)
    assert "± U" not in shown
    assert " ± 0." not in shown  # the tolerance has a ± of its own
    assert "U: not stated, because the verdict is suspect" in shown


def test_the_same_table_without_it_has_one(printed):
    sound = solved(0.0)
    assert why_withheld(sound) is None
    assert any("error motion" in effect for effect in uncovered_effects(sound))
    assert np.all(np.abs(sound.deviations["ECC"]) <= 2.0 * COVERAGE_FACTOR * sound.std["ECC"])
    shown = printed(sound)
    assert "± U (k = 2)" in shown
    assert shown.count(" ± 0.") >= len(sound.angles) - 1
