"""Cross calibration of table and polygon: signs, truth, uncertainty, what cannot be solved."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rotcal_polygon.adjustment import PolygonProblem, adjust, separable, solve
from rotcal_polygon.calibration import check
from rotcal_polygon.plan import plan
from rotcal_polygon.protections import protections
from rotcal_polygon.settings import PolygonPlanSettings, PolygonSolverSettings
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.protection import EFFECTS, ordered, unprotected
from rotcal_ros.foundation.units import ARCSEC

N = 12
SIGMA = 0.05 * ARCSEC


def truth(rng, n=N):
    """Return table deviations from zero and face errors without mean, rad."""
    table, face = 3.0 * ARCSEC * rng.standard_normal((2, n))
    return table - table[0], face - face.mean()


def measured(table, face, first_faces, offsets=None, closure=False, **more):
    """Return exact readings, written out one by one from the model in the module's words."""
    n, rows = len(table), []
    for mounting, first in enumerate(first_faces):
        offset = 0.0 if offsets is None else offsets[mounting]
        for position in range(n + closure):
            seen, at = (first + position) % n, position % n
            rows.append((at, seen, mounting, table[at] + face[seen] + offset))
    position, seen, mounting, reading = zip(*rows, strict=True)
    whole = (np.array(column, dtype=np.int64) for column in (position, seen, mounting))
    return PolygonProblem(n, *whole, np.array(reading), SIGMA, **more)


@pytest.mark.parametrize("first_faces", [(0, 1), (0, 1, 5), (3, 2, 8, 11), (7, 2)])
@pytest.mark.parametrize("closure", [False, True])
def test_exact_readings_give_the_truth(first_faces, closure):
    rng = np.random.default_rng(4)
    table, face = truth(rng)
    offsets = 30.0 * ARCSEC * rng.standard_normal(len(first_faces))
    found = adjust(measured(table, face, first_faces, offsets, closure))
    assert found.table == pytest.approx(table, rel=0, abs=1e-12 * np.abs(table).max() + 1e-18)
    assert found.face == pytest.approx(face, rel=0, abs=1e-12 * np.abs(face).max() + 1e-18)
    m = len(first_faces)
    assert found.dof == m * (N + closure) - (2 * N - 1 + m - 1)


def test_the_signs_are_those_of_the_conventions():
    """A table 4 arcsec too far, and a face turned 4 arcsec counter-clockwise, both read +4."""
    ahead, none = 4.0 * ARCSEC * np.eye(N)[5], np.zeros(N)
    assert measured(ahead, none, (0,)).reading[5] == 4.0 * ARCSEC
    assert adjust(measured(ahead, none, (0, 1))).table[5] == pytest.approx(4.0 * ARCSEC)
    assert adjust(measured(none, ahead, (0, 1))).face[5] == pytest.approx(11 / 12 * 4 * ARCSEC)


@pytest.mark.parametrize(
    ("first_faces", "closure", "more", "bare"),
    [
        ((0, 1, 5), True, {}, ("drift", "repeatability", "scale")),
        ((0, 1, 5), False, {}, ("drift", "knock", "repeatability", "scale")),
        ((0,), True, {"unknown_faces": False}, ("drift", "repeatability", "scale", "gauge")),
        ((0,), False, {"certificate": np.zeros(N)},
         ("drift", "knock", "axis noise", "repeatability", "scale")),
    ],
)  # fmt: skip
def test_all_nine_effects_are_stated_and_what_the_readings_cannot_show_is_named(
    first_faces, closure, more, bare
):
    stated = protections(measured(np.zeros(N), np.zeros(N), first_faces, None, closure, **more))
    assert [p.effect for p in ordered(stated)] == list(EFFECTS)
    assert unprotected(stated) == bare


def test_the_same_as_dense_least_squares_with_constraints():
    """Independent: every unknown its own column, gauge by rows that weigh infinitely more."""
    rng = np.random.default_rng(7)
    first = (0, 1, 5)
    problem = measured(*truth(rng), first, rng.standard_normal(3) * 1e-5, closure=True)
    reading = problem.reading + SIGMA * rng.standard_normal(len(problem.reading))
    found = solve(replace(problem, reading=reading), np.ones(len(reading), dtype=bool))
    columns = [np.eye(N)[problem.position], np.eye(N)[problem.face], np.eye(3)[problem.mounting]]
    gauge = np.zeros((2, 2 * N + 3))
    gauge[0, 0] = gauge[1, N : 2 * N] = 1.0
    normal = np.block([[np.hstack(columns).T @ np.hstack(columns), gauge.T],
                       [gauge, np.zeros((2, 2))]])  # fmt: skip
    inverse = np.linalg.inv(normal)
    unknowns = inverse[:, : 2 * N + 3] @ (np.hstack(columns).T @ reading)
    assert found.table == pytest.approx(unknowns[:N], abs=1e-16)
    assert found.face == pytest.approx(unknowns[N : 2 * N], abs=1e-16)
    for gain, at in ((found.gain_table, 0), (found.gain_face, N)):
        block = inverse[at : at + N, at : at + N]
        assert found.covariance(gain) / SIGMA**2 == pytest.approx(block, abs=1e-10)


def test_intervals_hold_the_truth_as_often_as_they_say():
    """4000 runs at once: the estimate is linear in the readings."""
    rng = np.random.default_rng(11)
    table, face = truth(rng)
    exact = measured(table, face, (0, 1, 5), closure=True)
    found = adjust(exact)
    noise = SIGMA * rng.standard_normal((4000, len(exact.reading)))
    for gain, true in ((found.gain_table, table), (found.gain_face, face)):
        std = np.sqrt(np.diag(found.covariance(gain)))
        error = (exact.reading + noise) @ gain.T - true
        inside = np.abs(error[:, 1:]) <= 1.96 * std[1:]
        assert 0.93 < inside.mean(axis=0).min() <= inside.mean(axis=0).max() < 0.97
    whole = np.linalg.inv(found.covariance(found.gain_table)[1:, 1:])
    error = noise @ found.gain_table[1:].T
    chi2 = np.einsum("ki,ij,kj->k", error, whole, error)
    assert chi2.mean() == pytest.approx(N - 1, rel=0.03)


def test_turning_all_mountings_and_faces_by_one_changes_nothing():
    """The number that a face carries is nobody's business but its own."""
    rng = np.random.default_rng(2)
    table, face = truth(rng)
    noise = SIGMA * rng.standard_normal(3 * N)
    plain, turned = measured(table, face, (0, 1, 5)), measured(table, np.roll(face, 1), (1, 2, 6))
    assert turned.reading == pytest.approx(plain.reading, abs=1e-18)
    one = adjust(replace(plain, reading=plain.reading + noise))
    two = adjust(replace(turned, reading=turned.reading + noise))
    assert two.table == pytest.approx(one.table, abs=1e-17)
    assert two.face == pytest.approx(np.roll(one.face, 1), abs=1e-17)


def test_one_mounting_with_a_certificate_carries_its_uncertainty():
    rng = np.random.default_rng(3)
    table, face = truth(rng)
    known = {"certificate": face + 2.0 * ARCSEC, "certificate_std": 3.0 * SIGMA}
    found = adjust(measured(table, face, (4,), **known))
    assert found.table == pytest.approx(table, abs=1e-17)  # the certificate's zero is its own
    std = np.sqrt(np.diag(found.covariance(found.gain_table)))
    assert std[1:] == pytest.approx(np.sqrt(2.0 * (1.0 + 3.0**2)) * SIGMA)
    assert found.dof == 0


def test_a_perfect_polygon_is_believed_when_nothing_else_is_known():
    table, face = truth(np.random.default_rng(5))
    found = adjust(measured(table, face, (0,), unknown_faces=False))
    assert found.table == pytest.approx(table + face - face[0], abs=1e-17)
    assert not found.face.any()


def test_a_wrong_reading_is_rejected_alone():
    rng = np.random.default_rng(6)
    table, face = truth(rng)
    problem = measured(table, face, (0, 1, 5), closure=True)
    reading = problem.reading + SIGMA * rng.standard_normal(len(problem.reading))
    reading[17] += 40.0 * SIGMA
    found = adjust(replace(problem, reading=reading))
    assert np.flatnonzero(~found.used).tolist() == [17]
    assert found.residual[17] > 35.0 * SIGMA
    assert found.dof == 3 * (N + 1) - (2 * N - 1 + 2) - 1


@pytest.mark.parametrize(
    ("first_faces", "good"),
    [((0, 1), True), ((0, 2), False), ((0, 4, 6), False), ((0, 4, 3), True), ((5,), False)],
)
def test_what_separates_polygon_and_table(first_faces, good):
    table, face = truth(np.random.default_rng(8))
    assert separable(N, first_faces) is good
    if good:
        adjust(measured(table, face, first_faces))
    else:
        with pytest.raises(ObservabilityError, match="do not separate"):
            adjust(measured(table, face, first_faces))


def test_a_position_without_reading_is_named():
    problem = measured(*truth(np.random.default_rng(9)), (0, 1, 5))
    keep = problem.position != 7
    columns = ("position", "face", "mounting", "reading")
    part = replace(problem, **{name: getattr(problem, name)[keep] for name in columns})
    with pytest.raises(ObservabilityError, match=r"positions \[7\] have no reading"):
        adjust(part)


def test_the_newest_mounting_has_to_be_aligned_before_the_plan_goes_on():
    settings = PolygonPlanSettings(first_faces=(0, 1), alignment_arcsec=60.0)
    configuration = SimpleNamespace(plan=settings, solver=PolygonSolverSettings(), source="here")
    planned = plan(configuration)
    assert [(pause.first, pause.last) for pause in planned.pauses] == [(0, 0), (13, 13)]
    first, second = (
        planned.steps[index].observed((reading * ARCSEC, 0.0, 0.0))
        for index, reading in ((0, 70.0), (13, -61.0))
    )
    assert check(configuration, planned, ()) == ()
    (words,) = check(configuration, planned, (first, second))
    assert words == "mounting 1 reads -61 arcsec at position 0, allowed 60"
    good = planned.steps[13].observed((59.0 * ARCSEC, 0.0, 0.0))
    assert check(configuration, planned, (first, good)) == ()
