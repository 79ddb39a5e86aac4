"""``rotcal reprocess --history``: results of bags are kept with those of all tables."""

import pytest

pytest.importorskip("duckdb")
pytest.importorskip("sqlalchemy")
from fleet_bags import configuration_text, write_bag

from rotcal_ros.extensions.history.database import ParkHistory


def test_results_are_kept_and_those_of_nobody_are_told(warm, tmp_path):
    write_bag(tmp_path / "bags" / "one", 1)
    (tmp_path / "setup.yaml").write_text(configuration_text())
    asked = ("reprocess", "bags", "--setup", "setup.yaml", "--workers", 1, "--history", "h.db")
    ran = warm.run("rotcal", *asked, folder=tmp_path)
    assert ran.returncode == 0, ran.stderr
    assert "is not in the history" in ran.stderr
    assert "no serial number" in ran.stderr
    named = "    identity: {serial: 'T1', measured: '2026-03-31'}\n    cell:"
    text = configuration_text().replace("    cell:", named, 1)
    (tmp_path / "setup.yaml").write_text(text)
    ran = warm.run("rotcal", *asked, folder=tmp_path)
    assert ran.returncode == 0, ran.stderr
    with ParkHistory(str(tmp_path / "h.db")) as history:
        assert [entry.serial for entry in history.entries()] == ["T1"]
