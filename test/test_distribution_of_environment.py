"""Whose environment scripts/setup.sh takes; without an index, so nothing is installed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OWN = {"build", "out", "log", "install"}


@pytest.mark.slow
def test_an_environment_of_another_distribution_is_made_anew_and_never_mixed(tmp_path):
    for path in ROOT.iterdir():
        if path.name not in OWN and not path.name.startswith("."):
            (tmp_path / path.name).symlink_to(path)

    def set_up(*distribution):
        made = subprocess.run(
            ["scripts/setup.sh", *distribution], cwd=tmp_path, capture_output=True, text=True,
            env={**os.environ, "PIP_NO_INDEX": "1", "PYTHON": sys.executable},
        )  # fmt: skip
        assert "No matching distribution" in made.stderr
        return made.stderr

    anew = "set-up: .venv is of another ROS 2, Python or folder"
    assert "new environment .venv-kilted with ROS 2 Kilted" in set_up("kilted")
    environment = (tmp_path / ".venv-kilted").rename(tmp_path / ".venv")
    finished, installed = environment / ".packages", environment / "installed"
    for path in (finished, installed):
        path.write_text("of Kilted")
    words = set_up()
    assert anew in words
    assert "new environment .venv with ROS 2 Jazzy" in words
    assert not installed.exists()

    for path in (finished, installed):
        path.write_text("of Jazzy")
    assert "new environment" not in set_up()
    assert installed.exists()
