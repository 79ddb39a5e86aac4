"""The rules of counting and of the verdict at their limits."""

from dataclasses import replace

import numpy as np
import pytest
from coded import coded
from tracer_scene import arc, low_ring, simulate

from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.methods.tracer.solver.observability import (
    check_counts,
    check_station_spread,
    name_direction,
    weakest_direction,
)
from rotcal_ros.methods.tracer.solver.problem import TOO_FEW, arrange_grid
from rotcal_ros.methods.tracer.solver.solution import adjust
from rotcal_ros.methods.tracer.solver.solve import NO_DEVIATION, solve


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
    assert solution.positions.tolist() == [0, 1, 2, 3, 4, 5, 7, 8]
    assert len(solution.posed.absent.unfit) == 3
    assert len(solution.found.why) == 2
    result = solve(scene.problem(**rows))
    assert result.n_observations == 8 * 24 + 4
    assert len(result.rejected) == 6
    assert coded(*result.warnings)[NO_DEVIATION] == [("6",)]
    fewer = [r.why for r in result.rejected if TOO_FEW in coded(r.why)]
    assert fewer == ["station 6 has 3 usable lengths, 4 are needed"] * 3
    used = result.residuals.used
    assert used.sum() == 8 * 24 - 2
    gone = ~used
    assert (result.residuals.redundancy[gone] == 0.0).all()
    assert np.isnan(result.residuals.residual[rows["position"] == 6]).all()
    spikes = result.residuals.residual[[1 * 24 + 3, 4 * 24 + 7]]
    np.testing.assert_allclose(spikes, [1e-4, -1e-4], atol=2e-6)


def test_repeated_runs_have_no_closures():
    angles = np.concatenate([arc(6), arc(6)])
    scene = simulate(3, angles=angles, n=24, layout=low_ring)
    assert len(solve(scene.problem()).details["closure"]) == 6
    assert solve(scene.problem(repeated_runs=True)).details["closure"] == []


@pytest.mark.parametrize("count", [3, 4])
def test_a_station_keeps_four_lengths(count):
    scene = simulate(3, angles=arc(9), n=24, layout=low_ring, length_std=0.0)
    position, target = np.divmod(np.arange(9 * 24), 24)
    keep = (position != 6) | (target % 5 == 0) & (target < 5 * count)
    rows = {"position": position[keep], "target": target[keep]}
    grid, absent = arrange_grid(scene.problem(**rows, length=scene.length.ravel()[keep]))
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
    grid, absent = arrange_grid(scene.problem(**rows, length=length, datum="free"))
    assert len(grid.target_ids) == 24 - (count < 4)
    assert absent.unfit == {}
    assert set(absent.spare.values()) == (
        {f"target 11 has {count} usable lengths, 4 are needed"} if count < 4 else set()
    )
    grid, absent = arrange_grid(scene.problem(**rows, length=length, target_std=1e-6))
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
    grid, _ = arrange_grid(scene.problem(variant="joint", datum="free"))
    check_counts(grid)  # 64 lengths, 16 + 48 unknowns
    used = grid.used.copy()
    used[0, 0] = False
    with pytest.raises(
        ObservabilityError, match="63 usable lengths from 4 stations to 16 targets"
    ):
        check_counts(replace(grid, used=used))
    check_counts(replace(grid, used=used, free=False))  # the machine gives the targets
