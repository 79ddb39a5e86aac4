"""Plans that come to their angles more than once, and corrected air, enter by their readings."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from carried_tracer import LENGTH_STD, MOTION_STD, DenseTracer, tracer_problem
from joint_world import instrument, polygon
from scipy.optimize import least_squares
from test_joint_methods import MEAN, ROUGH, dense_polygon
from two_groups import ALTERNATING, ANGLES, GRID

import rotcal_ros as rc
from rotcal_ros.evaluation.joint import JointInput, combine, solve_together
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import changed, prepare, read_configuration
from rotcal_ros.methods.arrivals import arrivals_of, mean_of_arrivals, mean_of_runs
from rotcal_ros.methods.measurements import PlannedMeasurements
from rotcal_ros.methods.tracer import solver as tracer
from rotcal_ros.methods.tracer.solver.solution import adjust as adjust_tracer
from rotcal_ros.methods.tracer.solver.solution import curve_model

ROOT = Path(__file__).parents[2]
SCATTER = 0.3 * ARCSEC


@pytest.mark.parametrize(("runs", "bidirectional"), [(2, False), (1, True)])
def test_lengths_of_several_arrivals_and_readings_are_one_least_squares(runs, bidirectional):
    """Of arrivals that scatter about the mean of their side, and the curve is that of both."""
    arrivals = arrivals_of(ANGLES, runs=runs, bidirectional=bidirectional)
    rng, m = np.random.default_rng(5), 2 * GRID
    scatter = SCATTER if runs > 1 else 0.0
    ecc = ALTERNATING[arrivals.target] + scatter * rng.standard_normal(m)
    ecc = ecc + ARCSEC * np.where(arrivals.upward, 1.0, -1.0) * bidirectional
    problem = tracer_problem(
        5, ecc, ANGLES[arrivals.target], keep=lambda position, target: (position + target) % 2 == 0
    )
    assert problem.error_motion_std == MOTION_STD
    model = curve_model(problem, adjust_tracer(problem))
    lengths = JointInput(
        "tracer",
        mean_of_runs(tracer.solve(problem), arrivals),
        mean_of_arrivals(model, arrivals, {"ECC": scatter}),
    )
    measured = polygon(ALTERNATING, np.random.default_rng(6), noise=ROUGH)
    found = solve_together([lengths, instrument("polygon", measured)]).result
    assert found.details["noise"].get("the arrivals of ECC of tracer", 1.0) == 1.0

    dense, (rows, values) = DenseTracer(problem), dense_polygon(measured, GRID)
    size = sum(dense.sizes)
    average = 0.5 * (arrivals.target == np.arange(GRID)[:, None])

    def curve(x):
        """With scatter an unknown of its own, else the mean of both sides."""
        return x[-GRID:] if scatter else average @ x[:m]

    def misfit(x):
        settings = x[size : size + GRID + 3]
        seen = rows @ np.append(curve(x), settings) - values
        apart = (x[:m] - curve(x)[arrivals.target]) / scatter if scatter else np.zeros(0)
        return np.concatenate([dense.misfit(x[:size]), seen, apart])

    start = np.append(dense.start(), np.zeros(GRID + 3 + (GRID if scatter else 0)))
    best = least_squares(misfit, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    scale = np.linalg.norm(best.jac, axis=0)
    inverse = np.linalg.pinv(best.jac / scale, rcond=1e-6) / scale[:, None]
    gain = MEAN @ (inverse[-GRID:] if scatter else average @ inverse[:m])
    std = np.linalg.norm(gain, axis=1)
    assert found.std["ECC"] == pytest.approx(std, rel=2e-3)
    assert np.abs(found.deviations["ECC"] - MEAN @ curve(best.x)).max() < 0.02 * std.min()


BOTH, IN_TURN = "plan.bidirectional=true", "plan.order=targets_per_station"
AIR = (
    "simulation.air={published: true, vacuum_lengths: true, noise_pa: 0.0}",
    "capture.pressure_expected=true",
    "capture.humidity_expected=true",
    "air={refraction: ciddor, vacuum_wavelength_nm: 632.8, temperature_std_k: 2.0}",
)


@pytest.mark.parametrize(
    ("name", "changes", "apart"),
    [
        ("tracer", (BOTH, IN_TURN), 0.2),
        pytest.param("tracer", ("plan.runs=2", BOTH, IN_TURN), 0.2, marks=pytest.mark.slow),
        ("tracer", AIR, 0.2),
        ("ball_plate", (BOTH,), 0.01),
        ("plane_mirror", (BOTH,), 0.7),
        ("angle_comparison", (BOTH,), 0.05),
        pytest.param("tracer_six", (BOTH,), 1.0, marks=pytest.mark.slow),
    ],
)
def test_readings_of_every_method_say_what_its_result_says(name, changes, apart):
    """As near as where it comes to its angles once; how near that is differs by method."""
    sample = ROOT / "examples" / "data" / f"{name}.yaml"
    sample = sample if sample.exists() else ROOT / "config" / f"{name}_demo.yaml"
    configuration = changed(read_configuration(sample), changes)
    seen = tuple(rc.simulate_observations(configuration))
    alone = instrument(name, PlannedMeasurements(prepare(configuration), seen))
    assert alone.model is not None
    found, result = solve_together([alone]).result, combine([alone.alone]).result
    assert found.verdict == "ok"
    for c in result.components:
        assert found.std[c] == pytest.approx(result.std[c], rel=0.1)
        change = np.abs(found.deviations[c] - result.deviations[c])
        assert (change < apart * result.std[c]).all()


def test_the_error_of_the_air_is_one_that_all_lengths_share():
    """A sensor that is off by 2 K makes all lengths wrong by the same 1.9 parts in a million."""
    configuration = changed(read_configuration(ROOT / "examples" / "data" / "tracer.yaml"), AIR)
    seen = rc.simulate_observations(configuration)
    known = changed(configuration, ("air.temperature_std_k=0.0",))

    def model(stated):
        return prepare(stated).model_of_curves(seen).model

    first, second = model(configuration), model(known)
    with_it, without = (m.equations(m.first)[1] / m.std[:, None] for m in (first, second))
    told = without.T @ without
    lost = told - with_it.T @ with_it
    scale = np.sqrt(told.diagonal() + np.finfo(np.float64).tiny)
    size = np.linalg.eigvalsh(lost / scale / scale[:, None])
    assert size[-1] > 0.1
    assert (np.abs(size[:-1]) < 1e-4 * size[-1]).all()


def test_joined_runs_and_readings_are_one_least_squares():
    """Of a station that was interrupted: its later lengths count from another zero.

    Three lengths were read again. That these tell more than the zero is no matter.
    """
    problem, jump = tracer_problem(9), 4e-5
    run = ((problem.position > 5) | ((problem.position == 5) & (problem.target >= 9))).astype(int)
    row = np.flatnonzero((problem.position == 5) & (problem.target < 3))
    rng = np.random.default_rng(9)
    noise = rng.standard_normal((2, len(row)))
    true = problem.length[row] - LENGTH_STD * noise[0]  # of which the first reading is off by that
    later = true + jump + LENGTH_STD * noise[1]
    broken = replace(problem, length=problem.length + jump * run)
    columns = ("position", "target", "length_std")
    more = {c: np.append(getattr(broken, c), getattr(broken, c)[row]) for c in columns}
    when = np.lexsort((broken.target, broken.position, run)).argsort()
    asked = replace(
        broken,
        **more,
        length=np.append(broken.length, later),
        run=np.append(run, np.ones(3, int)),
        again=np.append(0 * run, np.ones(3, int)),
        order=np.append(when, len(run) + np.arange(3)),
    )
    solution = adjust_tracer(asked)
    model = curve_model(asked, solution)
    measured = polygon(ALTERNATING, np.random.default_rng(9), noise=ROUGH)
    both = [JointInput("tracer", tracer.solve(asked), model), instrument("polygon", measured)]
    found = solve_together(both).result

    dense, (rows, values) = DenseTracer(broken), dense_polygon(measured, GRID)
    size = sum(dense.sizes)

    def misfit(x):
        own, zero = x[:size], x[size]
        lengths = dense.misfit(own)
        lengths[: len(run)] += run * zero / LENGTH_STD
        first = lengths[row] + (broken.length[row] - later + zero) / LENGTH_STD
        seen = rows @ np.append(x[:GRID], x[size + 1 :]) - values
        return np.concatenate([lengths, first, seen])

    start = np.append(dense.start(), np.zeros(GRID + 4))
    best = least_squares(misfit, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    scale = np.linalg.norm(best.jac, axis=0)
    inverse = (np.linalg.pinv(best.jac / scale, rcond=1e-6) / scale[:, None])[:GRID]
    std = np.linalg.norm(MEAN @ inverse, axis=1)
    interrupted = np.arange(GRID) == 5
    assert found.std["ECC"] == pytest.approx(std, rel=0.06)
    assert found.std["ECC"][~interrupted] == pytest.approx(std[~interrupted], rel=0.01)
    apart = np.abs(found.deviations["ECC"] - MEAN @ best.x[:GRID]) / std
    assert apart.max() < 0.4
    assert apart[~interrupted].max() < 0.15
