"""What the result reports of stations, tests and budget, computed anew from its own arrays."""

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import chi2, norm
from scipy_tracer import DenseNetwork
from test_result_details import assert_documented
from tracer_scene import arc, low_ring, simulate

from rotcal_ros.methods.tracer.solver import TracerLimits, solve
from rotcal_ros.methods.tracer.solver.solution import adjust

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
    problem, result = solved(options)
    found, rows = result.details, result.residuals
    n_tests = M * N + (0 if options.get("datum") == "free" else 3 * N)
    assert found["rejection_limit"] == pytest.approx(norm.isf(0.5 * 0.01 / n_tests), rel=1e-9)
    assert found["coverage_factor"] == pytest.approx(norm.ppf(0.975), rel=1e-12)
    assert found["covariance_scale"] == 1.0
    table = rows.redundancy.reshape(M, N)
    np.testing.assert_allclose(found["redundancy_per_station"], table.sum(axis=1))
    unit = problem.targets[None] - found["stations"][:, None]
    unit /= np.linalg.norm(unit, axis=2, keepdims=True)
    variance = np.full((M, N), 2e-7**2)
    if options["variant"] == "station":
        variance += ((unit * options.get("target_std", 0.0)) ** 2).sum(axis=2)
    squares = rows.residual.reshape(M, N) ** 2 / variance
    expected = np.sqrt(squares.sum(axis=1) / table.sum(axis=1))
    np.testing.assert_allclose(found["sigma0_per_station"], expected, rtol=1e-6)
    value = np.sign(rows.residual) * np.sqrt(squares.ravel() / rows.redundancy)
    np.testing.assert_allclose(rows.test_value, value, rtol=1e-6)
    total = squares.sum()
    if options.get("datum") == "prior":
        total += ((found["targets"] - problem.targets) ** 2).sum() / 1e-12
    assert result.sigma0 == pytest.approx(np.sqrt(total / result.dof), rel=1e-9)
    assert found["length_test"]["sigma0"] == result.sigma0
    freedom = found["dof_effective"]
    tail = chi2.sf(total * freedom / result.dof, freedom)
    assert found["length_test"]["probability"] == pytest.approx(tail, rel=1e-6)
    assert found["unknowns"] == 4 * M + (3 * N if options["variant"] == "joint" else 0)
    assert found["rank"] == found["unknowns"] - 7 * (options.get("datum") == "free")


@pytest.mark.parametrize("error_motion", [0.0, 3e-7])
def test_stations_are_compared_with_their_circle(error_motion):
    """Targets without error: the stations are independent, their blocks are all there is."""
    _, result = solved(
        {"variant": "station", "error_motion_std": error_motion}, error_motion=error_motion
    )
    found, m = result.details, M
    normal, centre, _ = circle_of(found["stations"])
    arm = found["stations"] - centre
    out = arm - np.outer(arm @ normal, normal)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    variance = np.einsum("ja,jab,jb->j", out, found["station_covariance"], out) + error_motion**2
    whitened = np.column_stack([out @ np.linalg.svd(arm)[2][:2].T, np.ones(m)])
    # generalised least squares of circle centre and radius from the radial distances
    root = np.sqrt(variance)
    fit = np.linalg.lstsq(whitened / root[:, None], found["radial"] / root, rcond=None)[0]
    square = (((found["radial"] - whitened @ fit) / root) ** 2).sum()
    assert found["circle_test"]["sigma0"] == pytest.approx(np.sqrt(square / (m - 3)), rel=1e-5)
    assert found["circle_test"]["probability"] == pytest.approx(chi2.sf(square, m - 3), rel=1e-4)


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


def test_budget_of_the_network_by_its_dense_inverse():
    """Errors of lengths and of coordinates reach the stations by the same gain."""
    problem, result = solved({"variant": "joint", "target_std": 1e-6, "error_motion_std": 2e-7})
    found = result.details
    network = DenseNetwork(problem.targets, problem.length.reshape(M, N), 2e-7, 1e-6)
    state = np.column_stack([found["stations"], found["distances"]])
    slope = network.slope(np.concatenate([state.ravel(), found["targets"].ravel()]))
    inverse = np.linalg.inv(slope.T @ slope)
    place = np.arange(4 * M).reshape(M, 4)[:, :3].ravel()
    parts = []
    for rows in (slope[: M * N], slope[M * N :]):
        gain = inverse[place] @ rows.T  # both kinds of rows are in standard deviations
        parts.append(gain @ gain.T)
    assert_budget(result, *budget_of(result, problem.table_angles, *parts, error_motion=2e-7))


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
    assert found["covariance_scale"] == pytest.approx(result.sigma0, rel=0.05)
    assert result.sigma0 > 1.2
    assert result.verdict == "suspect"
    total = sum(part**2 for part in result.budget.values())
    np.testing.assert_allclose(result.std["ECC"] ** 2, total, rtol=1e-9)
    slope = slope_of_bearings(found["stations"], problem.table_angles)
    normal = circle_of(found["stations"])[0]
    across = 1e-7**2 * (np.eye(3) - np.outer(normal, normal))
    motion = np.sqrt(np.diag(slope @ block_diag(*[across] * M) @ slope.T))
    np.testing.assert_allclose(result.budget["error_motion"], motion, atol=1e-5 * motion.max())


def test_coordinates_are_tested_along_the_axes_that_the_lengths_check():
    """Correction over its own standard deviation, along each axis of what is left of the prior."""
    problem, _ = solved({"variant": "joint", "target_std": 1e-6}, target_std=1e-6)
    fit = adjust(problem).fit
    network = DenseNetwork(problem.targets, problem.length.reshape(M, N), 2e-7, 1e-6)
    slope = network.slope(np.concatenate([fit.state.ravel(), fit.targets.ravel()]))
    inverse = np.linalg.inv(slope.T @ slope)
    expected = []
    for i in range(N):
        at = slice(4 * M + 3 * i, 4 * M + 3 * i + 3)
        kept, axes = np.linalg.eigh(np.eye(3) - inverse[at, at] / 1e-12)
        along = np.abs((fit.targets[i] - problem.targets[i]) / 1e-6 @ axes)
        values = [a / np.sqrt(k) for a, k in zip(along, kept, strict=True) if k > 0.01]
        expected.append(max(values, default=0.0))
    np.testing.assert_allclose(fit.target_test, expected, rtol=1e-4)
    assert 1.0 < max(expected) < 4.5
