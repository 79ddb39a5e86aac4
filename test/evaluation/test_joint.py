"""Several instruments in one solution: against least squares written down again, and truth."""

from dataclasses import replace

import numpy as np
import pytest
from chances import LONG, most, scatter, share
from joint_world import BALLS_NOISE, POLYGON_NOISE, balls, drawn, instrument, polygon, truth
from two_groups import ALTERNATING, ANGLES, GRID, plate_problem

from rotcal_ros.evaluation.joint import JointInput, combine, predicted_together, solve_together
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.ball_plate.solver import solve
from rotcal_ros.recordings.result_sources import joint_input

SHIFTS, OTHER_SHIFTS = (0.0, -30.0, -150.0), (0.0, -60.0, -90.0)
MEAN = np.eye(GRID) - 1.0 / GRID


def two_polygons(seed, **more):
    """Return the measurements of the alternating table by two polygons."""
    rng = np.random.default_rng(seed)
    first = polygon(ALTERNATING, rng, shifts=SHIFTS)
    return first, polygon(ALTERNATING, rng, shifts=OTHER_SHIFTS, noise=2 * POLYGON_NOISE, **more)


def as_instruments(measured):
    return [instrument(name, m) for name, m in zip(("first", "second"), measured, strict=True)]


def dense(measured):
    """Least squares of all readings: table, faces and settings of each polygon; pseudo-inverse."""
    rows, values, before = [], [], GRID
    for m, shifts, std in zip(
        measured, (SHIFTS, OTHER_SHIFTS), (POLYGON_NOISE, 2 * POLYGON_NOISE), strict=True
    ):
        for o in m.observations:
            row = np.zeros(GRID + 2 * (GRID + 3))
            face = round(o.table_position - shifts[o.station] / 30.0) % GRID
            row[o.table_position % GRID] = 1.0
            row[before + face] = -1.0
            row[before + GRID + o.station] = 1.0
            rows.append(row / std)
            values.append(o.mean[0] / std)
        before += GRID + 3
    inverse = np.linalg.pinv(np.array(rows), rcond=1e-9)
    curve = MEAN @ inverse[:GRID]
    return curve @ np.array(values), curve @ curve.T


def test_it_is_the_least_squares_of_all_readings():
    measured = two_polygons(1)
    found = solve_together(as_instruments(measured)).result
    curve, covariance = dense(measured)
    np.testing.assert_allclose(found.deviations["ECC"], curve, atol=1e-7 * ARCSEC)
    np.testing.assert_allclose(found.covariance["ECC"], covariance, atol=1e-9 * ARCSEC**2)
    assert (found.verdict, found.zeros.counts_from, found.n_observations) == ("ok", "mean", 78)
    # 78 readings; table, two times 12 faces and 3 settings; 1 zero of all tables, 2 of the faces
    assert found.dof == 78 - (GRID + 2 * (GRID + 3)) + 3
    noise = found.details["noise"]
    assert noise == {"the readings of first": 1.0, "the readings of second": 1.0}


@pytest.mark.parametrize("stand", ["observations", "one result", "results"])
def test_it_is_the_combination_where_that_is_exact(stand):
    """Of linear methods with one component, whoever brings observations."""
    every = as_instruments(two_polygons(2))
    if stand != "observations":
        every[0] = replace(every[0], model=None)
    if stand == "results":
        every[1] = replace(every[1], model=None)
    together, after = solve_together(every), combine([each.alone for each in every])
    for of in ("deviations", "std"):
        np.testing.assert_allclose(
            getattr(together.result, of)["ECC"],
            getattr(after.result, of)["ECC"],
            atol=1e-6 * ARCSEC,
        )
    (closure,), (test,) = together.groups, after.groups
    assert (closure.chi2, closure.dof) == (pytest.approx(test.chi2, rel=1e-5), GRID - 1)
    assert closure.weights == pytest.approx(test.weights, rel=1e-5)


def test_readings_join_the_two_groups_of_a_plate():
    """Six balls leave open by how much the odd positions are off; readings show it."""
    six = JointInput("six", solve(plate_problem()))
    assert six.result.zeros.of("ECC", GRID).any()
    readings = instrument("polygon", polygon(ALTERNATING, np.random.default_rng(3)))
    found = solve_together([six, readings]).result
    assert (found.verdict, found.components, found.zeros.free) == ("ok", ("ECC",), ())
    error = found.deviations["ECC"] - ALTERNATING
    assert np.abs(error).max() < 4.0 * found.std["ECC"].max()
    (link,) = found.details["links"]
    assert link["offset"] == pytest.approx(4.0 * ARCSEC, abs=4.0 * link["std"])
    # what both determine: within the groups better than the polygon alone
    alone = combine([readings.alone]).result
    assert (found.std["ECC"] < 0.95 * alone.std["ECC"]).all()


def test_a_link_that_readings_alone_determine_is_named():
    """A polygon whose faces alternate: what it errs by joins the two groups of the plate."""
    six = JointInput("six", solve(plate_problem()))
    alternating = 0.3 * ARCSEC * (-1.0) ** np.arange(GRID)
    rng = np.random.default_rng(3)
    readings = instrument("polygon", polygon(ALTERNATING, rng, added=alternating))
    found = solve_together([six, readings]).result
    assert (np.abs(found.deviations["ECC"] - ALTERNATING) / found.std["ECC"]).max() > 10.0
    assert found.verdict == "ok"
    assert "gauge" in found.unprotected
    gauge = next(p for p in found.protections if p.effect == "gauge")
    assert "comes from polygon alone, whose error nothing checks" in gauge.why
    assert "comes from polygon alone: nothing checks that" in found.warnings[0]


def test_a_contradiction_that_two_may_not_show_is_named():
    """0.04 arcsec of order 2: several u, and seldom found."""
    off, worst, ok = 0.04 * ARCSEC * np.cos(2.0 * ANGLES), [], 0
    for seed in range(3):
        rng = np.random.default_rng(seed)
        first = polygon(ALTERNATING, rng, shifts=SHIFTS, added=off)
        second = polygon(ALTERNATING, rng, shifts=OTHER_SHIFTS, noise=2 * POLYGON_NOISE)
        found = solve_together(as_instruments((first, second))).result
        worst.append((np.abs(found.deviations["ECC"] - ALTERNATING) / found.std["ECC"]).max())
        ok += found.verdict == "ok"
        assert "gauge" in found.unprotected
    assert ok
    assert max(worst) > 2.0


def test_an_instrument_that_differs_is_told_of_three():
    off = 0.5 * ARCSEC * np.cos(3.0 * ANGLES)
    rng = np.random.default_rng(4)
    names = ("sound", "wrong", "sound, too")
    added = (0.0 * off, off, 0.0 * off)
    every = [
        instrument(name, polygon(ALTERNATING, rng, added=own))
        for name, own in zip(names, added, strict=True)
    ]
    found = solve_together(every).result
    assert found.verdict == "suspect"
    assert "order 3 of ECC (cosine, sine) is another for wrong" in found.warnings[0]
    assert np.abs(found.deviations["ECC"] - ALTERNATING).max() < 4.0 * found.std["ECC"].max()
    (effect,) = found.details["effects_found"]
    assert effect["size"] == pytest.approx([0.5 * ARCSEC, 0.0], abs=4.0 * effect["std"].max())


def test_of_two_that_differ_both_are_named_and_either_is_covered():
    off = 0.5 * ARCSEC * np.cos(3.0 * ANGLES)
    found = solve_together(as_instruments(two_polygons(5, added=off))).result
    assert found.verdict == "suspect"
    text = " ".join(found.warnings)
    assert "is another for first" in text
    assert "is another for second" in text
    for true in (ALTERNATING, ALTERNATING + off):
        assert (np.abs(found.deviations["ECC"] - true) < 2.0 * found.std["ECC"] + 1e-9).all()


def test_a_difference_of_no_simple_form_fails_the_closure():
    """Of angles that have nothing to do with each other: enlarged as in a combination.

    By the noise of each alone; in that of all together it would pass for scatter.
    """
    off = 0.25 * ARCSEC * np.random.default_rng(1).standard_normal(GRID)
    together = solve_together(as_instruments(two_polygons(6, added=off)))
    (group,) = together.groups
    assert together.result.verdict == "suspect"
    assert not group.consistent
    assert "ECC: the inputs contradict each other" in " ".join(together.result.warnings)
    after = combine([each.alone for each in as_instruments(two_polygons(6, added=off))])
    assert group.factor == pytest.approx(after.groups[0].factor, rel=1e-5)
    np.testing.assert_allclose(together.result.std["ECC"], after.result.std["ECC"], rtol=1e-5)


def test_a_reading_that_is_wrong_is_left_out_by_the_others():
    measured = two_polygons(7)
    row = 20
    seen = list(measured[0].observations)
    seen[row] = replace(seen[row], mean=(seen[row].mean[0] + 1.0 * ARCSEC, 0.0, 0.0))
    wrong = replace(measured[0], observations=tuple(seen))
    found = solve_together(as_instruments((wrong, measured[1]))).result
    assert [r.index for r in found.rejected] == [row]
    assert "of first" in found.rejected[0].why


def test_intervals_hold_the_truth():
    runs, inside, squares, sound = 400 if LONG else 25, [], [], 0
    for seed in range(runs):
        together = solve_together(as_instruments(two_polygons(1000 + seed)))
        found = together.result
        inside.append(np.abs(found.deviations["ECC"] - ALTERNATING) < 1.96 * found.std["ECC"])
        squares.append(together.groups[0].chi2)
        sound += found.verdict == "ok"
    low, high = share(0.95, runs)
    assert low < np.mean(inside) < high
    low, high = scatter(runs * (GRID - 1))
    assert low < np.mean(squares) / (GRID - 1) < high
    # each alone and both together, at one percent for several tests each
    assert runs - sound <= most(0.1, runs)


@pytest.mark.slow
def test_what_one_instrument_tells_of_a_component_helps_the_other_with_the_rest():
    """Two balls mix ECC with EXC, EYC; a polygon gives ECC. No combination of curves knows."""
    inside, gains = [], []
    for seed in range(60 if LONG else 6):
        rng = np.random.default_rng(100 + seed)
        world = drawn(rng)
        every = [
            instrument("balls", balls(world, rng)),
            instrument("polygon", polygon(world.motions[5], rng)),
        ]
        found = solve_together(every).result
        after = combine([each.alone for each in every]).result
        assert found.components == ("EXC", "EYC", "ECC")
        for c in ("EXC", "EYC"):
            inside.append(np.abs(found.deviations[c] - truth(world)[c]) < 1.96 * found.std[c])
            gains.append(found.std[c] / after.std[c])
    low, high = share(0.95, len(inside))
    assert low < np.mean(inside) < high
    assert np.max(gains) < 1.0 + 1e-6
    assert np.mean(gains) < 0.97
    assert BALLS_NOISE == 1e-6


@pytest.mark.slow
def test_a_result_that_agrees_well_keeps_its_uncertainty_where_it_is_alone():
    """The plate's ECC came out 0.8 of its uncertainty off; no other instrument determines EZC."""
    rng = np.random.default_rng(12)
    world = drawn(rng)
    world.motions[3:5] = 0.0
    problem = plate_problem(
        range(GRID), world.motions[5], world.motions[:3].T, noise=2e-7, sigma=2e-7
    )
    plate = JointInput("plate", solve(problem))
    together = solve_together([instrument("balls", balls(world, rng)), plate])
    found, noise = together.result, together.result.details["noise"]
    assert noise["the result of plate"] < 0.9
    assert (found.std["EZC"] > 0.98 * plate.result.std["EZC"]).all()
    for c in found.components:
        error = found.deviations[c] - truth(world)[c] * (c not in ("EAC", "EBC"))
        assert np.abs(error).max() < 4.0 * found.std[c].max()


def test_the_same_plan_once_more_divides_the_uncertainty_by_the_root_of_two():
    once, again = as_instruments(
        (two_polygons(8)[0], polygon(ALTERNATING, np.random.default_rng(9), shifts=SHIFTS))
    )
    alone, both = predicted_together([once]), predicted_together([once, again])
    assert both.std["ECC"] == pytest.approx(alone.std["ECC"] / np.sqrt(2.0), rel=1e-9)
    assert alone.open == both.open == ()


def test_what_stays_open_is_said_before_it_is_measured():
    six = JointInput("six", solve(plate_problem()))
    again = JointInput("again", solve(plate_problem(seed=5)))
    assert set(predicted_together([six, again]).open) == set(six.result.components)
    readings = instrument("polygon", polygon(ALTERNATING, np.random.default_rng(3)))
    assert "ECC" not in predicted_together([six, readings]).open


def test_data_that_contradict_each_other_alone_join_and_are_doubted(monkeypatch):
    measured = two_polygons(1)
    expected, second = solve_together(as_instruments(measured)).result, as_instruments(measured)[1]

    def refuse(*_arguments):
        raise DataError("the readings contradict each other")

    monkeypatch.setattr("rotcal_ros.methods.calibration.Calibration.solve", refuse)
    found = solve_together([joint_input("first", measured[0]), second]).result
    assert found.verdict == "suspect"
    assert found.warnings == ("first is suspect (alone: the readings contradict each other)",)
    np.testing.assert_allclose(found.deviations["ECC"], expected.deviations["ECC"], atol=1e-15)
    np.testing.assert_allclose(found.std["ECC"], expected.std["ECC"], rtol=1e-9)
    monkeypatch.setattr(
        "rotcal_ros.methods.calibration.Calibration.model_of_curves", lambda *_arguments: None
    )
    with pytest.raises(DataError, match="contradict each other"):
        joint_input("first", measured[0])


def test_what_cannot_be_solved_together():
    first, _ = as_instruments(two_polygons(1))
    with pytest.raises(DataError, match="share 39 observations"):
        solve_together([first, replace(first, name="a copy", result=doubled(first.result))])
    between = replace(
        first,
        name="between",
        model=None,
        result=replace(
            as_instruments(two_polygons(11))[0].result, angles=first.result.angles + 0.1
        ),
    )
    with pytest.raises(DataError, match="fewer than two angles in common"):
        solve_together([first, between])


def doubled(result):
    """Return a result with other numbers of the same observations."""
    return replace(result, deviations={c: 2.0 * d for c, d in result.deviations.items()})
