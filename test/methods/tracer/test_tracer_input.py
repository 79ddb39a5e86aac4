"""Bad input gives a clear error or a counted rejection; weak geometry is refused by name."""

import json

import numpy as np
import pytest
from chances import LONG, most
from coded import coded
from tracer_scene import arc, low_ring, simulate

from rotcal_ros.adjust.engine import MANY_LOST, SCATTERS
from rotcal_ros.foundation.errors import ConfigurationError, DataError, ObservabilityError
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.tracer.settings import TracerLimits
from rotcal_ros.methods.tracer.solver import TracerProblem, solve
from rotcal_ros.methods.tracer.solver.posed import SAME_ANGLE_DIFFERS
from rotcal_ros.methods.tracer.solver.problem import REPEATS, TOO_FAR, TOO_FEW
from rotcal_ros.methods.tracer.solver.solve import IN_ONE_PLANE, LEAVE_THE_CIRCLE

SCENE = simulate(seed=1)
VARIANTS = [
    {"variant": "station", "target_std": 1e-6},
    {"variant": "joint", "datum": "prior", "target_std": 1e-6},
    {"variant": "joint", "datum": "free"},
]


def rows(**changes):
    """The scene's problem with some rows appended or values replaced."""
    base = SCENE.problem()
    return {
        name: getattr(base, name).copy() for name in ("position", "target", "length")
    } | changes


def spoilt(row, value):
    length = SCENE.problem().length.copy()
    length[row] = value
    return length


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"length": spoilt(17, np.nan)}, "length in row 17 is nan"),
        ({"length": spoilt(3, np.inf)}, "length in row 3 is inf"),
        ({"position": np.full(704, 11)}, r"position index in row 0 is 11, expected 0 to 10"),
        ({"target": np.full(704, -1)}, "target index in row 0 is -1"),
        ({"position": np.zeros(704)}, "whole numbers"),
        ({"length": np.zeros(3)}, r"length has shape \(3,\)"),
        ({"length_std": 0.0}, "length_std in row 0 is 0.0"),
        ({"target_std": -1e-6}, "target_std"),
        ({"targets": np.zeros((64, 2))}, "targets has shape"),
        ({"variant": "joint", "datum": "prior"}, "target_std holds zeros"),
        ({"start_stations": np.zeros((3, 3))}, "start_stations has shape"),
    ],
)
def test_values_are_checked_where_they_enter(changes, text):
    with pytest.raises(DataError, match=text):
        SCENE.problem(**changes)


def test_a_problem_keeps_copies_that_nobody_can_change():
    names = ("position", "target", "length", "targets", "table_angles")
    given = {name: getattr(SCENE.problem(), name).copy() for name in names}
    problem = SCENE.problem(**given)
    for name, array in given.items():
        array += 1
        kept = getattr(problem, name)
        np.testing.assert_array_equal(kept, getattr(SCENE.problem(), name))
        assert not kept.flags.writeable
    lists = {name: getattr(problem, name).tolist() for name in names}
    start = np.zeros((11, 3)).tolist()
    from_lists = SCENE.problem(**lists, length_std=[1e-6] * 704, start_stations=start)
    for name in (*names, "length_std", "target_std", "start_stations"):
        kept = getattr(from_lists, name)
        assert kept.dtype == (np.int64 if name in ("position", "target") else np.float64)
    assert from_lists.length_std.shape == (704,)
    assert from_lists.target_std.shape == (64, 3)


@pytest.mark.parametrize(
    "changes", [{"variant": "magic"}, {"datum": "none"}, {"error_motion_std": np.nan}]
)
def test_unknown_names_and_parameters(changes):
    with pytest.raises(ConfigurationError):
        SCENE.problem(**changes)
    with pytest.raises(ConfigurationError, match="max_rejected_share"):
        TracerLimits(max_rejected_share=1.5)


def test_no_rows_at_all():
    with pytest.raises(DataError, match="no lengths"):
        TracerProblem([], [], [], 1e-7, np.zeros((3, 3)), 0.0, np.zeros(4))


def test_lengths_in_millimetres():
    with pytest.raises(DataError, match="are the lengths in millimetres"):
        solve(SCENE.problem(length=1000 * SCENE.length.ravel()))


def test_targets_in_millimetres():
    with pytest.raises(DataError, match="are they in millimetres"):
        solve(SCENE.problem(targets=1000 * SCENE.targets))


def test_identical_repetition_is_dropped_and_counted():
    problem = SCENE.problem()
    again = {
        name: np.append(getattr(problem, name), getattr(problem, name)[5])
        for name in ("position", "target", "length")
    }
    result = solve(SCENE.problem(**again))
    (rejection,) = result.rejected
    assert rejection.index == 704
    assert coded(rejection.why)[REPEATS] == [(5, "station 0, target 5")]
    assert (result.deviations["ECC"] == solve(problem).deviations["ECC"]).all()
    assert not result.residuals.used[704]
    assert result.verdict == "ok"


def test_contradictory_repetition_names_both_rows():
    problem = SCENE.problem()
    with pytest.raises(DataError, match="rows 5 and 704 both give a length for station 0"):
        solve(
            SCENE.problem(
                position=np.append(problem.position, 0),
                target=np.append(problem.target, 5),
                length=np.append(problem.length, problem.length[5] + 1e-6),
            )
        )


@pytest.mark.parametrize("options", VARIANTS)
def test_spikes_are_rejected_flagged_and_harmless(options):
    scene = simulate(seed=11)
    problem = scene.problem(**options)
    spoilt_rows, sizes = [40, 77, 300, 301, 690], [5e-6, -2e-5, 1e-3, 0.05, 7.0]
    if options["variant"] == "station":  # it sees 1 um of target error as noise
        sizes[0] = 1e-5
    length = problem.length.copy()
    length[spoilt_rows] += sizes
    result = solve(scene.problem(length=length, **options))
    assert [r.index for r in result.rejected] == spoilt_rows
    assert not result.residuals.used[spoilt_rows].any()
    assert result.residuals.used.sum() == 704 - 5
    # a rejected length keeps its residual: what was added to it
    assert result.residuals.residual[spoilt_rows[:4]] == pytest.approx(sizes[:4], abs=3e-6)
    ((_, _, apart, _),) = coded(result.rejected[4].why)[TOO_FAR]
    assert apart == pytest.approx(7.0, abs=0.5)
    error = np.abs(result.deviations["ECC"] - scene.deviation)
    assert (error <= 4 * result.std["ECC"] + 1e-15).all()
    assert result.verdict == "ok"


@pytest.mark.parametrize("options", VARIANTS)
def test_good_data_are_hardly_ever_rejected(options):
    false_alarms = 0
    runs = 60 if LONG else 20
    for seed in range(runs):
        scene = simulate(seed, arc(8), 24, low_ring, target_std=options.get("target_std", 0.0))
        false_alarms += bool(solve(scene.problem(**options)).rejected)
    assert false_alarms <= most(0.01, runs)  # at the default of 1 % per run


@pytest.mark.parametrize("shift", [2e-5, 1e-3])
def test_a_target_with_wrong_coordinates_spoils_nothing(shift):
    scene = simulate(seed=16, n=40, layout=low_ring, target_std=1e-6)
    targets = scene.targets.copy()
    targets[7] += [shift, 0, 0]
    for options in VARIANTS[:2]:
        result = solve(scene.problem(targets=targets, **options))
        assert result.verdict != "ok" or {r.index % 40 for r in result.rejected} == {7}
        error = np.abs(result.deviations["ECC"] - scene.deviation)
        assert (error <= 4 * result.std["ECC"] + 1e-15).all()


def test_many_spikes_are_suspicious():
    length = SCENE.problem().length.copy()
    length[::25] += 1e-4
    result = solve(SCENE.problem(length=length))
    assert result.verdict == "suspect"
    ((*_, share),) = coded(*result.warnings)[MANY_LOST]
    assert share == pytest.approx(3.0)


def test_the_uncertainty_follows_the_noise_not_its_statement():
    keep_all = TracerLimits(rejection_significance=1e-15)
    honest = solve(SCENE.problem(settings=keep_all))
    bold = solve(SCENE.problem(length_std=1e-7, settings=keep_all))
    assert bold.verdict == "suspect"
    assert bold.sigma0 == pytest.approx(2 * honest.sigma0, rel=1e-3)
    found = honest.std["ECC"] * honest.sigma0
    assert bold.std["ECC"] == pytest.approx(found, rel=2e-2)
    assert coded(*bold.warnings)[SCATTERS] == [("the lengths", pytest.approx(2.0, abs=0.05))]
    modest = solve(SCENE.problem(length_std=4e-7))
    assert modest.std["ECC"] == pytest.approx(found, rel=2e-2)
    assert modest.verdict == "ok"


def test_wrong_targets_fail():
    problem = SCENE.problem(targets=SCENE.targets[::-1], length_std=2e-7)
    try:
        result = solve(problem)
    except DataError:
        return
    assert result.verdict == "failed"


def test_closure_that_does_not_close_is_suspect():
    angles = np.append(arc(12), arc(12)[0] + 2 * np.pi)
    scene = simulate(seed=12, angles=angles, layout=low_ring)
    assert solve(scene.problem()).verdict == "ok"
    turn = np.exp(1j * 20 * ARCSEC) * (scene.stations[-1, 0] + 1j * scene.stations[-1, 1])
    scene.stations[-1, :2] = turn.real, turn.imag
    distance = np.linalg.norm(scene.stations[:, None] - scene.targets, axis=2)
    noise = np.random.default_rng(0).normal(scale=2e-7, size=distance.shape)
    result = solve(scene.problem(length=(distance + noise).ravel()))
    assert result.verdict == "suspect"
    assert result.details["closure"][0]["error"] == pytest.approx(20 * ARCSEC, abs=2 * ARCSEC)
    assert SAME_ANGLE_DIFFERS in coded(*result.warnings)


def test_unstated_error_motion_is_seen_on_the_circle():
    scene = simulate(seed=13, layout=low_ring, error_motion=2e-6)
    result = solve(scene.problem())
    assert result.verdict == "suspect"
    assert LEAVE_THE_CIRCLE in coded(*result.warnings)
    stated = solve(scene.problem(error_motion_std=2e-6))
    assert stated.verdict == "ok"
    assert stated.budget["error_motion"][1:].min() > 5 * ARCSEC


def test_clockwise_table_is_told():
    with pytest.raises(DataError, match="clockwise"):
        solve(SCENE.problem(table_angles=-SCENE.angles))
    with pytest.raises(DataError, match=r"start, step and unit of the table angles$"):
        solve(SCENE.problem(table_angles=np.degrees(SCENE.angles)))


def test_blocked_station_is_left_out_and_said():
    problem = SCENE.problem()
    keep = (problem.position != 4) | (problem.target < 3)
    result = solve(
        SCENE.problem(
            position=problem.position[keep],
            target=problem.target[keep],
            length=problem.length[keep],
        )
    )
    assert result.angles.tolist() == np.delete(SCENE.angles, 4).tolist()
    assert result.details["station_ids"].tolist() == [0, 1, 2, 3, 5, 6, 7, 8, 9, 10]
    assert len(result.rejected) == 3
    assert coded(result.rejected[0].why)[TOO_FEW] == [("station 4", 3, 4)]
    assert result.verdict == "suspect"
    assert np.isnan(result.residuals.residual[~result.residuals.used]).all()
    assert json.loads(result.to_json())["verdict"] == "suspect"


@pytest.mark.parametrize(
    ("m", "n", "free", "text"),
    [
        (3, 20, {}, "3 stations .* at least 4"),
        (4, 15, {"variant": "joint", "datum": "free"}, "60 usable lengths .* 61 unknowns"),
    ],
)
def test_counting_names_both_numbers(m, n, free, text):
    with pytest.raises(ObservabilityError, match=text):
        solve(simulate(angles=arc(m), n=n).problem(**free))


def test_least_that_counting_allows():
    scene = simulate(angles=arc(4, 70.0), n=16, layout=low_ring)
    assert solve(scene.problem()).dof == 64 - 16 + 1  # and one radial distance from the circle


@pytest.mark.parametrize(
    ("layout", "text"),
    [
        # all on one line above the table: the place around that line is free
        (lambda n, rng: np.outer(np.linspace(0.3, 0.9, n), [0.1, 0.2, 1.0]), "cannot determine"),
        # level with the tracer: heights are not seen
        (lambda n, rng: low_ring(n, rng) * [1, 1, 0] + [0, 0, 0.12], "mostly z"),
        # a 20 mm cube one metre above: hardly any parallax
        (
            lambda n, rng: rng.uniform([-0.01, -0.01, 0.99], [0.01, 0.01, 1.01], (n, 3)),
            "cannot determine the angle",
        ),
    ],
)
def test_weak_geometry_is_refused_with_its_direction(layout, text):
    with pytest.raises(ObservabilityError, match=text):
        solve(simulate(layout=layout).problem())


def test_targets_in_one_plane_above_the_tracer():
    def flat(n, rng):
        return low_ring(n, rng) * [1, 1, 0] + [0, 0, 0.4]

    scene = simulate(seed=14, layout=flat)
    result = solve(scene.problem())
    assert result.details["stations"] == pytest.approx(scene.stations, abs=2e-6)
    assert IN_ONE_PLANE in coded(*result.warnings)
    mirror = scene.stations * [1, 1, -1] + [0, 0, 0.8]
    above = solve(scene.problem(start_stations=mirror + 1e-3))
    assert above.details["stations"] == pytest.approx(mirror, abs=2e-6)
    assert above.warnings == ()


def test_targets_nearly_in_one_plane_still_tell_the_side():
    def nearly(n, rng):
        return low_ring(n, rng) * [1, 1, 1e-4] + [0, 0, 0.4]

    scene = simulate(seed=15, layout=nearly)
    result = solve(scene.problem())
    assert result.details["stations"] == pytest.approx(scene.stations, abs=2e-6)
    assert result.warnings == ()
