"""Ordinary exports of sound data are read as the table of our own form with the same numbers."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from exports import DATA, EXPORTS, ROUNDED, sample

from rotcal_ros.methods.configuration import Configuration, read_configuration
from rotcal_ros.methods.measurements import read_measurements


@pytest.fixture(scope="module")
def configuration() -> Configuration:
    return read_configuration(DATA / "tracer.yaml")


def lengths(path: Path, configuration: Configuration) -> list[tuple[int, int, float]]:
    data = read_measurements(path, configuration)
    return [(o.table_position, o.target, o.mean[0]) for o in data.observations]


@pytest.mark.parametrize("name", EXPORTS)
def test_an_export_holds_the_same_digits(
    name: str, configuration: Configuration, tmp_path: Path
) -> None:
    EXPORTS[name](tmp_path / name)
    if not name.startswith("targets"):
        shutil.copy(DATA / "targets.csv", tmp_path)
    expected = sorted((p, t, float(length)) for p, t, length in sample())
    assert sorted(lengths(tmp_path / name, configuration)) == expected


@pytest.mark.parametrize("name", ROUNDED)
def test_an_export_that_rounds(name: str, configuration: Configuration, tmp_path: Path) -> None:
    ROUNDED[name](tmp_path / name)
    shutil.copy(DATA / "targets.csv", tmp_path)
    expected = sorted((p, t, float(length)) for p, t, length in sample())
    found = sorted(lengths(tmp_path / name, configuration))
    for (*key, length), (*other, other_length) in zip(found, expected, strict=True):
        assert key == other
        assert length == pytest.approx(other_length, abs=6e-11)
