"""What the result reports of stations, tests and budget, computed anew from its own arrays."""

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import chi2, norm
from scipy_tracer import DenseNetwork
from test_result_details import assert_documented
from tracer_scene import arc, low_ring, simulate

from rotcal_ros.methods.tracer.solver import TracerLimits, solve

VARIANTS = [
    {"variant": "station"},
    {"variant": "station", "target_std": 1e-6, "error_motion_std": 2e-7},
    {"variant": "joint", "datum": "prior", "target_std": 1e-6},
    {"variant": "joint", "datum": "free"},
]
M, N = 8, 24


def solved(options, seed=2, **more):
    scene = simulate(seed, angles=arc(M), n=N, layout=low_ring, **more)
    limits = TracerLimits(noise_significance=1e-300)  # the noise as it is stated
    problem = scene.problem(**{"settings": limits, **options})
    return problem, solve(problem)


def circle_of(stations):
    """Normal, centre and radius: plane by singular values, circle by its linear equation."""
    middle = stations.mean(axis=0)
    axes = np.linalg.svd(stations - middle)[2]
    normal = axes[2] * np.sign(axes[2, 2])
    flat = (stations - middle) @ axes[:2].T
    a = np.column_stack([2 * flat, np.ones(len(flat))])
    x, y, c = np.linalg.lstsq(a, (flat**2).sum(axis=1), rcond=None)[0]
    return normal, middle + [x, y] @ axes[:2], np.sqrt(c + x**2 + y**2)


def bearings(stations, angles):
    """Deviations (m,), counted from the first station."""
    normal, centre, _ = circle_of(stations)
    east = np.cross([0.0, 1.0, 0.0], normal)
    east /= np.linalg.norm(east)
    arm = stations - centre
    excess = np.arctan2(arm @ np.cross(normal, east), arm @ east) - angles
    return np.angle(np.exp(1j * (excess - excess[0])))


def slope_of_bearings(stations, angles):
    """Central differences (m, 3 m) of :func:`bearings`."""
    columns = []
    for place in range(stations.size):
        step = np.zeros(stations.size)
        step[place] = 1e-6
        step = step.reshape(stations.shape)
        ahead, behind = bearings(stations + step, angles), bearings(stations - step, angles)
        columns.append((ahead - behind) / 2e-6)
    return np.transpose(columns)


@pytest.mark.parametrize("options", VARIANTS)
def test_details_are_those_of_the_documentation(options):
    _, result = solved(options)
    assert_documented(result.all_details, "tracer_multistation", {"m": M, "t": N, "n": M})
    assert result.details["variant"] == options["variant"]
    assert result.details["datum"] == options.get("datum", "targets")
    assert result.details["station_ids"].tolist() == list(range(M))
    assert result.details["target_ids"].tolist() == list(range(N))


@pytest.mark.parametrize("options", VARIANTS)
def test_geometry_is_that_of_the_stations(options):
    problem, result = solved(options)
    found, stations = result.details, result.details["stations"]
    normal, centre, radius = circle_of(stations)
    np.testing.assert_allclose(found["plane"]["normal"], normal, atol=1e-9)
    np.testing.assert_allclose(found["circle"]["centre"], centre, atol=1e-11)
    assert found["circle"]["radius"] == pytest.approx(radius, abs=1e-11)
    arm = stations - centre
    np.testing.assert_allclose(found["axial"], arm @ normal, atol=1e-11)
    in_plane = arm - np.outer(arm @ normal, normal)
    np.testing.assert_allclose(
        found["radial"], np.linalg.norm(in_plane, axis=1) - radius, atol=1e-11
    )
    np.testing.assert_allclose(
        found["axial"], stations @ normal + found["plane"]["offset"], atol=1e-11
    )
    assert found["tilt"] == pytest.approx(np.arccos(normal[2]), abs=1e-7)
    ecc = bearings(stations, problem.table_angles)
    np.testing.assert_allclose(result.deviations["ECC"], ecc, atol=1e-10)
    np.testing.assert_allclose(result.adjacent_deviations, np.diff(ecc), atol=1e-10)
    steps, lean = np.diff(problem.table_angles), found["tilt"]
    expected = np.arctan(np.tan(steps) * np.cos(lean)) - steps
    np.testing.assert_allclose(found["algorithm_error"], expected, atol=1e-15)
    q = M - 1
    scatter = 0.5 * np.sqrt((np.diff(ecc) ** 2).sum() / (q * (q - 1)))
    assert found["scatter"] == pytest.approx(scatter, rel=1e-4)


@pytest.mark.parametrize("options", VARIANTS)
def test_the_weakest_direction_is_the_longest_axis_of_all_ellipsoids(options):
    _, result = solved(options)
    found = result.details
    blocks = found["station_covariance"]
    std = np.sqrt(np.array([np.diag(block) for block in blocks]))
    np.testing.assert_allclose(found["station_std"], std, rtol=1e-12)
    largest = [np.linalg.eigvalsh(block)[-1] for block in blocks]
    weak = found["weakest"]
    assert weak["station"] == int(np.argmax(largest))
    assert weak["std"] == pytest.approx(np.sqrt(max(largest)), rel=1e-9)
    direction = weak["direction"]
    assert np.linalg.norm(direction) == pytest.approx(1.0)
    np.testing.assert_allclose(
        blocks[weak["station"]] @ direction, max(largest) * direction, atol=1e-8 * max(largest)
    )
    assert direction[np.argmax(np.abs(direction))] > 0.0


@pytest.mark.parametrize("options", VARIANTS)
def test_tests_follow_from_residuals_and_redundancies(options):
    _, result = solved(options)
    found, rows = result.details, result.residuals
    assert found["coverage_factor"] == pytest.approx(norm.ppf(0.975), rel=1e-12)
    table = rows.redundancy.reshape(M, N)
    np.testing.assert_allclose(found["redundancy_per_station"], table.sum(axis=1))
    if options["variant"] == "station":
        return  # its residuals are the paper's, its tests those of the whole network
    squares = rows.residual.reshape(M, N) ** 2 / 2e-7**2
    expected = np.sqrt(squares.sum(axis=1) / table.sum(axis=1))
    np.testing.assert_allclose(found["sigma0_per_station"], expected, rtol=1e-6)
    value = np.sign(rows.residual) * np.sqrt(squares.ravel() / rows.redundancy)
    np.testing.assert_allclose(rows.test_value, value, rtol=1e-6)
    total = found["chi_square"]["value"]
    assert result.sigma0 == pytest.approx(np.sqrt(total / result.dof), rel=1e-6)
    tail = chi2.sf(total, result.dof)
    assert found["chi_square"]["p_value"] == pytest.approx(tail, rel=1e-6)


def budget_of(result, angles, lengths, targets, error_motion=0.0):
    """Send covariances (3 m, 3 m) of the stations through the slope of the bearings."""
    stations = result.details["stations"]
    slope = slope_of_bearings(stations, angles)
    normal = circle_of(stations)[0]
    across = error_motion**2 * (np.eye(3) - np.outer(normal, normal))
    parts = {"lengths": lengths, "targets": targets, "error_motion": block_diag(*[across] * M)}
    return slope, {name: slope @ part @ slope.T for name, part in parts.items()}


def assert_budget(result, slope, parts):
    total = sum(parts.values())
    np.testing.assert_allclose(result.covariance["ECC"], total, atol=1e-6 * total.max())
    np.testing.assert_allclose(result.std["ECC"], np.sqrt(np.diag(total)), atol=1e-6 * 1e-5)
    steps = np.diff(np.eye(M), axis=0)
    adjacent = np.sqrt(np.diag(steps @ total @ steps.T))
    np.testing.assert_allclose(result.adjacent_std, adjacent, rtol=1e-5)
    for name, part in parts.items():
        share = np.sqrt(np.diag(part))
        np.testing.assert_allclose(
            result.budget[name], share, atol=1e-5 * np.sqrt(total.max()), err_msg=name
        )


def test_the_network_by_its_dense_inverse():
    """Lengths, coordinates, and stations that leave their circle by the error motion."""
    motion = 2e-7
    problem, result = solved({"variant": "joint", "target_std": 1e-6, "error_motion_std": motion})
    found = result.details
    network = DenseNetwork(problem.targets, problem.length.reshape(M, N), 2e-7, 1e-6)
    state = np.column_stack([found["stations"], found["distances"]])
    slope = network.slope(np.concatenate([state.ravel(), found["targets"].ravel()]))
    # turns, radius and centre place the stations, but for the motion in the plane
    stations, p = found["stations"], slope.shape[1]
    normal, centre, _ = circle_of(stations)
    arm = stations - centre
    along = np.cross(normal, arm)
    out = arm / np.linalg.norm(arm, axis=1)[:, None]
    basis = np.linalg.svd(arm)[2][:2]
    rows = np.zeros((2 * M, p + M + 3))
    for j in range(M):
        for k, axis in enumerate(basis):
            rows[2 * j + k, 4 * j : 4 * j + 3] = axis
            rows[2 * j + k, p + j] = -along[j] @ axis
            rows[2 * j + k, p + M] = -out[j] @ axis
            rows[2 * j + k, p + M + 1 + k] = -1.0
    whole = np.concatenate([np.pad(slope, ((0, 0), (0, M + 3))), rows / motion])
    scale = np.linalg.norm(whole, axis=0)
    inverse = np.linalg.inv((whole / scale).T @ (whole / scale)) / scale / scale[:, None]
    turns = np.eye(M) - np.eye(M)[0]
    expected = turns @ inverse[p : p + M, p : p + M] @ turns.T
    difference = np.abs(result.covariance["ECC"] - expected).max()
    assert difference < 1e-4 * expected.max()


def test_budget_of_stations_with_common_targets():
    """Each coordinate moves the lengths of all stations; each length only its own."""
    problem, result = solved(VARIANTS[1])
    found = result.details
    unit = found["stations"][:, None] - problem.targets
    unit /= np.linalg.norm(unit, axis=2, keepdims=True)
    weight = 1.0 / (2e-7**2 + ((unit * 1e-6) ** 2).sum(axis=2))
    gains = []
    for j in range(M):
        design = np.column_stack([unit[j], -np.ones(N)])
        normal = design.T @ (design * weight[j][:, None])
        gains.append(np.linalg.solve(normal, design.T * weight[j])[:3])
    lengths = block_diag(*[2e-7**2 * gain @ gain.T for gain in gains])
    felt = [np.einsum("ai,ic->aic", gain, unit[j]).reshape(3, -1) for j, gain in enumerate(gains)]
    felt = 1e-6 * np.concatenate(felt)
    assert_budget(
        result, *budget_of(result, problem.table_angles, lengths, felt @ felt.T, error_motion=2e-7)
    )


@pytest.mark.parametrize("options", [VARIANTS[0], VARIANTS[2]])
def test_too_small_a_noise_scales_all_but_the_error_motion(options):
    scene = simulate(4, angles=arc(M), n=N, layout=low_ring, length_std=6e-7)
    problem = scene.problem(**options, length_std=2e-7, error_motion_std=1e-7)
    result = solve(problem)
    found = result.details
    assert 2.0 < found["noise"]["the lengths"] < 4.0
    assert result.verdict == "suspect"
    total = sum(part**2 for part in result.budget.values())
    np.testing.assert_allclose(result.std["ECC"] ** 2, total, rtol=1e-9)
    slope = slope_of_bearings(found["stations"], problem.table_angles)
    normal = circle_of(found["stations"])[0]
    across = 1e-7**2 * (np.eye(3) - np.outer(normal, normal))
    motion = np.sqrt(np.diag(slope @ block_diag(*[across] * M) @ slope.T))
    assert result.budget["error_motion"] == pytest.approx(motion, rel=0.1)
