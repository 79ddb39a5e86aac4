"""Observations of every method in one solution: against dense least squares, results, truth."""

from dataclasses import replace

import numpy as np
import pytest
from carried_tracer import DenseTracer, tracer_problem
from chances import LONG, most, scatter, share
from joint_world import POLYGON_NOISE, instrument, polygon
from mirror_cell import measure, paper_cell
from scipy.optimize import least_squares
from six_scene import on_circle, scene
from two_groups import ALTERNATING, ANGLES, GRID, plate_problem

from rotcal_ros.adjust.effects import effect_test
from rotcal_ros.adjust.fit import fit_model
from rotcal_ros.adjust.model import Disturbing, Model, linear
from rotcal_ros.adjust.observable import observe_columns
from rotcal_ros.evaluation.joint import JointInput, combine, solve_together
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import DataError, ObservabilityError
from rotcal_ros.foundation.results import FreeDirection, Result, Zeros
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.ball_plate import solver as ball_plate
from rotcal_ros.methods.plane_mirror import solver as plane_mirror
from rotcal_ros.methods.tracer import solver as tracer
from rotcal_ros.methods.tracer.solver.carried_lengths import WORDS
from rotcal_ros.methods.tracer.solver.solution import adjust as adjust_tracer
from rotcal_ros.methods.tracer.solver.solution import curve_model as tracer_model
from rotcal_ros.methods.tracer_six import solver as tracer_six
from rotcal_ros.methods.tracer_six.solver import adjust as adjust_six
from rotcal_ros.methods.tracer_six.solver.solve import curve_model as six_model

ROUGH = 4.0 * POLYGON_NOISE
MEAN = np.eye(GRID) - 1.0 / GRID


def plate_of(problem, name="plate"):
    model, _ = ball_plate.model_of_curves(problem, problem.angles)
    try:
        return JointInput(name, ball_plate.solve(problem), model)
    except DataError:
        return JointInput(name, nothing(model), model)


def tracer_of(problem, name="tracer"):
    try:
        result, solution = tracer.solve(problem), adjust_tracer(problem)
    except ObservabilityError:
        result, solution = None, None
    model = tracer_model(problem, solution)
    return JointInput(name, nothing(model) if result is None else result, model)


def nothing(model):
    """A result that leaves everything open."""
    count, each = len(model.angles), np.eye(len(model.angles))
    return Result(
        method="a method",
        angles=model.angles,
        deviations={c: np.zeros(count) for c in model.curves},
        std={c: np.ones(count) for c in model.curves},
        covariance=dict.fromkeys(model.curves, each),
        sigma0=1.0,
        dof=0,
        n_observations=len(model.model.observed),
        verdict="suspect",
        zeros=Zeros(free=tuple(FreeDirection("", dict.fromkeys(model.curves, k)) for k in each)),
    )


def rough_polygon(seed, **more):
    random = np.random.default_rng(seed)
    return instrument("polygon", polygon(ALTERNATING, random, noise=ROUGH, **more))


def few(position, target):
    """Three lengths at each angle, for four unknowns that nothing else determines."""
    return target % 6 == position % 6


def dense_polygon(measured, table):
    """Rows of its readings over ``table`` unknowns, then its faces and settings; whitened."""
    rows, values = [], []
    for o in measured.observations:
        row = np.zeros(table + GRID + 3)
        row[o.table_position % GRID] = 1.0
        row[table + round(o.table_position + (0.0, 30.0, 150.0)[o.station] / 30.0) % GRID] = -1.0
        row[table + GRID + o.station] = 1.0
        rows.append(row / ROUGH)
        values.append(o.mean[0] / ROUGH)
    return np.array(rows), np.array(values)


@pytest.mark.parametrize("keep", [None, few])
def test_lengths_and_readings_are_one_least_squares(keep):
    """Whether the lengths can be solved alone, or place not a single station."""
    problem = tracer_problem(1, keep=keep)
    measured = polygon(ALTERNATING, np.random.default_rng(3), noise=ROUGH)
    found = solve_together([tracer_of(problem), instrument("polygon", measured)]).result
    dense, (rows, values) = DenseTracer(problem), dense_polygon(measured, GRID)
    size = sum(dense.sizes)

    def misfit(x):
        return np.append(dense.misfit(x[:size]), rows @ np.append(x[:GRID], x[size:]) - values)

    start = np.append(dense.start(), np.zeros(GRID + 3))
    best = least_squares(misfit, start, x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    scale = np.linalg.norm(best.jac, axis=0)
    inverse = (np.linalg.pinv(best.jac / scale, rcond=1e-6) / scale[:, None])[:GRID]
    std = np.sqrt(((MEAN @ inverse) ** 2).sum(axis=1))
    assert found.std["ECC"] == pytest.approx(std, rel=2e-3)
    assert np.abs(found.deviations["ECC"] - MEAN @ best.x[:GRID]).max() < 0.1 * std.min()


def test_a_plate_and_readings_are_the_combination():
    """The plate is linear, and nothing but ECC is common."""
    shift = 1e-6 * np.random.default_rng(5).standard_normal((GRID, 3))
    problem = plate_problem(range(GRID), ALTERNATING, shift, noise=2e-7, sigma=2e-7, seed=5)
    every = [plate_of(problem), rough_polygon(5)]
    together, after = solve_together(every), combine([each.alone for each in every])
    for c in COMPONENTS:
        std = after.result.std[c]
        assert together.result.std[c] == pytest.approx(std, rel=1e-6)
        apart = together.result.deviations[c] - after.result.deviations[c]
        assert np.abs(apart).max() < 1e-3 * std.min()
    assert [g.chi2 for g in together.groups] == pytest.approx(
        [g.chi2 for g in after.groups], rel=1e-3, abs=1e-6
    )


def dense_plate(problem, table):
    """Rows of the centres in the plane over ``table`` ECC, EXC, EYC, balls and places of the CMM.

    Of what a turned, shifted table does to a nominal place, by hand; whitened.
    """
    rows = []
    for p, b in zip(problem.position, problem.ball_step, strict=True):
        at = problem.angles[(p + b) % GRID]
        row = np.zeros((2, 3 * table + 4 * GRID))
        row[:, p] = problem.radius * np.array([-np.sin(at), np.cos(at)])
        row[:, table + p], row[:, 2 * table + p] = (1.0, 0.0), (0.0, 1.0)
        c, s = np.cos(problem.angles[p]), np.sin(problem.angles[p])
        row[:, 3 * table + 2 * b : 3 * table + 2 * b + 2] = [[c, -s], [s, c]]
        place = 3 * table + 2 * GRID + 2 * ((p + b) % GRID)
        row[:, place : place + 2] = np.eye(2)
        rows.append(row / problem.sigma)
    return np.concatenate(rows), (problem.deviations[:, :2] / problem.sigma).ravel()


def test_two_groups_of_a_plate_and_readings_are_one_least_squares():
    problem = plate_problem(noise=2e-7, sigma=2e-7, seed=6)
    measured = polygon(ALTERNATING, np.random.default_rng(6), noise=ROUGH)
    found = solve_together([plate_of(problem), instrument("polygon", measured)]).result
    centres, of_centres = dense_plate(problem, GRID)
    readings, of_readings = dense_polygon(measured, GRID)
    wide = np.zeros((len(readings), centres.shape[1] + GRID + 3))
    wide[:, :GRID], wide[:, centres.shape[1] :] = readings[:, :GRID], readings[:, GRID:]
    design = np.vstack([np.pad(centres, ((0, 0), (0, GRID + 3))), wide])
    inverse = MEAN @ np.linalg.pinv(design, rcond=1e-9)[:GRID]
    std = np.linalg.norm(inverse, axis=1)
    assert found.std["ECC"] == pytest.approx(std, rel=1e-5)
    curve = inverse @ np.append(of_centres, of_readings)
    assert np.abs(found.deviations["ECC"] - curve).max() < 0.01 * std.min()


@pytest.mark.parametrize("keep", [None, few])
def test_lengths_that_are_no_circle_join_two_groups_of_a_plate(keep):
    """Neither can be solved alone: three angles determine no circle, three lengths no station."""
    angles, ecc = (ANGLES[:3], ALTERNATING[:3]) if keep is None else (ANGLES, ALTERNATING)
    lengths = tracer_of(tracer_problem(1, ecc, angles, keep))
    assert lengths.result.method == "a method"
    six = plate_of(plate_problem(noise=2e-8, sigma=2e-8))
    found = solve_together([six, lengths]).result
    assert (found.verdict, found.components, found.zeros.free) == ("ok", ("ECC",), ())
    assert np.abs(found.deviations["ECC"] - ALTERNATING).max() < 3.5 * found.std["ECC"].max()
    (link,) = found.details["links"]
    assert link["offset"] == pytest.approx(4.0 * ARCSEC, abs=3.5 * link["std"])
    assert link["std"] < 3.0 * ARCSEC
    alone = solve_together([six]).result
    assert alone.zeros.free
    assert alone.verdict == "suspect"


def test_what_two_angles_tell_joins_nothing():
    """ECC of two angles, and the motion of the axis between them: that is one unknown too many."""
    lengths = tracer_of(tracer_problem(1, ALTERNATING[:2], ANGLES[:2]))
    six = plate_of(plate_problem(noise=2e-8, sigma=2e-8))
    found = solve_together([six, lengths]).result
    assert found.verdict == "suspect"
    assert "the offset between the odd and even table positions is not measured" in " ".join(
        found.warnings
    )


def test_several_places_are_their_result_where_no_zero_can_slip():
    problem = tracer_six.SixProblem(
        **scene(np.random.default_rng(1), m=8).rows,
        slip=0.0,
        scatter_translation_std=0.0,
        scatter_rotation_std=0.0,
    )
    solution = adjust_six(problem)
    six = JointInput("six", tracer_six.solve(problem), six_model(solution))
    together, after = solve_together([six]).result, combine([six.alone]).result
    for c in COMPONENTS:
        assert together.std[c] == pytest.approx(after.std[c], rel=1e-3)
        apart = together.deviations[c] - after.deviations[c]
        assert np.abs(apart).max() < 0.02 * after.std[c].min()


def test_two_places_tell_what_they_can_however_wide_the_tilts_are_stated():
    """The tilt about the line through them, which they never feel, others tell."""
    three = scene(np.random.default_rng(2), m=8)

    def of(seen, name, **more):
        problem = tracer_six.SixProblem(
            **seen.rows, slip=0.0, scatter_translation_std=0.0, scatter_rotation_std=0.0, **more
        )
        model = six_model(adjust_six(problem))
        return JointInput(name, tracer_six.solve(problem), model)

    whole = of(three, "three")
    line = scene(np.random.default_rng(3), places=on_circle()[:2], m=8, table=(three.c, three.d))
    few, wide = (of(line, "two", tilt_std=std) for std in (5e-5, 5e-4))
    together, again = (solve_together([whole, two]).result for two in (few, wide))
    alone, after = (combine([m.alone for m in every]).result for every in ([whole], [whole, wide]))
    assert together.verdict == again.verdict == "ok"
    for c in COMPONENTS:
        assert again.std[c] == pytest.approx(together.std[c], rel=2e-3)
        assert (again.std[c] < 0.9 * alone.std[c]).all()
        assert (again.std[c] < after.std[c]).all()
        # what fewer lengths said is as far off as the difference of both covariances
        change = again.deviations[c] - alone.deviations[c]
        allowed = np.sqrt(alone.std[c] ** 2 - again.std[c] ** 2)
        assert (np.abs(change) < 4.0 * allowed).all()


def mirror_of(seed, way):
    """A mirror, seen from six stations, and ECC of its table at the first sixteen positions."""
    rng = np.random.default_rng(seed)
    deviations = np.zeros((17, 6))
    deviations[:16, 3:] = ARCSEC * rng.standard_normal((16, 3)) * [1.0, 1.0, 2.0]
    deviations[16] = deviations[0]
    problem = measure(paper_cell(reflectors=2), deviations, rng=rng, way=way)
    mirror = JointInput("mirror", plane_mirror.solve(problem), plane_mirror.curves(problem)[0])
    return mirror, deviations[:16, 5] - deviations[:16, 5].mean()


def test_a_mirror_is_its_result_as_far_as_that_is_a_least_squares():
    mirror, _ = mirror_of(3, "joint")
    together, after = solve_together([mirror]).result, combine([mirror.alone]).result
    assert together.std["ECC"] == pytest.approx(after.std["ECC"], rel=0.1)
    apart = together.deviations["ECC"] - after.deviations["ECC"]
    assert np.abs(apart).max() < 0.3 * after.std["ECC"].min()


def world(kind, seed):
    """Return instruments that measured one table, and its ECC in the zero of a combination."""
    rng = np.random.default_rng([seed, len(kind)])
    if kind == "mirror":
        mirror, ecc = mirror_of(seed, ("joint", "stitching")[seed % 2])
        return [mirror], ecc
    if kind == "link":
        six = plate_of(plate_problem(noise=2e-7, sigma=2e-7, seed=seed))
        return [six, tracer_of(tracer_problem(seed, ALTERNATING[:3], ANGLES[:3]))], ALTERNATING
    lengths = tracer_of(tracer_problem(seed, keep=few if seed % 2 else None))
    return [lengths, rough_polygon(int(rng.integers(2**31)))], ALTERNATING


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["lengths", "link", "mirror"])
def test_intervals_hold_the_truth(kind):
    runs, inside, squares, dof, sound = 200 if LONG else 8, [], 0.0, 0, 0
    for seed in range(runs):
        instruments, ecc = world(kind, seed)
        together = solve_together(instruments)
        found = together.result
        inside.append(np.abs(found.deviations["ECC"] - ecc) < 1.96 * found.std["ECC"])
        squares += sum(group.chi2 for group in together.groups)
        dof += sum(group.dof for group in together.groups)
        sound += found.verdict == "ok"
    low, high = share(0.95, runs)
    assert low < np.mean(inside) < high
    assert runs - sound <= most(0.15, runs)
    if dof:
        low, high = scatter(dof)
        assert low < squares / dof < high


def test_the_order_of_files_the_world_and_the_index_do_not_matter():
    def solved(shift=0, turn=0.0, backwards=False):
        angles, ecc = np.roll(ANGLES, -shift), np.roll(ALTERNATING, -shift)
        angles = np.where(np.arange(GRID) < GRID - shift, angles, angles + 2.0 * np.pi)
        # without noise a position is the same whatever its number
        lengths = tracer_problem(4, ecc, angles, world=turn, noise=0.0)
        every = [tracer_of(lengths), rough_polygon(4)]
        return solve_together(every[::-1] if backwards else every).result

    first = solved()
    for changed in (solved(backwards=True), solved(turn=0.7), solved(shift=3)):
        apart = changed.deviations["ECC"] - first.deviations["ECC"]
        assert np.abs(apart).max() < 0.02 * first.std["ECC"].min()
        assert changed.std["ECC"] == pytest.approx(first.std["ECC"], rel=0.05)


def test_a_length_that_is_wrong_is_left_out_by_its_number():
    problem = tracer_problem(7)
    length = problem.length.copy()
    length[100] += 2e-5
    found = solve_together([tracer_of(replace(problem, length=length)), rough_polygon(7)]).result
    assert any("station 5, target 10 of tracer" in r.why for r in found.rejected)
    assert np.abs(found.deviations["ECC"] - ALTERNATING).max() < 4.0 * found.std["ECC"].max()


def test_without_an_error_motion_lengths_that_tell_none_have_to_state_it():
    problem = replace(tracer_problem(1, keep=few), error_motion_std=None)
    with pytest.raises(ObservabilityError, match=r"state solver\.error_motion_std_m"):
        tracer_model(problem, None)


def test_errors_in_common_are_those_of_the_whole_covariance():
    rng = np.random.default_rng(8)
    design, common, read = rng.normal(size=(9, 2)), rng.normal(size=(9, 3)), rng.normal(size=9)
    model = Model(
        blocks={"x": 2},
        observed=read,
        std=np.full(9, 0.5),
        equations=linear(design),
        outputs=np.eye(2),
        words=WORDS,
    )
    shared = model.with_common_errors(common)
    rows = shared.equations(np.zeros(2))[1] / 0.5
    inverse = np.linalg.inv(0.25 * np.eye(9) + common @ common.T)
    np.testing.assert_allclose(rows.T @ rows, design.T @ inverse @ design, rtol=1e-9)
    np.testing.assert_allclose(
        rows.T @ shared.observed / 0.5, design.T @ inverse @ read, rtol=1e-9
    )
    np.testing.assert_allclose(model.with_common_errors(np.zeros((9, 0))).observed, read)
    # an effect is tested as by the whole covariance, whether its columns are known or computed
    column = rng.normal(size=(9, 1))
    left = inverse - inverse @ design @ np.linalg.solve(
        design.T @ inverse @ design, design.T @ inverse
    )
    of_all = left @ column @ np.linalg.solve(column.T @ left @ column, column.T @ left)
    for columns in (column, lambda computed: column + 0.0 * computed[:, None]):
        drift = Disturbing("drift", "it drifts", columns, 1.0)
        spoiled = replace(model, effects=(drift,)).with_common_errors(common)
        fit = fit_model(spoiled, np.full(9, True), spoiled.std, spoiled.first)
        test = effect_test(observe_columns(fit, spoiled.effects[0].at(fit.computed)))
        assert test.squares == pytest.approx(read @ of_all @ read, rel=1e-9)
    reads = Disturbing("scale", "its scale is wrong", lambda computed: computed[:, None], 1.0)
    scaled = replace(model, effects=(reads,)).with_common_errors(common)
    np.testing.assert_allclose(
        scaled.effects[0].at(scaled.observed)[:, 0], scaled.observed, rtol=1e-9
    )
