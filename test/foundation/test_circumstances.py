"""The circumstances of a result: the same from a configuration and from a file, never lost."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rotcal_ros as rc
from rotcal_ros.foundation.circumstances import Circumstances, Range, StepCounts
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods import changed, prepare, read_configuration

CONFIG = Path(__file__).parents[2] / "config"
SECOND = 1_000_000_000
BEGUN_NS = 1_790_000_000 * SECOND


def observed(calibration):
    """Exact observations one second apart, growing warmer, the third at its second attempt."""
    for i, seen in enumerate(calibration.nominal_observations()):
        start = BEGUN_NS + i * SECOND
        yield replace(
            seen, attempt=int(i == 2), temperature_c=20.0 + 0.001 * i,
            window_start_ns=start, window_end_ns=start + SECOND // 2,
        )  # fmt: skip


@pytest.fixture(scope="module")
def real():
    # The machine's own lengths: exact ones would show that the stated noise is wrong.
    configuration = changed(
        read_configuration(CONFIG / "tracer.yaml"),
        ["identity.serial='0815'", "plan.box_points=[2, 2, 2]"],
    )
    return prepare(configuration)


def test_a_result_says_who_when_how_warm_and_how_many(real):
    seen = list(observed(real))
    result = real.solve(seen[:-1])
    found = result.circumstances
    n = len(seen)
    assert not result.simulated
    assert "SIMULATED" not in result.verdict_line
    assert found.axis == "C"
    assert found.identity.serial == "0815"
    assert (found.begun_ns, found.ended_ns) == (
        BEGUN_NS, BEGUN_NS + (n - 2) * SECOND + SECOND // 2,
    )  # fmt: skip
    assert found.counts == StepCounts(planned=n, used=n - 1, skipped=1, retried=1)
    assert found.temperature_c.lowest == 20.0
    assert found.temperature_c.highest == pytest.approx(20.0 + 0.001 * (n - 2))
    assert found.temperature_c.mean == pytest.approx(20.0 + 0.0005 * (n - 2))
    assert found.pressure_pa is None


def test_times_that_count_from_the_start_of_a_table_are_no_dates(real):
    early = [replace(o, window_start_ns=5 * SECOND, window_end_ns=6 * SECOND)
             for o in observed(real)]  # fmt: skip
    found = real.solve(early).circumstances
    assert (found.begun_ns, found.ended_ns) == (None, None)


def test_they_come_back_from_a_file(real):
    result = real.solve(observed(real))
    assert Result.from_dict(result.to_dict()).circumstances == result.circumstances


def test_what_is_not_known_is_not_written():
    assert Circumstances().to_dict() == {"simulated": False}
    known = Circumstances(simulated=True, identity=Identity(item="table"))
    assert known.to_dict() == {"simulated": True, "identity": {"item": "table"}}
    assert Range.of([None, None]) is None
    assert Range.of([1.0, None, 3.0]) == Range(2.0, 1.0, 3.0)


@pytest.mark.parametrize("name", ["tracer", "tracer_six"])
def test_the_simulated_twin_of_a_real_configuration_measures_the_same(name):
    real, simulated = (
        read_configuration(CONFIG / f"{name}{twin}.yaml") for twin in ("", "_simulated")
    )
    assert not real.simulated
    assert simulated.simulated
    for group in ("cell", "plan", "capture", "solver"):
        assert getattr(real, group) == getattr(simulated, group)


@pytest.mark.parametrize("path", sorted(CONFIG.glob("*.yaml")), ids=lambda path: path.stem)
def test_a_configuration_that_simulates_says_so_in_its_name_or_first_line(path):
    text = path.read_text()
    if "ros__parameters" not in text or "\n    simulation:" not in text:
        return
    assert "SIMULATED" in text.splitlines()[0]


def test_a_table_from_a_simulation_is_marked_and_its_mark_is_in_its_hash():
    result = rc.read_result(CONFIG.parent / "examples/data/result_ball_plate.json")
    real = replace(result, circumstances=Circumstances(identity=Identity(item="table")))
    marked = replace(real, circumstances=replace(real.circumstances, simulated=True))
    plain, simulated = rc.make_table(real), rc.make_table(marked)
    assert (plain.simulated, simulated.simulated) == (False, True)
    assert plain.item == simulated.item == "table"
    assert np.array_equal(plain.correction_forward, simulated.correction_forward)
    assert plain.table_hash != simulated.table_hash


def test_exported_files_of_a_simulation_say_so(tmp_path):
    result = rc.read_result(CONFIG.parent / "examples/data/result_ball_plate.json")
    marked = replace(result, circumstances=Circumstances(simulated=True))
    files = rc.write_controller_files(rc.make_table(marked), "csv", tmp_path, replaces=True)
    assert sorted(file.name for file in files) == [
        "c_csv_simulated.csv", "c_csv_simulated.provenance.json",
    ]  # fmt: skip
    side = json.loads((tmp_path / "c_csv_simulated.provenance.json").read_text())
    assert side["simulated"] is True
    assert any("SIMULATED" in warning for warning in side["warnings"])


SUMMER_NIGHT_NS = 1_774_915_200 * SECOND
"""The first moment of 2026-03-31 in UTC, by date(1)."""


def test_the_day_is_that_of_the_stamps_else_the_stated_one():
    stated = Identity(measured="2026-03-31T10:00")
    assert Circumstances().days is None
    assert Circumstances().from_ns == 0
    assert Circumstances(identity=stated).days == ("2026-03-31", "2026-03-31")
    assert Circumstances(identity=stated).from_ns == SUMMER_NIGHT_NS
    ended = SUMMER_NIGHT_NS + 86_400 * SECOND
    other = Identity(measured="1999-01-01")
    stamped = Circumstances(identity=other, begun_ns=SUMMER_NIGHT_NS - 1, ended_ns=ended)
    assert stamped.days == ("2026-03-30", "2026-04-01")
    assert stamped.from_ns == SUMMER_NIGHT_NS - 1


def test_stated_air_gives_way_to_what_was_captured(real):
    air = ["air.temperature_c=25.0", "air.pressure_pa=95000.0", "air.humidity=0.4"]
    calibration = prepare(changed(real.configuration, air))
    seen = list(observed(calibration))
    found = calibration.solve(seen).circumstances
    assert found.temperature_c.lowest == 20.0
    assert found.pressure_pa == Range(95000.0, 95000.0, 95000.0)
    unreported = calibration.solve(replace(o, temperature_c=None) for o in seen).circumstances
    assert unreported.temperature_c == Range(25.0, 25.0, 25.0)
    assert unreported.humidity == Range(0.4, 0.4, 0.4)
