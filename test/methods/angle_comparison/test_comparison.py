"""Two circles beside each other: signs, truth, uncertainty by order, what cannot be solved."""

import pickle
from pathlib import Path

import numpy as np
import pytest
from coded import coded
from scipy.spatial.transform import Rotation

from rotcal_ros.adjust import engine
from rotcal_ros.foundation.errors import ConfigurationError, ObservabilityError, PlanError
from rotcal_ros.foundation.protection import EFFECTS
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods import (
    changed,
    parse_configuration,
    prepare,
    prepare_to_measure,
    read_configuration,
)
from rotcal_ros.methods.angle_comparison.method import ALL_FIT_IF, REFERENCE_IN_RESULT, STOOD_AT
from rotcal_ros.methods.angle_comparison.model import REFERENCE, Circles, model_of
from rotcal_ros.methods.angle_comparison.settings import (
    ComparisonPlanSettings,
    ComparisonSolverSettings,
)
from rotcal_ros.methods.angle_comparison.simulation import SimulatedComparison
from rotcal_ros.methods.measurements import read_measurements
from rotcal_ros.methods.simulated_run import simulated_run
from rotcal_ros.methods.simulation.table import SimulatedTable, deviations
from rotcal_ros.planning.readings import Readings

SIGMA = 0.05 * ARCSEC
CONFIG = Path(__file__).parents[3] / "config"


def planned(shifts, n=12, *, turns=1, **more):
    """Return settings of a plan with n angles in a turn, and of its closure where turns is 1."""
    return ComparisonPlanSettings(
        table_step_deg=360.0 / n, table_positions=n + turns, shifts_deg=tuple(shifts), **more
    )


class World:
    """Two circles with errors of their own, and readings of them by the words of the module."""

    def __init__(self, plan, seed=1, size=3.0 * ARCSEC):
        rng = np.random.default_rng(seed)
        self.plan, self.circles = plan, Circles.of(plan)
        k, p = self.circles.shown.shape
        self.table, self.reference = {}, {}
        self.zeros = 10.0 * ARCSEC * rng.standard_normal(k)
        self.position, self.station = np.tile(np.arange(p), k), np.repeat(np.arange(k), p)
        value = []
        for number, shift in enumerate(plan.shifts_deg):
            for angle, side in zip(self.circles.angles, self.circles.approaches, strict=True):
                at = (round(angle / DEGREE * 1e6) % 360000000, side)
                shown = round((angle / DEGREE - shift) * 1e6) % 360000000
                for errors, key in ((self.table, at), (self.reference, shown)):
                    errors.setdefault(key, size * rng.standard_normal())
                value.append(self.table[at] - self.reference[shown] + self.zeros[number])
        self.value = np.array(value)
        self.true = np.array([
            self.table[round(a / DEGREE * 1e6) % 360000000, side]
            for a, side in zip(self.circles.angles, self.circles.approaches, strict=True)
        ])  # fmt: skip
        self.true -= self.true[0]

    def model(self, value=None, keep=slice(None), **solver):
        """Return the model of the readings that are kept."""
        value = self.value if value is None else value
        columns = (self.position, self.circles.shown.ravel(), self.station, value)
        order = np.arange(len(value))
        given = {"sigma_arcsec": SIGMA / ARCSEC} | solver
        read = Readings(*(column[keep] for column in (*columns, order)))
        return model_of(self.plan, ComparisonSolverSettings(**given), read)

    def noisy(self, seed=5):
        """Return readings with noise."""
        return self.value + SIGMA * np.random.default_rng(seed).standard_normal(len(self.value))


PLANS = {
    "three shifts": planned((0, 30, 150)),
    "unequal angles": ComparisonPlanSettings(
        table_angles_deg=(0, 20, 50, 90, 140, 200, 270, 330),
        shifts_deg=(0, 20, 30, 50, 70, 90, 110, 120, 180, 200, 250, 270),
    ),
    "both directions": planned((0, 30, 150), bidirectional=True),
    "repeated": planned((0, 30, 0, 30)),
    "no closure": planned((0, 30, 150, 60), turns=0),
}


@pytest.mark.parametrize("name", PLANS)
def test_exact_readings_give_the_truth(name):
    world = World(PLANS[name])
    found = engine.adjust(world.model())
    assert found.value == pytest.approx(world.true, rel=0, abs=1e-17)
    marks = np.round(world.circles.marks / DEGREE * 1e6).astype(int)
    errors = np.array([world.reference[int(m) % 360000000] for m in marks])
    assert found.further[REFERENCE][0] == pytest.approx(errors - errors.mean(), rel=0, abs=1e-17)
    assert found.verdict == "ok"


@pytest.mark.parametrize("turn", [360.0, 400.0])  # degrees, gon
@pytest.mark.parametrize(("faces", "digits"), [(7, 4), (7, 3), (9, 4), (13, 4), (23, 5)])
def test_angles_that_were_rounded_when_they_were_written_are_those_of_the_faces(
    turn, faces, digits
):
    rng, shifts = np.random.default_rng(2), np.array([0, 1, 3])
    table, reference = 3.0 * ARCSEC * rng.standard_normal((2, faces))
    written = np.round(turn / faces * np.arange(faces), digits) * 360.0 / turn
    plan = ComparisonPlanSettings(
        table_angles_deg=tuple(written), shifts_deg=tuple(written[shifts])
    )
    shown = (np.arange(faces) - shifts[:, None]) % faces
    assert (Circles.of(plan).shown == shown).all()
    position, station = np.tile(np.arange(faces), 3), np.repeat(np.arange(3), faces)
    read = Readings(
        position, shown.ravel(), station, (table - reference[shown]).ravel(),
        np.arange(3 * faces),
    )  # fmt: skip
    found = engine.adjust(model_of(plan, ComparisonSolverSettings(sigma_arcsec=0.05), read))
    assert found.value == pytest.approx(table - table[0], rel=0, abs=1e-15)
    assert found.verdict == "ok"


def test_a_table_that_turns_too_far_reads_more_and_a_reference_that_does_reads_less():
    world = World(planned((0, 30, 150)), size=0.0)
    ahead = 4.0 * ARCSEC * (world.position == 5)
    found = engine.adjust(world.model(world.value + ahead))
    assert found.value[5] == pytest.approx(4.0 * ARCSEC)
    turned = -4.0 * ARCSEC * (world.circles.shown.ravel() == 7)
    found = engine.adjust(world.model(world.value + turned))
    assert found.further[REFERENCE][0][7] == pytest.approx(11 / 12 * 4.0 * ARCSEC)


def test_a_polygon_is_such_a_reference():
    """Faces in the order in which they come, their normals turned by matrices before the x axis.

    A face that is turned counter-clockwise comes early: its error is negative.
    """
    world = World(planned((0, -30, -150)))  # at table angle 0 face 0, 1, 5 is seen
    face = 2.0 * ARCSEC * np.random.default_rng(4).standard_normal(12)
    value = []
    for first, position in zip(np.array([0, 1, 5])[world.station], world.position, strict=True):
        seen = Rotation.from_euler("z", (face - 30.0 * DEGREE * np.arange(12))[:, None])
        turned = Rotation.from_euler(
            "z", 30.0 * DEGREE * (position + first) + world.true[position]
        )
        x, y, _ = (turned * seen).apply([1.0, 0.0, 0.0]).T
        value.append(np.arctan2(y, x)[np.argmax(x)])
    found = engine.adjust(world.model(np.array(value)))
    assert found.value == pytest.approx(world.true, abs=1e-9 * ARCSEC)
    assert found.further[REFERENCE][0] == pytest.approx(face.mean() - face, abs=1e-9 * ARCSEC)


def test_readings_that_count_against_the_table_are_turned_round():
    world = World(planned((0, 30, 150)))
    found = engine.adjust(world.model(-world.value, readings_count="against the table"))
    assert found.value == pytest.approx(world.true, abs=1e-17)


@pytest.mark.parametrize("counting", ["with the table", "against the table"])
def test_a_measurement_that_is_drawn_counts_as_the_configuration_says(counting):
    calibration = prepare(
        changed(
            read_configuration(CONFIG / "angle_comparison.yaml"),
            [f"solver.readings_count={counting}"],
        )
    )
    drawn = calibration.measured({}, 3)
    result = calibration.solve(drawn.observations)
    error = result.deviations["ECC"] - (drawn.truth["ECC"] - drawn.truth["ECC"][0])
    assert (np.abs(error) <= 4.5 * np.maximum(result.std["ECC"], 1e-18)).all()
    assert np.ptp(drawn.truth["ECC"]) > 20.0 * result.std["ECC"].max()


@pytest.mark.parametrize("steps", [(0, 1), (0, 1, 5), (0, 2, 3, 7), tuple(range(12))])
def test_the_uncertainty_of_each_order_is_that_of_the_closed_form(steps):
    """Var = K / (K^2 - |S|^2) sigma^2 / N; written down from the two normal equations by hand."""
    n, k = 12, len(steps)
    world = World(planned(30.0 * np.array(steps), turns=0))
    covariance = engine.predicted(world.model())
    found = engine.adjust(world.model())
    fourier = np.exp(-2j * np.pi * np.outer(np.arange(n), np.arange(n)) / n) / n
    by_order = np.real(np.einsum("qi,ij,qj->q", fourier, found.covariance, fourier.conj()))
    orders = np.arange(1, n)
    sums = np.abs(np.exp(2j * np.pi * np.outer(orders, steps) / n).sum(axis=1)) ** 2
    expected = k / (k**2 - sums) * SIGMA**2 / n
    assert found.fit.dof == k * n - (2 * n - 1 + k - 1)
    assert (found.verdict, len(found.doubts)) == (("ok", 0) if found.fit.dof else ("suspect", 1))
    scale = found.scale**2 if found.fit.dof else 1.0
    assert by_order[1:] / scale == pytest.approx(expected, rel=1e-9)
    assert covariance.std == pytest.approx(np.sqrt(found.covariance.diagonal() / scale), rel=1e-9)


@pytest.mark.parametrize("steps", [(0, 1, 5), (0, 2, 3, 7), tuple(range(12))])
def test_a_complete_grid_is_solved_as_by_its_fourier_transform(steps):
    """Order by order from the two normal equations of the module, with noise in the readings."""
    n, k = 12, len(steps)
    world = World(planned(30.0 * np.array(steps), turns=0))
    value = world.noisy()
    read = np.fft.fft(value.reshape(k, n), axis=1)
    turned = np.exp(2j * np.pi * np.outer(steps, np.arange(n)) / n)  # what the reference sees
    mean, seen = read.sum(axis=0), -(turned * read).sum(axis=0)
    sums = turned.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        table = (k * mean + np.conj(sums) * seen) / (k**2 - np.abs(sums) ** 2)
        reference = (k * seen + sums * mean) / (k**2 - np.abs(sums) ** 2)
    table[0] = reference[0] = 0.0  # no reading tells a zero
    curve, errors = np.fft.ifft(table).real, np.fft.ifft(reference).real
    found = engine.adjust(world.model(value))
    assert not found.why
    assert found.value == pytest.approx(curve - curve[0], abs=1e-16)
    assert found.further[REFERENCE][0] == pytest.approx(errors, abs=1e-16)


def test_the_same_as_dense_least_squares_with_constraints():
    world = World(planned((0, 30, 150)))
    value, circles = world.noisy(), world.circles
    n, m, k = circles.n_table, len(circles.marks), 3
    design = np.hstack([
        np.eye(n)[circles.table[world.position]], -np.eye(m)[circles.shown.ravel()],
        np.eye(k)[world.station],
    ])  # fmt: skip
    gauge = np.zeros((2, n + m + k))
    gauge[0, 0] = gauge[1, n : n + m] = 1.0
    normal = np.block([[design.T @ design, gauge.T], [gauge, np.zeros((2, 2))]])
    inverse = np.linalg.inv(normal)[: n + m, : n + m + k]
    x = inverse @ design.T @ value
    found = engine.adjust(world.model(value))
    assert found.value == pytest.approx(x[:n][circles.table], abs=1e-16)
    error, std = found.further[REFERENCE]
    assert error == pytest.approx(x[n:], abs=1e-16)
    assert (std / SIGMA) ** 2 == pytest.approx(inverse.diagonal()[n:], abs=1e-9)
    assert found.covariance[:n, :n] / SIGMA**2 == pytest.approx(inverse[:n, :n], abs=1e-9)


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say():
    world = World(planned((0, 30, 150)))
    found = engine.adjust(world.model())
    rng, inside = np.random.default_rng(3), []
    for _ in range(200):
        again = engine.adjust(world.model(world.value + SIGMA * rng.standard_normal(39)))
        inside.append(np.abs(again.value - world.true)[1:12] <= 2.0 * again.std[1:12])
    assert 0.93 < np.mean(inside) < 0.97
    drawn = found.trials(rng, 20000)
    assert np.cov(drawn.T)[1:12, 1:12] == pytest.approx(
        found.covariance[1:12, 1:12], abs=0.05 * found.covariance.max()
    )


def test_which_angle_is_called_zero_changes_nothing():
    """Turn both circles, and reverse the order of the readings."""
    world = World(planned((0, 30, 150)))
    value = world.noisy()
    one = engine.adjust(world.model(value))
    turned = World(planned((47, 77, 197)))
    two = engine.adjust(turned.model(value))
    assert two.value == pytest.approx(one.value, abs=1e-17)
    mark = np.argmin(np.abs(turned.circles.marks - (-47.0 % 360.0) * DEGREE))
    same = np.roll(two.further[REFERENCE][0], -mark)
    assert same == pytest.approx(one.further[REFERENCE][0], abs=1e-17)
    back = engine.adjust(world.model(value, keep=slice(None, None, -1)))
    assert back.value == pytest.approx(one.value, abs=1e-17)


def test_one_shift_with_a_certificate_carries_its_uncertainty():
    world = World(planned((0,), turns=0))
    errors = [world.reference[round(m / DEGREE * 1e6) % 360000000] for m in world.circles.marks]
    stated = tuple((np.array(errors) / ARCSEC + 2.0).tolist())  # from a zero of its own
    found = engine.adjust(
        world.model(reference_errors_arcsec=stated, reference_std_arcsec=3.0 * SIGMA / ARCSEC)
    )
    assert found.value == pytest.approx(world.true, abs=1e-17)
    assert found.std[1:] == pytest.approx(np.sqrt(2.0 * (1.0 + 3.0**2)) * SIGMA)


def test_missing_readings_widen_what_they_tell_and_a_position_without_any_is_named():
    world = World(planned((0, 30, 150, 60)))
    whole = engine.adjust(world.model())
    some = engine.adjust(world.model(keep=~((world.position == 5) & (world.station > 1))))
    assert some.value == pytest.approx(world.true, abs=1e-17)
    assert some.std[5] > 1.2 * whole.std[5]
    with pytest.raises(
        ObservabilityError, match="no observation determines table angle 7: measure"
    ):
        engine.adjust(world.model(keep=world.position != 7))


def test_on_half_a_turn_the_slope_of_the_table_is_lost_to_the_reference():
    """t + a theta and r + a theta read the same, but for zeros; a whole turn has to close."""
    with pytest.raises(ObservabilityError, match="cannot separate"):
        engine.adjust(World(ComparisonPlanSettings(table_positions=7)).model())


def test_a_wrong_reading_is_left_out_alone():
    world = World(planned((0, 30, 150)))
    value = world.noisy()
    value[17] += 40.0 * SIGMA
    assert list(engine.adjust(world.model(value)).why) == [17]


def test_a_contested_cause_widens_the_reference_and_what_trials_draw():
    """A knock that nobody can tell from its neighbours moves the reference, too."""
    world = World(planned((0, 30, 150)))
    knocked = 0.2 * ARCSEC * ((world.station == 1) & (world.position >= 6))
    found = engine.adjust(world.model(world.noisy(20) + knocked))
    assert found.diagnosis.unresolved_contests
    certain = np.linalg.norm(found.fit.response, axis=1)
    assert (found.further[REFERENCE][1] > 1.001 * certain[13:]).any()
    drawn = pickle.loads(pickle.dumps(found.trials))(np.random.default_rng(1), 20000)
    assert np.cov(drawn.T)[1:12, 1:12] == pytest.approx(
        found.covariance[1:12, 1:12], abs=0.06 * found.covariance.max()
    )


def solved(world, *changes):
    """Return what the method makes of the readings of a world."""
    calibration = prepare(changed(read_configuration(CONFIG / "angle_comparison.yaml"), changes))
    steps = zip(calibration.plan.steps, world.value.tolist(), strict=True)
    return calibration.solve([step.observed((value, 0.0, 0.0)) for step, value in steps])


@pytest.mark.parametrize(
    ("shifts", "changes", "more"),
    [
        ((0, 30, 150), (), ()),
        ((0, 30, 150), ("plan.table_positions=12",), ("axis noise",)),
        ((0,), ("plan.shifts_deg=[0.0]",), ("axis noise", "gauge", "single readings")),
        (
            (0,),
            ("plan.shifts_deg=[0.0]", f"solver.reference_errors_arcsec={[0.0] * 12}"),
            ("axis noise", "gauge", "single readings"),  # one residual, of the closure
        ),
    ],
)
def test_what_the_readings_cannot_show_is_named(shifts, changes, more):
    turns = int("plan.table_positions=12" not in changes)
    bare = {"drift", "recurring drift", "knock", "repeatability", "scale", "slip", "one place"}
    bare |= {"sign of readings", "polygon tilt", *more}
    assert set(solved(World(planned(shifts, turns=turns)), *changes).unprotected) == bare


def test_one_shift_alone_takes_the_reference_for_perfect_and_says_so():
    world = World(planned((0,)))
    result = solved(world, "plan.shifts_deg=[0.0]")
    assert result.verdict == "suspect"
    assert REFERENCE_IN_RESULT in coded(result.warnings[0])
    assert result.deviations["ECC"] == pytest.approx(world.value - world.value[0], abs=1e-17)
    assert not result.details["also"]
    world.value = world.noisy()  # which the closure shows
    closed = solved(world, "plan.shifts_deg=[0.0]")
    assert closed.verdict == "suspect"
    assert closed.warnings[0] == result.warnings[0]


def test_a_drift_that_a_turn_shows_is_taken_off_and_told():
    world = World(planned((0, 30, 150)))
    world.value += 0.5 * ARCSEC * world.position / 12  # ten standard deviations a turn
    result = solved(world)
    assert result.verdict == "suspect"
    assert result.warnings[0].startswith("it looks as if the instrument drifts, by 0.5")
    assert np.abs(result.deviations["ECC"] - world.true).max() < 0.01 * ARCSEC


def test_a_reference_shifted_by_another_step_than_stated_is_not_ok():
    world, stated = World(planned((0, 30, 180))), World(planned((0, 30, 150)))
    stated.value = world.value
    result = solved(stated)
    assert result.verdict != "ok"
    assert ALL_FIT_IF in coded(result.warnings[0])
    assert (2, 180.0, 150.0) in coded(result.warnings[0])[STOOD_AT]


def configured(**settings):
    """Return the demonstration with other settings of its plan and solver."""
    text = (CONFIG / "angle_comparison_demo.yaml").read_text()
    for name, value in settings.items():
        lines = [line for line in text.splitlines() if f" {name}:" in line]
        text = text.replace(lines[0], f"{lines[0].split(name)[0]}{name}: {value}")
    return parse_configuration(text, "demo.yaml")


@pytest.mark.parametrize(
    ("shifts", "words"),
    [
        ("[0, 120, 240]", "nothing separates order 3, 6 of the table from that of the reference"),
        ("[0, 60]", "nothing separates order 6 of the table"),
        ("[0, 90]", "nothing separates order 4 of the table"),
        ("[0, 0]", "nothing separates order 1, 2, 3, 4, 5, 6 of the table"),
        ("[0, 15]", "cannot separate"),
    ],
)
def test_shifts_that_lose_an_order_are_refused_with_its_number(shifts, words):
    with pytest.raises(PlanError, match=words):
        prepare_to_measure(configured(shifts_deg=shifts))


def test_settings_that_contradict_each_other_are_refused():
    with pytest.raises(ConfigurationError, match="at least one shift"):
        prepare(configured(shifts_deg="[]"))
    text = (CONFIG / "angle_comparison.yaml").read_text()
    text = text.replace("reference_errors_arcsec: []", "reference_errors_arcsec: [1.0, 2.0]")
    with pytest.raises(ConfigurationError, match="2 values, but with these table angles"):
        prepare(parse_configuration(text, "x.yaml"))


def test_the_plan_of_the_demonstration_asks_for_each_setting():
    plan = prepare_to_measure(read_configuration(CONFIG / "angle_comparison_demo.yaml")).plan
    assert [(pause.first, pause.last) for pause in plan.pauses] == [(0, 0), (13, 13), (26, 26)]
    assert "shows its zero with the table at -30 deg" in plan.pauses[1].instruction


@pytest.mark.parametrize("count", ["with", "against"])
def test_the_simulated_cell_is_solved_to_its_truth_and_says_all_nine_effects(count):
    counting = f"readings_count={count} the table"
    configuration = changed(
        read_configuration(CONFIG / "angle_comparison_demo.yaml"),
        (f"solver.{counting}", f"simulation.reference.{counting}"),
    )
    calibration = prepare_to_measure(configuration)
    seen = [o for event in simulated_run(calibration) for o in event.observed if o.accepted]
    result = calibration.method.solve(configuration, calibration.plan, seen)
    true = deviations(configuration.simulation.table, np.array(result.angles))["ECC"]
    error = result.deviations["ECC"] - (true - true[0])
    assert result.verdict == "ok"
    assert (np.abs(error[1:12]) < 3.0 * result.std["ECC"][1:12]).all()
    assert [p.effect for p in result.protections if p.effect in EFFECTS] == list(EFFECTS)
    table = SimulatedTable(configuration.simulation.table, 1, 0)
    reference = SimulatedComparison(configuration.simulation, table, None, 0)
    true = np.array([reference.reference_error(a) for a in result.details["reference_angles"]])
    found = result.details["also"][REFERENCE]
    assert np.abs((found["value"] - true + true.mean()) / found["std"]).max() < 4.5


def test_play_of_the_table_is_found_by_both_directions():
    configuration = changed(
        read_configuration(CONFIG / "angle_comparison_demo.yaml"),
        ("plan.bidirectional=true", "simulation.table.backlash_arcsec=6.0"),
    )
    calibration = prepare_to_measure(configuration)
    seen = [o for event in simulated_run(calibration) for o in event.observed if o.accepted]
    result = calibration.solve(seen)
    both = result.directions["ECC"]
    assert len(result.angles) == 13
    assert np.abs((both.reversal + 6.0 * ARCSEC) / both.reversal_std).max() < 4.0
    drawn = calibration.trials(seen)(np.random.default_rng(1), 4000)
    assert drawn.std(axis=0) == pytest.approx(
        result.std["ECC"], abs=0.06 * result.std["ECC"].max()
    )


def test_a_first_reading_beyond_the_alignment_is_told():
    configuration = read_configuration(CONFIG / "angle_comparison_demo.yaml")
    calibration = prepare_to_measure(configuration)
    plan = calibration.plan
    seen = [plan.steps[k].observed((v * ARCSEC, 0.0, 0.0)) for k, v in ((0, 70.0), (13, -61.0))]
    check = calibration.method.check
    assert check(configuration, plan, seen) == (
        "setting 1 reads -61 arcsec at 0 deg, more than 60: align it again",
    )
    good = plan.steps[13].observed((59.0 * ARCSEC, 0.0, 0.0))
    assert check(configuration, plan, [seen[0], good]) == check(configuration, plan, ()) == ()


def table_of(world, path, unit="rad", factor=1.0):
    """Write readings as a table that somebody kept."""
    rows = zip(world.position, world.station, world.noisy() / factor, strict=True)
    lines = [f"position,setting,reading [{unit}]"]
    path.write_text("\n".join([*lines, *(f"{p},{s},{v:.9e}" for p, s, v in rows)]) + "\n")
    return path


@pytest.mark.parametrize(("unit", "factor"), [("rad", 1.0), ("arcsec", ARCSEC)])
def test_a_table_in_any_unit_is_read(tmp_path, unit, factor):
    world = World(planned((0, -30, -150)))
    configuration = configured()
    path = table_of(world, tmp_path / "readings.csv", unit, factor)
    result = read_measurements(path, configuration).solve()
    found = engine.adjust(world.model(world.noisy(), sigma_arcsec=0.026))
    assert result.deviations["ECC"] == pytest.approx(found.value, abs=1e-13)
