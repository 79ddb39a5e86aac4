"""The details of a result are those of the documentation: every key, and its shape."""

import re
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mirror_cell import measure, measure_direct, paper_cell
from plate_data import simulated
from six_scene import scene

from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.methods import prepare, read_configuration
from rotcal_ros.methods.ball_plate import solver as ball_plate
from rotcal_ros.methods.plane_mirror import solver as plane_mirror
from rotcal_ros.methods.tracer_six import solver as tracer_six

SCRIPT = Path(__file__).parents[2] / "scripts" / "result_schema.py"
CONFIG = Path(__file__).parents[2] / "config"
WAYS = ("direct", "stitching", "registration", "joint")


def documented(method):
    """Return the shape of each field of the details of a method, and those always there."""
    fields = runpy.run_path(str(SCRIPT))["documented"]()
    own = {f.path.replace("?", ""): f for f in fields if method in f.methods}
    return {path: f.shape for path, f in own.items()}, {p for p, f in own.items() if not f.when}


def flat(details, prefix=""):
    """Return all values by their documented key; of lists of entries, each entry's."""
    found = {}
    for key, value in details.items():
        if isinstance(value, dict):
            found |= flat(value, f"{prefix}{key}.")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for entry in value:
                for name, one in flat(entry, f"{prefix}{key}[].").items():
                    found.setdefault(name, []).extend(one)
        else:
            found[prefix + key] = [value]
    return found


LAST, INNER = r"(?<=\.)[^.]+$", r"(?<=\.)[^.]+(?=\.)"
KINDS = {"number": (int, float), "whole": int, "text": str, "flag": bool}


def assert_documented(details, method, sizes):
    """Every value is documented, with its shape, and what is always there is there."""
    (shapes, always), found = documented(method), flat(details)
    assert always <= set(found)
    for given, values in found.items():
        named = (given, *(re.sub(where, "NAME", given) for where in (LAST, INNER)))
        key = next((name for name in named if name in shapes), given)
        if key not in shapes:  # a list or group without entries
            assert not any(values), given
            assert any(path.startswith((f"{given}[]", f"{given}.")) for path in shapes), given
            continue
        *dimensions, last = re.sub(r" (or|with) null", "", shapes[key]).split()
        if last not in KINDS:
            dimensions, last = [*dimensions, last], "number"
        for value in values:
            if value is None or not dimensions:
                assert value is None or isinstance(np.asarray(value).item(), KINDS[last]), key
                continue
            assert np.ndim(value) == len(dimensions) or not len(value), key
            for length, size in zip(np.shape(value), dimensions, strict=False):
                assert length == (int(size) if size.isdigit() else sizes.get(size, length)), key


def test_details_of_the_ball_plate():
    problem, _ = simulated(24, [0, 3, 4, 9, 14, 20], sigma=5e-8)
    sizes = {"N": 24, "R": 6, "S": 24, "k": 144}
    details = ball_plate.solve(problem).details
    assert_documented(details, "ball_plate", sizes)
    gap = problem.take(np.arange(144) != 7)
    details = ball_plate.solve(gap).details
    assert_documented(details, "ball_plate", {**sizes, "k": 143})
    weighted = replace(problem, sigma=None, std=np.linspace(4e-8, 6e-8, 432).reshape(144, 3))
    details = ball_plate.solve(weighted).details
    assert_documented(details, "ball_plate", sizes)


@pytest.mark.parametrize("way", WAYS)
def test_details_of_the_plane_mirror(way):
    deviations = np.zeros((17, 6))
    if way == "direct":
        problem = measure_direct(paper_cell(), deviations, np.array([[0.3, 0.1, 0.1]]))
    else:
        problem = measure(paper_cell(), deviations, way=way)
    details = plane_mirror.solve(problem).details
    assert_documented(details, "plane_mirror", {"N": 17})
    assert details["way"] == way
    if way != "stitching":
        assert [entry["station"] for entry in details["stations"]] == list("012345")


def test_details_of_the_tracer_at_several_places():
    rows = scene(np.random.default_rng(1), m=5, arrivals=2, zero="per_segment", breaks=1).rows
    details = tracer_six.solve(tracer_six.SixProblem(**rows)).details
    assert_documented(details, "tracer_six", {"N": 5, "p": 3, "s": 6, "t": 24})
    assert details["scattering"]["the arrivals"]["contrasts"] > 0


@pytest.mark.parametrize(
    ("method", "knock"), [("angle_comparison", 0.5 * ARCSEC), ("table_balls", 20.0 * MICROMETRE)]
)
def test_details_after_a_knock(method, knock):
    calibration = prepare(read_configuration(CONFIG / f"{method}_demo.yaml"))
    measured = calibration.measured({"knock": knock}, seed=3)
    details = calibration.solve(measured.observations).details
    assert details["effects_found"] or details["gathering"]["blamed"]
    assert_documented(details, method, {"m": 12})
