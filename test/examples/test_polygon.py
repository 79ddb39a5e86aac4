"""Cross calibration of table and polygon: signs, truth, uncertainty, what cannot be solved."""

import pickle
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rotcal_polygon.method import check, plan, states
from rotcal_polygon.model import FACE_ERROR, model_of, separable
from rotcal_polygon.settings import PolygonPlanSettings, PolygonSolverSettings
from rotcal_ros.adjust import engine
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.protection import EFFECTS, unprotected
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.planning.readings import Readings

N = 12
SIGMA = 0.05 * ARCSEC


def adjust(measurement):
    """Return what the engine makes of settings and readings."""
    return engine.adjust(model_of(*measurement))


def face_errors(found):
    """Return the errors (n,) of the faces from their mean, and their standard uncertainties."""
    return found.also[FACE_ERROR]


def configured(settings, solver):
    """Return a configuration of these settings."""
    return SimpleNamespace(plan=settings, solver=solver, source="here")


def with_readings(measurement, value):
    """Return the same measurement with other values (n,)."""
    settings, solver, read = measurement
    return settings, solver, replace(read, value=value)


def truth(rng, n=N):
    """Return table deviations from zero and face errors without mean, rad."""
    table, face = 3.0 * ARCSEC * rng.standard_normal((2, n))
    return table - table[0], face - face.mean()


def measured(table, face, first_faces, offsets=None, closure=False, certificate=(), std=SIGMA):
    """Return settings and exact readings, one by one from the model in the module's words."""
    n, rows = len(table), []
    for mounting, first in enumerate(first_faces):
        offset = 0.0 if offsets is None else offsets[mounting]
        for position in range(n + closure):
            seen, at = (first + position) % n, position % n
            rows.append((at, seen, mounting, table[at] + face[seen] + offset))
    *numbers, reading = zip(*rows, strict=True)
    whole = (np.array(column, dtype=np.int64) for column in numbers)
    settings = PolygonPlanSettings(faces=n, first_faces=first_faces, closure=closure)
    known = tuple((np.array(certificate) / ARCSEC).tolist())
    solver = PolygonSolverSettings(
        sigma_arcsec=SIGMA / ARCSEC, face_errors_arcsec=known, face_std_arcsec=std / ARCSEC
    )
    return settings, solver, Readings(*whole, np.array(reading), np.arange(len(rows)))


@pytest.mark.parametrize("first_faces", [(0, 1), (0, 1, 5), (3, 2, 8, 11), (7, 2)])
@pytest.mark.parametrize("closure", [False, True])
def test_exact_readings_give_the_truth(first_faces, closure):
    rng = np.random.default_rng(4)
    table, face = truth(rng)
    offsets = 30.0 * ARCSEC * rng.standard_normal(len(first_faces))
    found = adjust(measured(table, face, first_faces, offsets, closure))
    assert found.value == pytest.approx(table, rel=0, abs=1e-12 * np.abs(table).max() + 1e-18)
    assert face_errors(found)[0] == pytest.approx(face, rel=0, abs=1e-18 + 1e-12 * np.ptp(face))
    m = len(first_faces)
    assert found.fit.dof == m * (N + closure) - (2 * N - 1 + m - 1)
    checked = found.fit.dof > 0  # two mountings without a closure read as much as is unknown
    assert (found.verdict, len(found.doubts), found.why) == (
        "ok" if checked else "suspect", 0 if checked else 1, {},
    )  # fmt: skip


def test_the_signs_are_those_of_the_conventions():
    """A table 4 arcsec too far, and a face turned 4 arcsec counter-clockwise, both read +4."""
    ahead, none = 4.0 * ARCSEC * np.eye(N)[5], np.zeros(N)
    assert measured(ahead, none, (0,))[2].value[5] == 4.0 * ARCSEC
    assert adjust(measured(ahead, none, (0, 1))).value[5] == pytest.approx(4.0 * ARCSEC)
    turned = face_errors(adjust(measured(none, ahead, (0, 1))))[0]
    assert turned[5] == pytest.approx(11 / 12 * 4 * ARCSEC)


@pytest.mark.parametrize(
    ("first_faces", "closure", "more", "bare"),
    [
        ((0, 1, 5), True, {}, ("drift", "knock", "repeatability", "scale", "one place")),
        ((0, 1, 5), False, {},
         ("drift", "knock", "axis noise", "repeatability", "scale", "one place")),
        ((0,), True, {},
         ("drift", "knock", "axis noise", "repeatability", "scale", "gauge", "one place")),
        ((0,), False, {"certificate": np.zeros(N)},
         ("drift", "knock", "axis noise", "repeatability", "scale", "one place")),
    ],
)  # fmt: skip
def test_all_nine_effects_are_stated_and_what_the_readings_cannot_show_is_named(
    first_faces, closure, more, bare
):
    measurement = measured(*truth(np.random.default_rng(1)), first_faces, None, closure, **more)
    settings, solver, read = measurement
    found = adjust(measurement)
    said = states(configured(settings, solver), found)
    result = found.result(
        "polygon", np.arange(N), {"ECC": slice(N)}, (read.position, read.target),
        protections=said.protections,
    )  # fmt: skip
    stated = [p.effect for p in result.protections]
    assert [effect for effect in stated if effect in EFFECTS] == list(EFFECTS)
    assert unprotected(result.protections) == (*bare, "sign of readings")


def test_the_same_as_dense_least_squares_with_constraints():
    """Independent: every unknown its own column, gauge by rows that weigh infinitely more."""
    rng = np.random.default_rng(17)
    first = (0, 1, 5)
    problem = measured(*truth(rng), first, rng.standard_normal(3) * 1e-5, closure=True)
    read = problem[2]
    reading = read.value + SIGMA * rng.standard_normal(len(read.value))
    found = adjust(with_readings(problem, reading))
    columns = [np.eye(N)[read.position], np.eye(N)[read.target], np.eye(3)[read.station]]
    gauge = np.zeros((2, 2 * N + 3))
    gauge[0, 0] = gauge[1, N : 2 * N] = 1.0
    normal = np.block([[np.hstack(columns).T @ np.hstack(columns), gauge.T],
                       [gauge, np.zeros((2, 2))]])  # fmt: skip
    inverse = np.linalg.inv(normal)
    unknowns = inverse[:, : 2 * N + 3] @ (np.hstack(columns).T @ reading)
    error, std = face_errors(found)
    assert found.value == pytest.approx(unknowns[:N], abs=1e-16)
    assert error == pytest.approx(unknowns[N : 2 * N], abs=1e-16)
    assert found.covariance / SIGMA**2 == pytest.approx(inverse[:N, :N], abs=1e-10)
    assert (std / SIGMA) ** 2 == pytest.approx(inverse.diagonal()[N : 2 * N], abs=1e-10)


def test_intervals_hold_the_truth_as_often_as_they_say():
    """4000 runs at once: the estimate is linear in the readings."""
    rng = np.random.default_rng(11)
    table, face = truth(rng)
    found = adjust(measured(table, face, (0, 1, 5), closure=True))
    drawn = found.trials(rng, 4000)
    error, std = drawn - table, found.std
    inside = np.abs(error[:, 1:]) <= 1.96 * std[1:]
    assert 0.93 < inside.mean(axis=0).min() <= inside.mean(axis=0).max() < 0.97
    whole = np.linalg.inv(found.covariance[1:, 1:])
    chi2 = np.einsum("ki,ij,kj->k", error[:, 1:], whole, error[:, 1:])
    assert chi2.mean() == pytest.approx(N - 1, rel=0.03)


def test_turning_all_mountings_and_faces_by_one_changes_nothing():
    """The number that a face carries is nobody's business but its own."""
    rng = np.random.default_rng(2)
    table, face = truth(rng)
    noise = SIGMA * rng.standard_normal(3 * N)
    plain, turned = measured(table, face, (0, 1, 5)), measured(table, np.roll(face, 1), (1, 2, 6))
    assert turned[2].value == pytest.approx(plain[2].value, abs=1e-18)
    one = adjust(with_readings(plain, plain[2].value + noise))
    two = adjust(with_readings(turned, turned[2].value + noise))
    assert two.value == pytest.approx(one.value, abs=1e-17)
    faces = face_errors(two)[0]
    assert faces == pytest.approx(np.roll(face_errors(one)[0], 1), abs=1e-17)


def test_one_mounting_with_a_certificate_carries_its_uncertainty():
    rng = np.random.default_rng(3)
    table, face = truth(rng)
    known = {"certificate": face + 2.0 * ARCSEC, "std": 3.0 * SIGMA}
    found = adjust(measured(table, face, (4,), **known))
    assert found.value == pytest.approx(table, abs=1e-17)  # the certificate's zero is its own
    assert found.std[1:] == pytest.approx(np.sqrt(2.0 * (1.0 + 3.0**2)) * SIGMA)
    assert found.fit.dof == 0


def test_a_perfect_polygon_is_believed_when_nothing_else_is_known():
    table, face = truth(np.random.default_rng(5))
    found = adjust(measured(table, face, (0,)))
    assert not found.also
    assert found.value == pytest.approx(table + face - face[0], abs=1e-17)


def test_a_wrong_reading_is_rejected_alone():
    rng = np.random.default_rng(6)
    table, face = truth(rng)
    problem = measured(table, face, (0, 1, 5), closure=True)
    reading = problem[2].value + SIGMA * rng.standard_normal(3 * (N + 1))
    reading[17] += 40.0 * SIGMA
    found = adjust(with_readings(problem, reading))
    assert list(found.why) == [17]
    assert found.fit.residual[17] > 35.0 * SIGMA
    assert found.fit.dof == 3 * (N + 1) - (2 * N - 1 + 2) - 1


@pytest.mark.parametrize(
    ("first_faces", "good"),
    [((0, 1), True), ((0, 2), False), ((0, 4, 6), False), ((0, 4, 3), True), ((5,), False)],
)
def test_what_separates_polygon_and_table(first_faces, good):
    table, face = truth(np.random.default_rng(8))
    assert separable(N, first_faces) is good
    if good:
        adjust(measured(table, face, first_faces))
    elif len(first_faces) > 1:
        with pytest.raises(ObservabilityError, match="cannot tell"):
            adjust(measured(table, face, first_faces))


def test_a_position_without_reading_is_named():
    settings, solver, read = measured(*truth(np.random.default_rng(9)), (0, 1, 5))
    keep = read.position != 7
    columns = {name: column[keep] for name, column in vars(read).items()}
    with pytest.raises(
        ObservabilityError, match="no observation tells of table position 7: measure"
    ):
        adjust((settings, solver, Readings(**columns)))


def test_a_contested_cause_widens_the_faces_and_what_trials_draw():
    """A knock that nobody can tell from its neighbours moves the faces, too."""
    rng = np.random.default_rng(20)
    settings, solver, read = measured(*truth(rng), (0, 1, 5), closure=True)
    knocked = 0.2 * ARCSEC * ((read.station == 1) & (read.position >= 6))
    noise = SIGMA * rng.standard_normal(len(read.value))
    found = adjust((settings, solver, replace(read, value=read.value + knocked + noise)))
    assert found.diagnosis.open_contests
    certain = np.linalg.norm(found.fit.response, axis=1)
    assert (face_errors(found)[1] > 1.001 * certain[N:]).any()
    drawn = found.trials(rng, 20000)
    assert np.cov(drawn.T)[1:, 1:] == pytest.approx(
        found.covariance[1:, 1:], abs=0.06 * found.covariance.max()
    )
    assert pickle.loads(pickle.dumps(found.trials)).value == pytest.approx(found.value)


def test_the_newest_mounting_has_to_be_aligned_before_the_plan_goes_on():
    settings = PolygonPlanSettings(first_faces=(0, 1), alignment_arcsec=60.0)
    configuration = configured(settings, PolygonSolverSettings())
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
