"""The rules of verdict, closure and join at their limits; block matrices against dense ones."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, norm
from tracer_scene import arc, low_ring, simulate

from rotcal_ros.adjust.closures import Closure
from rotcal_ros.adjust.noise import GlobalTest
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.results import ErrorMotion
from rotcal_ros.methods.tracer.settings import TracerLimits
from rotcal_ros.methods.tracer.solver.joined_runs import (
    RepeatedLengths,
    Runs,
    adjust_joined,
    join_of,
)
from rotcal_ros.methods.tracer.solver.network import eliminate
from rotcal_ros.methods.tracer.solver.observability import (
    check_counts,
    check_station_spread,
    name_direction,
    weakest_direction,
)
from rotcal_ros.methods.tracer.solver.problem import arrange
from rotcal_ros.methods.tracer.solver.screening import NoiseFactors
from rotcal_ros.methods.tracer.solver.solution import adjust
from rotcal_ros.methods.tracer.solver.solve import solve
from rotcal_ros.methods.tracer.solver.verdict import Evidence, judge

LIMITS = TracerLimits()
GOOD = Evidence(
    lengths=GlobalTest(1.0, 0.5),
    noise=NoiseFactors(np.ones(5), np.full(5, np.nan), np.full(5, 1e-7), estimated=False),
    unexplained=1.0,
    circle=GlobalTest(1.0, 0.5),
    error_motion=ErrorMotion(0.0, 0.0, 1e-7, 7, 0.0),
    radial_rms=1e-7,
    closures=(Closure(0, 9, 1e-7, 1e-7),),
    n_lengths=100,
    n_rejected=0,
    missing=(),
    spare=(),
    unchecked=0,
    mirror_ambiguous=False,
)


def noise(component, factor, sure=20.0):
    """One component is ``factor`` times as stated, ``sure`` of its standard deviations off."""
    factors, log_std = np.ones(5), np.ones(5)
    factors[component] = factor
    log_std[component] = abs(np.log(factor)) / sure
    return NoiseFactors(factors, log_std, np.full(5, 1e-7), estimated=True)


def test_good_evidence_leaves_nothing_to_say():
    assert judge(GOOD, LIMITS) == ("ok", ())


@pytest.mark.parametrize(
    ("changes", "verdict", "words"),
    [
        ({"n_rejected": 3}, "ok", ()),  # 3 % are allowed
        ({"n_rejected": 4}, "suspect", ("4 of 100 lengths (4.0 %) were rejected, more than 3 %",)),
        ({"n_rejected": 20}, "suspect", ("20 of 100",)),  # a fifth is not more than a fifth
        ({"n_rejected": 21}, "failed", ("21 of 100",)),
        ({"noise": noise(0, 10.0)}, "suspect", ("is 10 times its stated 1e-07 m",)),
        ({"noise": noise(0, 10.01)}, "failed", ("the scatter of the lengths is 10 times",)),
        ({"noise": noise(3, 30.0)}, "suspect", ("the targets' y is 30 times",)),
        ({"noise": noise(4, 30.1)}, "failed", ("the targets' z is 30 times",)),
        ({"noise": noise(2, 1.4, 3.27)}, "ok", ("so the estimate is used",)),
        ({"noise": noise(2, 1.4, 3.31)}, "suspect", ("the targets' x is 1.4 times",)),
        ({"noise": noise(1, 0.5, 9.0)}, "ok", ("is 0.5 times its stated",)),
        ({"unexplained": 1.5}, "suspect", ("are 1.50 times what their",)),
        ({"unexplained": 10.01}, "failed", ("are 10.01 times what their",)),
        ({"spare": (4, 6)}, "ok", ("target(s) 4, 6 of the free network were left out",)),
        ({"circle": GlobalTest(2.0, 0.00101)}, "ok", ()),
        ({"circle": GlobalTest(2.0, 0.00099)}, "suspect", ("1e-07 m (rms), 2.0 times what is",)),
        ({"missing": (2, 5)}, "suspect", ("no deviation for station(s) 2, 5: too few",)),
        ({"unchecked": 3}, "ok", ("3 lengths are checked by no other",)),
        ({"mirror_ambiguous": True}, "ok", ("give start_stations to choose the other",)),
        (
            {"missing": (1,), "n_rejected": 30, "unchecked": 2},
            "failed",
            ("30 of 100", "station(s) 1", "2 lengths"),
        ),
    ],
)
def test_each_rule_and_its_words(changes, verdict, words):
    found, warnings = judge(replace(GOOD, **changes), LIMITS)
    assert found == verdict
    assert len(warnings) == len(words)
    for text, word in zip(warnings, words, strict=True):
        assert word in text


def test_a_closure_may_be_as_large_as_the_normal_quantile():
    """Two sides of a false alarm of one in a thousand: 3.29 standard deviations."""
    limit = norm.isf(0.0005)
    for size, verdict in ((limit - 0.001, "ok"), (limit + 0.001, "suspect")):
        for sign in (1, -1):
            closure = Closure(2, 7, sign * size * 1e-6, 1e-6)
            found, warnings = judge(replace(GOOD, closures=(closure,)), LIMITS)
            assert found == verdict
            assert len(warnings) == (verdict != "ok")
    arcsec = np.degrees(-size * 1e-6) * 3600.0
    assert (
        f"stations 2 and 7 stand at the same table angle but differ by {arcsec:.3g} arcsec"
        in (warnings[0])
    )
    assert "expected 0 with a standard deviation of 0.206 arcsec" in warnings[0]


def test_what_the_verdict_rests_on_is_counted():
    """One length twice, two spikes, one station with too few lengths."""
    scene = simulate(3, angles=arc(9), n=24, layout=low_ring)
    length = scene.length.copy()
    length[1, 3] += 1e-4
    length[4, 7] -= 1e-4
    position, target = np.divmod(np.arange(9 * 24), 24)
    keep = (position != 6) | (target < 3)
    rows = {
        "position": np.append(position[keep], 0),
        "target": np.append(target[keep], 0),
        "length": np.append(length.ravel()[keep], length[0, 0]),
    }
    solution = adjust(scene.problem(**rows, error_motion_std=1e-7))
    evidence = solution.evidence
    assert evidence.n_lengths == 8 * 24 + 3
    assert evidence.n_rejected == 5
    assert evidence.missing == (6,)
    assert evidence.unchecked == 0
    assert not evidence.mirror_ambiguous
    assert solution.positions.tolist() == [0, 1, 2, 3, 4, 5, 7, 8]
    assert evidence.radial_rms == pytest.approx(np.sqrt(np.mean(solution.motion.radial**2)))
    assert len(solution.rejected) == 6
    result = solve(scene.problem(**rows))
    assert result.n_observations == 8 * 24 + 4
    assert [r.index for r in result.rejected] == sorted(solution.rejected)
    fewer = [r.why for r in result.rejected if "usable lengths" in r.why]
    assert fewer == ["station 6 has 3 usable lengths, 4 are needed"] * 3
    used = result.residuals.used
    assert used.sum() == 8 * 24 - 2
    gone = ~used
    assert (result.residuals.redundancy[gone] == 0.0).all()
    assert (result.residuals.test_value[gone] == 0.0).all()
    assert np.isnan(result.residuals.residual[rows["position"] == 6]).all()
    spikes = result.residuals.residual[[1 * 24 + 3, 4 * 24 + 7]]
    np.testing.assert_allclose(spikes, [1e-4, -1e-4], atol=2e-6)


def test_repeated_runs_have_no_closures():
    angles = np.concatenate([arc(6), arc(6)])
    scene = simulate(3, angles=angles, n=24, layout=low_ring)
    assert len(adjust(scene.problem()).evidence.closures) == 6
    assert adjust(scene.problem(repeated_runs=True)).evidence.closures == ()


@pytest.mark.parametrize("count", [3, 4])
def test_a_station_keeps_four_lengths(count):
    scene = simulate(3, angles=arc(9), n=24, layout=low_ring, length_std=0.0)
    position, target = np.divmod(np.arange(9 * 24), 24)
    keep = (position != 6) | (target % 5 == 0) & (target < 5 * count)
    rows = {"position": position[keep], "target": target[keep]}
    grid, absent = arrange(scene.problem(**rows, length=scene.length.ravel()[keep]))
    unfit = absent.unfit
    assert absent.repeated == absent.spare == {}
    assert len(grid.position_ids) == 9 - (count < 4)
    assert len(unfit) == (count if count < 4 else 0)


@pytest.mark.parametrize("count", [3, 4])
def test_a_target_of_a_free_network_keeps_four_lengths(count):
    scene = simulate(3, angles=arc(9), n=24, layout=low_ring, length_std=0.0)
    position, target = np.divmod(np.arange(9 * 24), 24)
    keep = (target != 11) | (position < count)
    rows = {"position": position[keep], "target": target[keep], "variant": "joint"}
    length = scene.length.ravel()[keep]
    grid, absent = arrange(scene.problem(**rows, length=length, datum="free"))
    assert len(grid.target_ids) == 24 - (count < 4)
    assert absent.unfit == {}
    assert set(absent.spare.values()) == (
        {f"target 11 has {count} usable lengths, 4 are needed"} if count < 4 else set()
    )
    grid, absent = arrange(scene.problem(**rows, length=length, target_std=1e-6))
    assert (len(grid.target_ids), absent.unfit, absent.spare) == (24, {}, {})


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("size", [1e-3, 1.0, 40.0])
def test_directions_are_named_by_unit_vectors(sign, size):
    direction = sign * size * np.array([0.6, -0.8, 0.0])
    assert name_direction(direction).replace("-0.00", "0.00") == "(-0.60, 0.80, 0.00), mostly y"
    assert name_direction(sign * size * np.array([0.0, 0.0, 2.0])).endswith("1.00), mostly z")
    assert name_direction(1e-7 * direction / size) == "the beam (the distance d alone)"


def test_the_station_that_is_known_worst():
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    blocks = np.stack([np.diag([1.0, 2.0, 3.0]), turn @ np.diag([9.0, 0.5, 1.0]) @ turn.T])
    j, std, direction = weakest_direction(blocks)
    axis = turn[:, 0] * np.sign(turn[np.argmax(np.abs(turn[:, 0])), 0])
    assert (j, std) == (1, pytest.approx(3.0))
    np.testing.assert_allclose(direction, axis, atol=1e-12)


@pytest.mark.parametrize("share", [0.999, 1.001])
def test_a_station_may_be_known_to_a_share_of_the_radius(share):
    """The radius is the rms distance of the stations from their centroid, here 0.1 m."""
    angle = 2 * np.pi * np.arange(4) / 4
    stations = np.column_stack([1 + 0.1 * np.cos(angle), 2 + 0.1 * np.sin(angle), 3 + 0 * angle])
    blocks = np.tile(1e-12 * np.eye(3), (4, 1, 1))
    blocks[2, 1, 1] = (share * 0.02 * 0.1) ** 2
    if share < 1.0:
        check_station_spread(stations, blocks, np.arange(4) + 5, 0.02)
        return
    text = (
        r"station 7 is known to 0.002 m only along \(0.00, 1.00, 0.00\), mostly y, more than 0.02 "
        r"of the 0.1 m"
    )
    with pytest.raises(ObservabilityError, match=text):
        check_station_spread(stations, blocks, np.arange(4) + 5, 0.02)


def test_counting_allows_as_many_lengths_as_unknowns():
    scene = simulate(3, angles=arc(4), n=16, layout=low_ring)
    grid, _ = arrange(scene.problem(variant="joint", datum="free"))
    check_counts(grid)  # 64 lengths, 16 + 48 unknowns
    used = grid.used.copy()
    used[0, 0] = False
    with pytest.raises(
        ObservabilityError, match="63 usable lengths from 4 stations to 16 targets"
    ):
        check_counts(replace(grid, used=used))
    check_counts(replace(grid, used=used, free=False))  # the machine gives the targets


def blocks_of(rng, count, size):
    root = rng.normal(size=(count, size, size + 3))
    return root @ root.swapaxes(1, 2) + 8.0 * np.eye(size)


@pytest.mark.parametrize("constrained", [False, True])
def test_elimination_equals_the_dense_matrix(constrained):
    rng = np.random.default_rng(5)
    p, s, q, t = 3, 4, 5, 3
    kept, other = blocks_of(rng, p, s), blocks_of(rng, q, t)
    cross = 0.5 * rng.normal(size=(p * s, q * t))
    constraints = rng.normal(size=(p * s, 2)) if constrained else None
    reduced = eliminate(kept, other, cross, constraints)
    dense = np.zeros((p * s + q * t,) * 2)
    for k in range(p):
        dense[k * s : (k + 1) * s, k * s : (k + 1) * s] = kept[k]
    for k in range(q):
        at = p * s + k * t
        dense[at : at + t, at : at + t] = other[k]
    dense[: p * s, p * s :], dense[p * s :, : p * s] = cross, cross.T
    if constrained:  # bordered: the solution is orthogonal to the columns
        border = np.zeros((len(dense), 2))
        border[: p * s] = constraints
        dense = np.block([[dense, border], [border.T, np.zeros((2, 2))]])
    inverse = np.linalg.inv(dense)[: p * s + q * t, : p * s + q * t]
    a, b = rng.normal(size=p * s), rng.normal(size=q * t)
    expected = inverse @ np.concatenate([a, b])
    x, y = reduced.solve(a, b)
    np.testing.assert_allclose(np.concatenate([x, y]), expected, atol=1e-12)
    covariance = reduced.covariance()
    np.testing.assert_allclose(covariance, inverse[: p * s, : p * s], atol=1e-12)
    np.testing.assert_array_equal(covariance, covariance.T)
    own = inverse[p * s :, p * s :]
    found = reduced.other_blocks(covariance)
    for k in range(q):
        at = slice(k * t, (k + 1) * t)
        np.testing.assert_allclose(found[k], own[at, at], atol=1e-12)
    vectors = rng.normal(size=(q * t, 4))
    np.testing.assert_allclose(reduced.other_times(covariance, vectors), own @ vectors, atol=1e-12)
    np.testing.assert_allclose(
        -covariance @ reduced.transfer, inverse[: p * s, p * s :], atol=1e-12
    )


def test_what_stays_open_is_refused():
    kept = np.zeros((1, 2, 2))
    kept[0] = [[1.0, 1.0], [1.0, 1.0]]
    reduced = eliminate(kept, np.eye(2)[None], np.zeros((2, 2)))
    with pytest.raises(ObservabilityError, match="do not determine stations and targets together"):
        reduced.solve(np.ones(2), np.ones(2))


STD = 2e-7


def joined(disagreement):
    """Two runs with the same noise, eight pairs that differ by ``disagreement`` to and fro."""
    scene = simulate(angles=arc(9), n=24, layout=low_ring, length_std=STD)
    limits = TracerLimits(noise_significance=1e-300)
    problem = scene.problem(length_std=STD, target_std=1e-7, settings=limits)
    run = (problem.target >= 12).astype(np.int64)
    row = np.flatnonzero(run == 0)[::14][:8]
    apart = disagreement * np.tile([1.0, -1.0], 4)
    pairs = RepeatedLengths(
        1, row, problem.length[row] + 3e-5 + apart, np.full(8, 2 * STD), np.zeros((8, 3))
    )
    runs = Runs(
        replace(problem, length=problem.length + 3e-5 * run), run, np.zeros((len(run), 3)), [pairs]
    )
    return problem, runs


@pytest.mark.parametrize("share", [0.95, 1.05])
def test_pairs_that_contradict_each_other_make_a_good_result_suspect(share):
    """Their mean is right, so the lengths fit as before: the test of the join alone shows it."""
    variance = (1 + 4) * STD**2
    limit = np.sqrt(chi2.isf(0.001, 7) * variance / 8)
    problem, runs = joined(share * limit)
    result = adjust_joined(runs).result()
    assert solve(problem).verdict == "ok"
    assert result.verdict == ("ok" if share < 1 else "suspect")
    (join,) = result.details["joins"]
    assert set(join) == {
        "run", "offset_m", "offset_std_m", "disagreement_m", "sigma0", "probability",
    }  # fmt: skip
    assert join["run"] == 1
    assert join["offset_m"] == pytest.approx(3e-5, abs=1e-12)
    assert join["offset_std_m"] == pytest.approx(np.sqrt(variance / 8))
    np.testing.assert_allclose(np.abs(join["disagreement_m"]), share * limit, atol=1e-12)
    square = 8 * (share * limit) ** 2 / variance
    assert join["sigma0"] == pytest.approx(np.sqrt(square / 7))
    assert join["probability"] == pytest.approx(chi2.sf(square, 7), rel=1e-6)
    text = result.warnings[-1]
    assert text.startswith(
        "run 1 was joined by 8 steps measured again: its lengths were +3e-05 m off (standard "
        f"deviation {join['offset_std_m']:.2g} m); the steps agree within {share * limit:.2g} m, "
        f"{join['sigma0']:.2f} times what is expected"
    )
    assert text.endswith("interruption") == (share > 1)


def test_the_zero_of_a_run_moves_the_deviations_by_its_standard_deviation():
    """Once more with the whole later run off by that much: the difference joins the covariance."""
    problem, runs = joined(0.0)
    result = adjust_joined(runs).result()
    plain = solve(problem)
    std = result.details["joins"][0]["offset_std_m"]
    moved = solve(replace(problem, length=problem.length + std * runs.run))
    move = moved.deviations["ECC"] - plain.deviations["ECC"]
    expected = plain.covariance["ECC"] + np.outer(move, move)
    size = np.abs(np.outer(move, move)).max()
    np.testing.assert_allclose(result.covariance["ECC"], expected, atol=1e-3 * size)
    np.testing.assert_allclose(result.std["ECC"], np.sqrt(np.diag(result.covariance["ECC"])))
    steps = np.diff(np.eye(9), axis=0)
    adjacent = np.sqrt(np.diag(steps @ result.covariance["ECC"] @ steps.T))
    np.testing.assert_allclose(result.adjacent_std, adjacent, rtol=1e-6)


def test_two_pairs_have_one_degree_of_freedom():
    join = join_of(2, np.array([0.0, 2.0]), np.ones(2), np.array([0, 1]))
    assert join.run == 2
    assert join.sigma0 == pytest.approx(np.sqrt(2.0))
    assert join.probability == pytest.approx(chi2.sf(2.0, 1))
    alone = join_of(2, np.array([3.0]), np.array([0.5]), np.array([1]))
    assert (alone.offset, alone.std, alone.sigma0, alone.shares) == (3.0, 0.5, 0.0, {1: 1.0})


@pytest.mark.parametrize(
    ("scatter", "named", "not_named"),
    [
        (6.7, ("6.7 times as stated", "solver.length_std_m"), "wrong coordinates"),
        (1.2, ("a target with wrong coordinates",), "length_std_m"),
    ],
)
def test_many_rejected_lengths_name_the_noise_where_it_explains_them(scatter, named, not_named):
    many = replace(GOOD, n_lengths=100, n_rejected=31, scatter=scatter)
    verdict, warnings = judge(many, TracerLimits())
    assert verdict == "failed"
    (text,) = (w for w in warnings if "were rejected" in w)
    assert all(words in text for words in named)
    assert not_named not in text


def test_an_eliminated_block_that_is_singular_is_named():
    """A station from which all targets stand in one line: seen in a table cut off early."""
    with pytest.raises(ObservabilityError, match="do not determine stations and targets"):
        eliminate(np.eye(2)[None], np.diag([1.0, 1.0, 0.0])[None], np.zeros((2, 3)))
