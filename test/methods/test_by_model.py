"""A small method by its model: places are read twice, and all that a method offers follows."""

import csv
import pickle
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import (
    Grouping,
    Model,
    from_first,
    indicators,
    instrument_effects,
    linear,
)
from rotcal_ros.foundation.errors import DataError, PlanError
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.tables import read_table
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import measurements
from rotcal_ros.methods.by_model import ByModel, Statement
from rotcal_ros.methods.calibration import Calibration
from rotcal_ros.methods.disturbance import of_readings
from rotcal_ros.methods.measurements import planned_table
from rotcal_ros.methods.simulation.settings import SimulationSettings
from rotcal_ros.planning.plan import Plan, numbered_steps, pauses_at_stations
from rotcal_ros.report.page import reliability_section

SIGMA = 0.1 * ARCSEC
PLACES, RUNS = 6, 3
ANGLES = tuple((np.arange(PLACES) * 2.0 * np.pi / PLACES).tolist())
STEPS = numbered_steps(
    ((place, 0, run) for run in range(RUNS) for place in range(PLACES)),
    ANGLES,
    [(0.0, 0.0, 0.0)],
    PointKind.READING,
    n_points=2,
)
PLAN = Plan("places", ANGLES, ((0.0, 0.0, 0.0),), STEPS)
TRUE = np.array([0.0, 1.0, -2.0, 0.5, 3.0, -1.0]) * ARCSEC


@dataclass(frozen=True)
class Nothing:
    """No settings."""


def model(_configuration, read):
    blocks = {"place": PLACES, "zero of run": RUNS}
    return Model(
        blocks=blocks,
        observed=read.value,
        std=np.full(len(read.value), SIGMA),
        equations=linear(indicators((read.position, PLACES), (read.station, RUNS))),
        outputs=from_first(blocks, "place"),
        further={"zero of run": from_first(blocks, "zero of run")},
        words=Words("readings", "a draught", "at it", "at it"),
        groupings=(
            Grouping("run", read.station, along=read.when),
            Grouping("place", read.position),
        ),
        effects=instrument_effects("the level", read.station, read.when, 100.0 * ARCSEC),
    )


OTHERS = ("error motion", "repeatability", "refraction", "tilt", "gauge")


def states(_configuration, _read, found, _stated):
    said = [Protection(effect, "harmless", "there is none") for effect in OTHERS]
    return Statement(("it is a test",), said, {"largest": float(np.abs(found.value).max())})


METHOD = ByModel("places", model, states).method(
    title="Places",
    page="places",
    plan_settings=Nothing,
    solver_settings=Nothing,
    simulation_settings=SimulationSettings,
    simulated_instrument=None,
    plan=lambda _configuration: PLAN,
    disturbances=of_readings(0.1, 10.0),
    table=planned_table({"place": "table_position", "run": "station"}, {"reading_rad": 0.01}),
)


def observed(read):
    return [step.observed((value, 0.0, 0.0)) for step, value in zip(STEPS, read, strict=True)]


def exact():
    return [TRUE[s.table_position] + 5.0 * ARCSEC * s.station for s in STEPS]


def test_exact_readings_give_the_truth_and_what_the_method_says():
    result = METHOD.solve(None, PLAN, observed(exact()))
    assert result.deviations["ECC"] == pytest.approx(TRUE, abs=1e-18)
    assert result.angles.tolist() == list(ANGLES)
    assert (result.verdict, result.warnings) == ("suspect", ("it is a test",))
    assert result.details["largest"] == pytest.approx(3.0 * ARCSEC)
    assert [p.why for p in result.protections if p.effect == "gauge"] == ["there is none"]
    assert result.residuals.target.tolist() == [0] * len(STEPS)
    with pytest.raises(DataError, match="nothing was read"):
        METHOD.solve(None, PLAN, [])


def test_a_method_that_is_silent_about_an_effect_is_told_so():
    silent = ByModel("silent", model, lambda *_: Statement())
    with pytest.raises(DataError, match="silent says nothing of error motion, gauge, refraction"):
        silent.solve(None, PLAN, observed(exact()))


def test_a_plan_that_its_readings_could_not_solve_is_refused():
    METHOD.check_plan(None, PLAN)
    met = (s for s in STEPS if (s.table_position < 3) == (s.station == 0))
    parted = tuple(replace(step, index=index) for index, step in enumerate(met))
    with pytest.raises(PlanError, match=r"with 6 table angles the .* separate place"):
        METHOD.check_plan(None, replace(PLAN, steps=parted))


def test_trials_travel_and_have_the_stated_scatter():
    trials = METHOD.trials(None, PLAN, observed(exact()))
    drawn = pickle.loads(pickle.dumps(trials))(np.random.default_rng(1), 20000)
    result = METHOD.solve(None, PLAN, observed(exact()))
    assert drawn.std(axis=0)[1:] == pytest.approx(result.std["ECC"][1:], rel=0.03)
    assert drawn.mean(axis=0) == pytest.approx(TRUE, abs=0.03 * SIGMA)


@pytest.mark.parametrize("effect", [None, "knock"])
def test_a_measurement_is_spoiled_on_purpose_and_its_truth_is_told(effect):
    sizes = {effect: 50.0 * SIGMA} if effect else {}
    found = METHOD.disturbances.measure(None, PLAN, sizes, 3)
    result = METHOD.solve(None, PLAN, found.observations)
    error = result.deviations["ECC"] - (found.truth["ECC"] - found.truth["ECC"][0])
    assert (np.abs(error) <= 4.5 * np.maximum(result.std["ECC"], 1e-18)).all()
    assert any("moved" in words for words in result.warnings) is bool(effect)
    again = METHOD.disturbances.measure(None, PLAN, {}, 3)
    assert again.truth["ECC"].tolist() == found.truth["ECC"].tolist()


def read(tmp_path, monkeypatch, header, rows, reader=METHOD.table):
    path = tmp_path / "readings.csv"
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])
    setup = SimpleNamespace(source="here")
    monkeypatch.setattr(measurements, "prepare", lambda setup: Calibration(setup, PLAN))
    return reader.read(setup, read_table(path), None).observations


def test_rows_of_a_table_are_steps_in_any_order(tmp_path, monkeypatch):
    rows = [(s.table_position, s.station, value) for s, value in zip(STEPS, exact(), strict=True)]
    found = read(tmp_path, monkeypatch, ("place", "run", "reading_rad"), rows[::-1])
    assert [(o.step, o.mean) for o in found[::-1]] == [
        (step.index, (value, 0.0, 0.0)) for step, value in zip(STEPS, exact(), strict=True)
    ]
    assert METHOD.table.headers == (
        ("place", "run", "reading_rad"),
        ("place", "run", "reading_rad", "time_s"),
    )


def test_a_column_of_times_makes_the_order(tmp_path, monkeypatch):
    header = ("place", "run", "reading_rad", "time_s")
    found = read(tmp_path, monkeypatch, header, [(1, 0, 0.0, 90.5), (0, 0, 0.0, 2e9)])
    assert [o.window_end_ns for o in found] == [90_500_000_000, 2 * 10**18]
    assert not any(o.captured for o in found)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ((6, 0, 0.0), "place 6, run 0 is not in .* places 0 to 5 and runs 0 to 2"),
        ((1, 0, 1.7), "are these arcseconds"),
        ((-1, 0, 0.0), "place must be a whole number from 0"),
    ],
)
def test_rows_that_cannot_be_are_named(tmp_path, monkeypatch, row, words):
    with pytest.raises(DataError, match=words):
        read(tmp_path, monkeypatch, ("place", "run", "reading_rad"), [row])


def test_a_time_that_cannot_be_is_named(tmp_path, monkeypatch):
    header = ("place", "run", "reading_rad", "time_s")
    with pytest.raises(DataError, match="row 2: time_s is 1e\\+12 s; are these milliseconds"):
        read(tmp_path, monkeypatch, header, [(1, 0, 0.0, 1e12)])


COUNTING = planned_table(
    {"place": "table_position", "run": "station"}, {"reading_rad": 0.01}, {"lost": 100.0}
)


def test_a_further_value_may_be_left_out_and_is_a_plain_number(tmp_path, monkeypatch):
    header = ("place", "run", "reading_rad", "lost")
    (told,) = read(tmp_path, monkeypatch, header, [(1, 0, 0.001, 7)], COUNTING)
    assert told.mean == (0.001, 7.0, 0.0)
    (silent,) = read(tmp_path, monkeypatch, header[:3], [(1, 0, 0.001)], COUNTING)
    assert silent.mean == (0.001, 0.0, 0.0)
    assert [h[2:] for h in COUNTING.headers] == [
        ("reading_rad",), ("reading_rad", "time_s"),
        ("reading_rad", "lost"), ("reading_rad", "lost", "time_s"),
    ]  # fmt: skip
    with pytest.raises(DataError, match="row 2: lost is 101, expected 100 at most"):
        read(tmp_path, monkeypatch, header, [(1, 0, 0.001, 101)], COUNTING)


def test_a_person_works_before_each_station():
    pauses = pauses_at_stations(STEPS, "level", ["first", "second", "third"])
    assert [(p.first, p.last, p.instruction) for p in pauses] == [
        (0, 0, "first"), (6, 6, "second"), (12, 12, "third"),
    ]  # fmt: skip
    assert [(p.move.what, p.move.station) for p in pauses] == [
        ("level", 0), ("level", 1), ("level", 2),
    ]  # fmt: skip
    assert {s.n_points for s in STEPS} == {2}


def test_what_the_model_tells_beside_becomes_a_table_in_the_unit_of_its_readings():
    result = METHOD.solve(None, PLAN, observed(exact()))
    assert result.residuals.unit == "rad"
    (table,) = METHOD.tables(result)
    assert (table.name, table.head) == (
        "zero_of_run", ("number", "value_arcsec", "U_value_arcsec"),
    )  # fmt: skip
    number, value, expanded = zip(*table.rows, strict=True)
    assert number == (0, 1, 2)
    assert value == pytest.approx((0.0, 5.0, 10.0), abs=1e-9)
    # a difference of two zeros, each from six readings
    assert list(expanded) == pytest.approx([0.0, *2 * [2 * 0.1 * np.sqrt(2 / 6)]])
    again = type(result).from_dict(result.to_dict())
    assert again.residuals.unit == "rad"


def test_the_report_tells_errors_of_readings_in_their_unit_and_not_in_micrometres():
    page = reliability_section(METHOD.solve(None, PLAN, observed(exact())))
    assert "Error / arcsec" in page
    assert "µm" not in page
