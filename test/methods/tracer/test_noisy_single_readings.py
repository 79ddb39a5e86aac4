"""Single readings of 0.2 um noise under a set-up that states 30 nm: noise is what is named."""

from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.geometry.rotations import positions_on_table
from rotcal_ros.methods import changed, prepare, read_configuration
from rotcal_ros.methods.measurements import read_measurements

SETUP = Path(__file__).parents[3] / "examples" / "data" / "tracer.yaml"
NOISE = 2e-7
TARGETS = 8.5e-7
"""Standard deviations (m) of a reading and of a target's coordinate."""


def configured(length_std):
    """Return the set-up of the sample data with a standard deviation (m) of a length."""
    return changed(read_configuration(SETUP), [f"solver.length_std_m={length_std}"])


@pytest.fixture(scope="module")
def lengths(tmp_path_factory):
    """Lengths from a table without error to targets that are not quite where they should be."""
    rng = np.random.default_rng(20261122)
    configuration = configured(3e-8)
    plan = prepare(configuration).plan
    mount = configuration.simulation.tracer.mount_m
    stations = positions_on_table(mount, np.array(plan.table_angles))
    targets = np.array(plan.targets) + TARGETS * rng.standard_normal((len(plan.targets), 3))
    path = tmp_path_factory.mktemp("readings") / "lengths.csv"
    rows = [
        f"{s.table_position},{s.target},"
        f"{np.linalg.norm(targets[s.target] - stations[s.table_position]) - 0.3 + noise:.10f}"
        for s, noise in zip(plan.steps, NOISE * rng.standard_normal(len(plan.steps)), strict=True)
    ]
    path.write_text("position,target,length_m\n" + "\n".join(rows) + "\n")
    return path


def test_the_message_names_the_noise(lengths):
    result = read_measurements(lengths, configured(3e-8)).solve()
    assert result.verdict == "suspect"
    (text,) = (w for w in result.warnings if "the scatter of the lengths" in w)
    larger = float(text.partition("the lengths is ")[2].partition(" times")[0])
    assert 3e-8 * larger == pytest.approx(NOISE, rel=0.15)


def test_with_the_noise_stated_all_is_well_and_the_truth_is_found(lengths):
    result = read_measurements(lengths, configured(NOISE)).solve()
    assert result.verdict == "ok"
    assert not result.rejected
    error = result.deviations["ECC"][1:] / result.std["ECC"][1:]  # the table has no error
    assert np.sqrt(np.mean(error**2)) < 2.0
