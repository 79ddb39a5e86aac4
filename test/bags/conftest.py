"""One simulated run for all tests of bags."""

from pathlib import Path

import bag_samples
import pytest


@pytest.fixture(scope="session")
def simulated_run() -> bag_samples.Run:
    return bag_samples.simulate()


@pytest.fixture(scope="session")
def run_bag(simulated_run: bag_samples.Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the bag of the simulated run; tests must not change it."""
    folder = tmp_path_factory.mktemp("bags") / "run"
    bag_samples.write_run(folder, simulated_run)
    return folder
