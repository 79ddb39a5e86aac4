"""The schema of result.json: every field of real results stands in it, and the other way round."""

import json
import runpy
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from gathered_worlds import mirror_world
from joint_world import polygon
from mirror_cell import measure_direct, paper_cell
from plate_disturbed import DEMO_PLATE, EIGHT, at_one_place, knocked, measured
from segment_scene import measure as lengths_by_segment
from six_scene import scene
from test_mirror_gathering import problem_of
from two_groups import plate_problem

import rotcal_ros as rc
from rotcal_ros.foundation.circumstances import Range
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.identity import Identity, InstrumentIdentity, Instruments
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import changed, prepare, read_configuration
from rotcal_ros.methods.ball_plate import solver as ball_plate
from rotcal_ros.methods.measurements import PlannedMeasurements
from rotcal_ros.methods.plane_mirror import solver as plane_mirror
from rotcal_ros.methods.tracer import solver as tracer
from rotcal_ros.methods.tracer_six import solver as tracer_six

ROOT = Path(__file__).parents[2]
FILES = [
    *sorted((ROOT / "test" / "golden").glob("*/result.json")),
    *sorted((ROOT / "test" / "golden").glob("*/table/result.json")),
    *sorted((ROOT / "examples" / "data").glob("result_*.json")),
]
SCRIPT = runpy.run_path(str(ROOT / "scripts" / "result_schema.py"))
SCHEMA = json.loads(SCRIPT["text"]())
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)
SELDOM = {".ways[].why_not"}
"""Fields that no result here has: of ways that a set-up does not allow, where another one does."""


def described(schema, path=""):
    """Return the paths of all values that a schema describes."""
    found = {path} if "unit" in schema or not _below(schema) else set()
    for name, inner in _below(schema):
        found |= described(inner, f"{path}{name}")
    return found


def _below(schema):
    """Return the schemas of what objects and lists of objects hold, with their part of a path."""
    below = [(f".{name}", inner) for name, inner in schema.get("properties", {}).items()]
    if isinstance(schema.get("additionalProperties"), dict):
        below.append((".*", schema["additionalProperties"]))
    items = schema.get("items", {})
    return [*below, *([("[]", items)] if _below(items) else [])] if items else below


def met(schema, value, path=""):
    """Return the paths of a schema that a value has."""
    below, found = dict(_below(schema)), {path}
    if isinstance(value, dict):
        for name, inner in value.items():
            part = f".{name}" if f".{name}" in below else ".*"
            if part in below:
                found |= met(below[part], inner, f"{path}{part}")
    elif isinstance(value, list) and "[]" in below:
        for inner in value:
            found |= met(below["[]"], inner, f"{path}[]")
    return found


def simulated(plan, *settings, sizes=None):
    given = read_configuration(ROOT / "research" / "power_plans" / f"{plan}.yaml")
    prepared = prepare(changed(given, settings))
    return prepared.solve(prepared.measured(sizes or {}, 0).observations)


def fully_identified(result):
    """Return the result as of a laboratory that states everything."""
    of_one = {name: name for name in InstrumentIdentity.__dataclass_fields__}
    one = InstrumentIdentity(**{**of_one, "calibrated": "2026-03-31"})
    texts = {name: name for name in Identity.__dataclass_fields__}
    texts |= {"laboratory_country": "DE", "tolerance_um": 1.0}
    texts |= dict.fromkeys(("received", "measured"), "2026-03-31")
    names = Instruments.__dataclass_fields__
    given = {
        **texts,
        "tolerance_arcsec": 2.0,
        "instruments": Instruments(**dict.fromkeys(names, one)),
    }
    air = Range(1.0, 0.5, 1.5)
    stated = replace(
        result.circumstances, identity=Identity(**given), temperature_c=air, pressure_pa=air,
        humidity=air,
    )  # fmt: skip
    return replace(result, circumstances=stated)


def of_plates():
    drifting, _ = measured(36, DEMO_PLATE, 1, drift=1)
    moved, _ = measured(36, DEMO_PLATE, 1, displaced=lambda i, j: knocked(36, i, j, 200))
    displaced, _ = at_one_place(1, EIGHT[:2], 3e-6)
    yield from map(ball_plate.solve, (drifting, moved, displaced))
    yield fully_identified(simulated("ball_plate", "plan.bidirectional=true"))


def of_tracers():
    measured_lengths = lengths_by_segment(0)
    count = len(measured_lengths.noise)
    segment = np.arange(count) // (count // 3)
    yield tracer.solve(measured_lengths.problem(0.3 + 0.1 * segment, segment))
    yield simulated("tracer", "plan.table_positions=13")
    yield simulated("tracer", "solver.circle_std_m=1e-6")
    yield simulated("tracer", sizes={"one place": 8e-6})
    yield simulated("tracer_by_station", "plan.bidirectional=true")
    rows = scene(np.random.default_rng(1), m=5, arrivals=2, zero="per_segment", breaks=1).rows
    yield tracer_six.solve(tracer_six.SixProblem(**rows))
    for settings, sizes in (
        ("plan.table_positions=13", {}),
        ("plan.bidirectional=true", {}),
        ("solver.datum=free", {"one place": 8e-6}),
    ):
        yield simulated("tracer_six", settings, sizes=sizes)


def of_mirrors():
    world = mirror_world(3, "half", 10.0)
    yield plane_mirror.solve(problem_of(world, world.disturbed))
    yield plane_mirror.solve(
        measure_direct(paper_cell(), np.zeros((17, 6)), np.array([[0.3, 0.1, 0.1]]))
    )
    yield simulated("plane_mirror")
    yield simulated("plane_mirror", "plan.bidirectional=true")


def of_several():
    six, twelve = (
        ball_plate.solve(plate_problem(balls)) for balls in (range(0, 12, 2), range(12))
    )
    yield six
    yield replace(six, residuals=replace(six.residuals, unit="rad"))
    yield rc.combine(six, twelve)
    yield rc.combine(twelve, ball_plate.solve(plate_problem(range(12), ecc=np.zeros(12), seed=1)))


def of_joint_solutions():
    """Three instruments: one differs by order 3, another has four bad readings in a setting."""
    rng, ecc = np.random.default_rng(4), np.zeros(12)
    off = 0.5 * ARCSEC * np.cos(3.0 * 2.0 * np.pi * np.arange(12) / 12)
    sound, wrong, spoiled = (polygon(ecc, rng, added=own) for own in (ecc, off, ecc))
    bad = [
        replace(o, mean=(o.mean[0] + 20.0 * ARCSEC, *o.mean[1:]))
        if o.station == 1 and o.table_position in (2, 3, 4, 5)
        else o
        for o in spoiled.observations
    ]
    spoiled = PlannedMeasurements(spoiled.calibration, tuple(bad))
    yield rc.solve_together(sound, wrong, spoiled)


def of_balls():
    demo = read_configuration(ROOT / "config" / "table_balls_demo.yaml")
    calibration = prepare(demo)
    yield calibration.solve(calibration.measured({"knock": 2e-5}, seed=3).observations)
    three = [0.15, 0.0, 0.08, -0.07, 0.13, 0.04, -0.07, -0.13, 0.12]
    tilted = ("plan.runs=1", "plan.tilts_deg=[-40.0, 50.0]", f"plan.balls_m={three}")
    turning = ("plan.measure=displacement", "plan.closing=false", "plan.turning_deg_s=[9, -9]")
    for more in ((*tilted, "plan.chain=AC"), (*tilted, "plan.chain=BC"), turning):
        calibration = prepare(changed(demo, more))
        yield calibration.solve(calibration.measured({}, seed=3).observations)
    yield off_together("table_balls", 1, (3, 5, 8), 1e-4)


def of_comparisons():
    yield simulated("angle_comparison", "plan.bidirectional=true")
    yield simulated("angle_comparison", sizes={"drift": 2e-5})
    yield off_together("angle_comparison", 0, (2, 5, 7, 9), 4e-5)


def off_together(plan, station, positions, size):
    """Return a result of which some observations of one setting are off by ``size``."""
    prepared = prepare(read_configuration(ROOT / "research" / "power_plans" / f"{plan}.yaml"))
    return prepared.solve([
        replace(o, mean=(o.mean[0] + size, *o.mean[1:]))
        if o.station == station and o.table_position in positions
        else o
        for o in prepared.measured({}, 0).observations
    ])  # fmt: skip


@pytest.fixture(scope="module")
def results():
    """Return results of all methods, as files have them."""
    methods = (
        of_plates, of_tracers, of_mirrors, of_several, of_joint_solutions, of_balls,
        of_comparisons,
    )  # fmt: skip
    made = [result for results in methods for result in results()]
    return [json.loads(path.read_text()) for path in FILES] + [r.to_dict() for r in made]


def test_the_schema_is_one():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_stored_result_has_described_fields_alone(path):
    assert not list(VALIDATOR.iter_errors(json.loads(path.read_text())))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"verdict": "fine"}, "verdict"),
        ({"sigma0": "1"}, "sigma0"),
        ({"more": 1}, "more"),
        ({"deviations": {"EXX": [0.0]}}, "EXX"),
    ],
)
def test_another_value_or_field_is_refused(change, word):
    result = json.loads(FILES[0].read_text())
    with pytest.raises(jsonschema.ValidationError, match=word):
        VALIDATOR.validate({**result, **change})
    details = {**result["details"], "undescribed": 1}
    with pytest.raises(jsonschema.ValidationError, match="undescribed"):
        VALIDATOR.validate({**result, "details": details})


@pytest.mark.slow
def test_results_of_all_methods_have_described_fields_alone(results):
    assert {result["method"] for result in results} == set(SCHEMA["$defs"])
    for result in results:
        VALIDATOR.validate(result)


@pytest.mark.slow
def test_every_described_field_is_that_of_some_result(results):
    """Of some method, where several share it."""
    found, of_details = set(), set()
    for result in results:
        details = result.pop("details")
        found |= met(SCHEMA, result)
        of_details |= met(SCHEMA["$defs"][result["method"]], details)
    wanted = described({k: v for k, v in SCHEMA.items() if not k.startswith("$")})
    assert wanted - found == {".details"}
    wanted = set().union(*map(described, SCHEMA["$defs"].values()))
    assert wanted - of_details == SELDOM


def test_every_field_has_words_and_every_number_a_unit():
    for field in SCRIPT["documented"]():
        assert field.meaning, field.path
        number = not {"text", "flag", "argument"} & set(field.shape.split())
        base64 = field.path.startswith("raw_data.influence.deviations")
        assert bool(field.unit) == (number or base64), field.path
    assert set(COMPONENTS) == set(SCHEMA["properties"]["std"]["propertyNames"]["enum"])


def test_the_page_lists_every_field():
    page = SCRIPT["filled"]((ROOT / "docs" / "result_json.md").read_text("utf-8"))
    cells = {cell for row in page.splitlines() if row.startswith("| `") for cell in row.split("`")}
    assert {field.path for field in SCRIPT["documented"]()} <= cells
    with pytest.raises(ValueError, match="no line"):
        SCRIPT["filled"]("# A page without the places of the tables")
