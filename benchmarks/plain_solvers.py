"""The open data set as a careful user of numpy and scipy would solve it, from its plain tables.

``ENTRIES`` maps a method to its solvers by name. Each takes the folder of a measurement and
returns what a result file needs. ``scipy`` is least squares on the plain equations,
``closed_form`` solves linear equations only. Neither looks for outliers, or for anything that may
be wrong.
"""

import csv
import math
from types import SimpleNamespace

import numpy as np
import yaml
from scipy.linalg import lstsq
from scipy_plane_mirror import joint_least_squares
from scipy_tracer import DenseNetwork
from scipy_tracer_six import SparseSix, gauge_free

ROTATIONS, SHIFTS = ("EAC", "EBC", "ECC"), ("EXC", "EYC", "EZC")
ROUNDS = 6
"""From a micrometre and an arcsecond off, more than enough."""
KINDS = {"direct": 4, "mirrored": 5, "nest": 6}


def setup(case):
    """Return the groups of setup.yaml as attributes, and the table angles, rad."""
    groups = yaml.safe_load((case / "setup.yaml").read_text())["/**"]["ros__parameters"]
    plan, solver, simulation = (
        SimpleNamespace(**groups.get(name, {})) for name in ("plan", "solver", "simulation")
    )
    if groups["method"] == "ball_plate":
        return plan, solver, simulation, 2 * np.pi * np.arange(12) / 12
    angles = np.radians(plan.table_step_deg) * np.arange(plan.table_positions)
    return plan, solver, simulation, angles


def table(case, name):
    """Return the columns of a table of numbers."""
    return np.genfromtxt(case / f"{name}.csv", delimiter=",", names=True)


def points(rows):
    return np.column_stack([rows["x_m"], rows["y_m"], rows["z_m"]])


def whole(column):
    return column.astype(int)


def ecc_entry(angles, ecc, covariance):
    covariance = 0.5 * (covariance + covariance.T)
    return entry(angles, {"ECC": ecc}, {"ECC": covariance})


def entry(angles, deviations, covariance):
    """Return what a result file needs, without the last bits, which depend on where arrays lie."""
    std = {name: np.sqrt(np.maximum(np.diag(c), 0.0)) for name, c in covariance.items()}
    return {
        "angles_rad": angles.tolist(),
        "deviations": {name: np.round(values, 10).tolist() for name, values in deviations.items()},
        "std": {name: rounded(values) for name, values in std.items()},
        "covariance": {name: rounded(matrix) for name, matrix in covariance.items()},
    }


def rounded(values):
    """Return numbers with five digits of the largest."""
    digits = 5 - math.ceil(math.log10(np.abs(values).max()))
    return np.round(values, digits).tolist()


def six_entry(angles, turns, shifts, covariance):
    """Return the entry of small turns and shifts (m, 3) whose covariance is (6 m, 6 m)."""
    m = len(angles)

    def free(x):
        parts = np.asarray(x).reshape(2, m, 3)
        return np.concatenate([gauge_free(part, angles).ravel() for part in parts])

    project = np.array([free(column) for column in np.eye(6 * m)]).T
    curves = free(np.concatenate([turns.ravel(), shifts.ravel()])).reshape(2, m, 3)
    covariance = project @ covariance @ project.T
    deviations, matrices = {}, {}
    for part, names in enumerate((ROTATIONS, SHIFTS)):
        for axis, name in enumerate(names):
            rows = 3 * m * part + 3 * np.arange(m) + axis
            deviations[name] = curves[part, :, axis]
            matrices[name] = covariance[np.ix_(rows, rows)]
    return entry(angles, deviations, matrices)


def propagated(solve, x, std):
    """Return what ``solve`` makes of x, and its covariance for independent errors ``std``."""
    found = solve(x)
    changes = np.array([solve(x + step) - found for step in np.diag(std)])
    return found, changes.T @ changes


def ecc_of_stations(stations, angles):
    """Angles about the centre of the circle through the stations (m, 3), less the commanded."""
    x, y = stations[:, 0], stations[:, 1]
    design = np.column_stack([2 * x, 2 * y, np.ones_like(x)])
    a, b, _ = np.linalg.lstsq(design, x**2 + y**2, rcond=None)[0]
    turned = np.arctan2(y - b, x - a) - angles
    turned = (turned - turned[0] + np.pi) % (2 * np.pi) - np.pi
    return turned - turned.mean()


def of_one_zero(targets, lengths, position, m):
    """Linear: (L + d)^2 = |T - P|^2 is 2 T.P + 2 L d - (|P|^2 - d^2) = |T|^2 - L^2; P (m, 3)."""
    origin = targets.mean(axis=0)
    near, rows = targets - origin, np.arange(len(lengths))
    design = np.zeros((len(lengths), 4 * m + 1))
    for axis in range(3):
        design[rows, 3 * position + axis] = 2 * near[:, axis]
    design[rows, 3 * m + position] = -1.0
    design[:, -1] = 2 * lengths
    right = (near**2).sum(axis=1) - lengths**2
    return np.linalg.lstsq(design, right, rcond=None)[0][: 3 * m].reshape(m, 3) + origin


def length_std(solver, simulation):
    """Of the mean of ten readings at two metres, and what is stated besides."""
    noise = 1e-6 * (simulation.tracer["noise_um"] + 2 * simulation.tracer["noise_um_per_m"])
    return np.hypot(solver.length_std_m, noise / np.sqrt(10))


def tracer_rows(case):
    rows, targets = table(case, "lengths"), points(table(case, "targets"))
    return whole(rows["position"]), whole(rows["target"]), rows["length_m"], targets


def tracer_closed_form(case):
    _, solver, simulation, angles = setup(case)
    position, target, length, targets = tracer_rows(case)

    def solve(x):
        lengths, places = x[: len(length)], x[len(length) :].reshape(-1, 3)
        stations = [
            of_one_zero(places[target[at]], lengths[at], np.zeros(len(at), int), 1)[0]
            for at in (np.flatnonzero(position == p) for p in range(len(angles)))
        ]
        return ecc_of_stations(np.array(stations), angles)

    x = np.concatenate([length, targets.ravel()])
    std = np.full(len(x), solver.target_std_m)
    std[: len(length)] = length_std(solver, simulation)
    ecc, covariance = propagated(solve, x, std)
    return ecc_entry(angles, ecc, covariance + motion_of(angles, solver))


def motion_of(angles, solver):
    """The covariance of angles whose stations leave their circle of 65 mm by chance."""
    m = len(angles)
    return (solver.error_motion_std_m / 0.0652) ** 2 * (np.eye(m) - 1.0 / m)


def tracer_scipy(case):
    plan, solver, simulation, angles = setup(case)
    position, target, length, targets = tracer_rows(case)
    m, n = len(angles), len(targets)
    lengths = np.zeros((m, n))
    lengths[position, target] = length
    network = DenseNetwork(targets, lengths, length_std(solver, simulation), solver.target_std_m)
    turn = np.exp(1j * angles) * complex(*plan.tracer_m[:2])
    stations = np.column_stack([turn.real, turn.imag, np.full(m, plan.tracer_m[2])])
    zero = (np.linalg.norm(stations[:, None] - targets, axis=2) - lengths).mean(axis=1)
    start = np.concatenate([np.column_stack([stations, zero]).ravel(), targets.ravel()])
    best = network.solve(start)
    slope = network.slope(best)
    known = np.linalg.inv(slope.T @ slope)[: 4 * m, : 4 * m]
    places = (4 * np.arange(m)[:, None] + np.arange(3)).ravel()
    root = np.linalg.cholesky(known[np.ix_(places, places)])
    found = best[places]
    ecc = ecc_of_stations(found.reshape(m, 3), angles)
    changes = [ecc_of_stations((found + c).reshape(m, 3), angles) - ecc for c in root.T]
    covariance = np.array(changes).T @ np.array(changes)
    return ecc_entry(angles, ecc, covariance + motion_of(angles, solver))


def six_rows(case):
    rows, targets = table(case, "lengths"), points(table(case, "targets"))
    numbers = [whole(rows[name]) for name in ("place", "position", "target")]
    return *numbers, rows["length_m"], targets


def turns_of(angles):
    cos, sin, zero, one = np.cos(angles), np.sin(angles), 0 * angles, 0 * angles + 1
    return np.array([[cos, -sin, zero], [sin, cos, zero], [zero, zero, one]]).transpose(2, 0, 1)


def cross(v):
    x, y, z = v
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def six_closed_form(case):
    _, solver, simulation, angles = setup(case)
    place, position, target, length, targets = six_rows(case)
    turns = turns_of(angles)

    def solve(x):
        lengths, at = x[: len(length)], x[len(length) :].reshape(-1, 3)
        stations = np.array([
            of_one_zero(at[target[r]], lengths[r], position[r], len(angles))
            for r in (np.flatnonzero(place == p) for p in range(3))
        ])  # fmt: skip
        mean = np.einsum("kji,pkj->pi", turns, stations) / len(angles)
        poses = []
        for k, turn in enumerate(turns):
            arms = mean @ turn.T
            design = np.vstack([np.hstack([-cross(arm), np.eye(3)]) for arm in arms])
            apart = (stations[:, k] - arms).ravel()
            poses.append(np.linalg.lstsq(design, apart, rcond=None)[0])
        poses = np.array(poses)
        return np.concatenate([poses[:, :3].ravel(), poses[:, 3:].ravel()])

    x = np.concatenate([length, targets.ravel()])
    std = np.full(len(x), solver.target_std_m)
    std[: len(length)] = length_std(solver, simulation)
    found, covariance = propagated(solve, x, std)
    return six_entry(angles, *np.split(found, 2), covariance)


def six_scipy(case):
    plan, solver, simulation, angles = setup(case)
    place, position, target, length, targets = six_rows(case)
    m, places = len(angles), np.reshape(plan.places_m, (-1, 3))
    std = length_std(solver, simulation)
    network = SparseSix(
        position, place, target, place, length, std, targets, solver.target_std_m, angles, 3,
    )  # fmt: skip
    arms = np.einsum("nij,nj->ni", turns_of(angles)[position], places[place])
    away = np.linalg.norm(arms - targets[target], axis=1) - length
    zeros = [away[place == p].mean() for p in range(3)]
    best = np.concatenate([np.zeros(6 * m), places.ravel(), zeros, targets.ravel()])
    for _ in range(ROUNDS):  # nothing holds the frame: the shortest step of Gauss and Newton
        slope = network.slope(best).toarray()
        best = best - lstsq(slope, network.misfit(best), cond=1e-10)[0]
    covariance = np.linalg.pinv(slope.T @ slope, rcond=1e-13, hermitian=True)[: 6 * m, : 6 * m]
    return six_entry(angles, *np.split(best[: 6 * m], 2), covariance)


def ball_plate_scipy(case):
    """Linear: centre - place = ball's error, turned + machine's error there + d + c x place."""
    plan, _, _, angles = setup(case)
    rows = table(case, "balls")
    position, step, n = whole(rows["position"]), whole(rows["ball_step"]), len(angles)
    at = (position + step) % n
    radius, turns = plan.plate["circle_radius_m"], turns_of(angles)
    places = radius * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])[at]
    design = np.zeros((len(at), 3, 4, n, 3))  # ball, machine, turn, shift
    number = np.arange(len(at))
    design[number, :, 0, step] = turns[position]
    design[number, :, 1, at] = design[number, :, 3, position] = np.eye(3)
    design[number, :, 2, position] = [-cross(place) for place in places]
    # the number of a place says where the ball stands, counted from the table's zero
    design = design.reshape(3 * len(at), -1)
    inverse = np.linalg.pinv(design, rcond=1e-10)
    observed = (points(rows) - places).ravel()
    best = inverse @ observed
    left = observed - design @ best
    dof = len(left) - np.linalg.matrix_rank(design, tol=1e-10)
    covariance = (left @ left / dof) * (inverse @ inverse.T)
    poses = slice(6 * n, 12 * n)
    return six_entry(angles, *np.split(best[poses], 2), covariance[poses, poses])


def mirror_rows(case):
    """Return the points of the trackers as arrays; nests have the position -1."""
    with (case / "tracker.csv").open() as file:
        rows = list(csv.DictReader(file))
    return SimpleNamespace(
        position=np.array([int(row["position"] or -1) for row in rows]),
        station=np.array([int(row["tracker_station"]) for row in rows]),
        kind=np.array([KINDS[row["kind"]] for row in rows]),
        nest=np.array([int(row["nest"]) for row in rows]),
        xyz=np.array([[float(row[name]) for name in ("x_m", "y_m", "z_m")] for row in rows]),
    )


def tracker_covariance(solver, xyz):
    away = np.linalg.norm(xyz, axis=1)[:, None, None]
    along = xyz[:, :, None] * xyz[:, None, :] / away**2
    on = solver.range_std_m + solver.range_std_relative * away
    off = solver.transverse_std_m + solver.transverse_std_relative * away
    return on**2 * along + off**2 * (np.eye(3) - along)


def mirror_scipy(case):
    _, solver, _, angles = setup(case)
    rows = mirror_rows(case)
    rows.angles, rows.tilt_std = angles, np.radians(solver.tilt_std_arcsec / 3600)
    rows.noise = SimpleNamespace(covariance=lambda xyz: tracker_covariance(solver, xyz))
    ecc, covariance, _ = joint_least_squares(rows)
    return ecc_entry(angles, ecc, covariance)


def mirror_closed_form(case):
    """Nests bring all stations into one frame; the axis is across the plane of all normals."""
    _, solver, _, angles = setup(case)
    rows = mirror_rows(case)
    nest, mirrored = rows.kind == KINDS["nest"], rows.kind == KINDS["mirrored"]
    direct = np.flatnonzero(mirrored) - 1  # measured right before its image

    def solve(x):
        xyz = x.reshape(-1, 3)
        there = means_of(xyz, rows, nest & (rows.station == 0))
        turns = [turn(means_of(xyz, rows, nest & (rows.station == s)), there)
                 for s in range(rows.station.max() + 1)]  # fmt: skip
        normals = xyz[direct] - xyz[mirrored]
        normals = np.einsum("nij,nj->ni", np.array(turns)[rows.station[mirrored]], normals)
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        at = rows.position[mirrored]
        normals = np.array([normals[at == p].mean(axis=0) for p in range(len(angles))])
        axis = np.linalg.svd(normals - normals.mean(axis=0))[2][2]
        axis = axis * np.sign(axis[2])  # trackers stand upright
        level = np.cross(axis, normals[0])
        psi = np.arctan2(normals @ level, normals @ np.cross(level, axis)) - angles
        return (psi - psi[0] + np.pi) % (2 * np.pi) - np.pi

    # each coordinate with its own std: the ellipsoids lie close to level and upright
    variances = np.einsum("nii->ni", tracker_covariance(solver, rows.xyz))
    return ecc_entry(angles, *propagated(solve, rows.xyz.ravel(), np.sqrt(variances).ravel()))


def means_of(xyz, rows, chosen):
    return np.array([xyz[chosen & (rows.nest == k)].mean(axis=0) for k in np.unique(rows.nest[
        rows.kind == KINDS["nest"]])])  # fmt: skip


def turn(here, there):
    """The rotation (3, 3) that turns points (k, 3) into others, each about their mean."""
    u, _, vt = np.linalg.svd((there - there.mean(0)).T @ (here - here.mean(0)))
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


ENTRIES = {
    "tracer_multistation": {"scipy": tracer_scipy, "closed_form": tracer_closed_form},
    "tracer_six": {"scipy": six_scipy, "closed_form": six_closed_form},
    "ball_plate": {"scipy": ball_plate_scipy},
    "plane_mirror": {"scipy": mirror_scipy, "closed_form": mirror_closed_form},
}
