"""Hundreds of angles: what a result keeps in few numbers is the matrix of the solution."""

import json

import numpy as np
import pytest
from test_turning_lengths import CORRELATED, WHITE, problem_of
from turning_scene import turning_scene

from rotcal_ros.adjust import engine
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.evaluation.harmonics import harmonic_content
from rotcal_ros.foundation.compact import CompactCovariance, kept
from rotcal_ros.foundation.curves.measured import measured_curve
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods.arrivals import Arrivals, mean_of_runs
from rotcal_ros.methods.tracer.solver.solution import adjust
from rotcal_ros.methods.tracer.solver.solve import result_of


def uneven(scene, every):
    """The same lengths at some of the angles alone, which have gaps of any size."""
    chosen = np.flatnonzero(np.isin(scene.angle, every))
    parts = {"angle", "target", "run", "speed", "length", "time", "turn"}
    found = {name: getattr(scene, name)[chosen] for name in parts}
    found["angle"] = np.searchsorted(every, found["angle"])
    ecc = scene.ecc[:, every]
    return type(scene)(
        **found, angles=scene.angles[every], ecc=ecc, nominal=scene.nominal, place=scene.place,
        readings=scene.readings,
    )  # fmt: skip


def both_forms(monkeypatch, scene, *args):
    """The result of a scene with the matrix, and with few numbers."""
    solution, n = adjust(problem_of(scene, *args)), len(scene.angles)
    arrivals = Arrivals(
        scene.angles, np.tile(np.arange(n), 2), np.zeros(2 * n, int), np.repeat([True, False], n)
    )
    found = []
    for full in (10**6, 0):
        monkeypatch.setattr(engine, "FULL", full)
        for each in (solution, solution.found):
            each.__dict__.pop("spread", None)
            each.__dict__.pop("covariance", None)
        found.append(mean_of_runs(result_of(solution), arrivals))
    assert isinstance(kept(found[1].covariance)["ECC"], CompactCovariance)
    assert isinstance(kept(found[0].covariance)["ECC"], np.ndarray)
    return found


def assert_same_result(matrix, compact):
    for a, b in (
        (matrix.covariance["ECC"], compact.covariance["ECC"]),
        (matrix.directions["ECC"].covariance, compact.directions["ECC"].covariance),
    ):
        np.testing.assert_allclose(b, a, atol=1e-9 * a.diagonal().max())
    np.testing.assert_allclose(compact.adjacent_std, matrix.adjacent_std, rtol=1e-7)
    reversal = [own.directions["ECC"].reversal_std for own in (matrix, compact)]
    np.testing.assert_allclose(reversal[1], reversal[0], rtol=1e-7)


@pytest.mark.parametrize(
    ("angles", "correlated_s", "motion"), [(36, 0.0, 0.0), (36, 0.1, None), (90, 0.1, 0.0)]
)
def test_it_is_the_matrix_at_even_angles(monkeypatch, angles, correlated_s, motion):
    scene = turning_scene(3, angles=angles, correlated_s=correlated_s, window_deg=0.5)
    std = CORRELATED if correlated_s else WHITE
    assert_same_result(*both_forms(monkeypatch, scene, std, motion))


@pytest.mark.slow
@pytest.mark.parametrize("correlated_s", [0.0, 0.1])
def test_it_is_the_matrix_at_360_angles(monkeypatch, correlated_s):
    scene = turning_scene(4, angles=360, targets=8, correlated_s=correlated_s, window_deg=0.5)
    std = CORRELATED if correlated_s else WHITE
    assert_same_result(*both_forms(monkeypatch, scene, std))


def test_it_is_the_matrix_at_uneven_angles(monkeypatch):
    every = np.unique(np.random.default_rng(5).integers(0, 72, 40))
    scene = uneven(turning_scene(5, angles=72, correlated_s=0.1), every)
    assert_same_result(*both_forms(monkeypatch, scene, CORRELATED))


def test_what_reads_a_result_gets_the_same_from_either_form(monkeypatch):
    scene = turning_scene(6, angles=36)
    matrix, compact = both_forms(monkeypatch, scene)
    again = Result.from_dict(json.loads(compact.to_json()))
    assert again.to_json() == compact.to_json()
    assert len(compact.to_json()) < len(matrix.to_json())
    each = [harmonic_content(measured_curve(own)) for own in (matrix, again)]
    np.testing.assert_allclose(each[1].amplitude_std, each[0].amplitude_std, rtol=1e-7)
    tables = [table_from_result(own) for own in (matrix, again)]
    np.testing.assert_allclose(tables[1].std, tables[0].std, rtol=1e-7)
