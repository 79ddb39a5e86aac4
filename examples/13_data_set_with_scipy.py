"""The open data set without this package: raw lengths of one bag, and scipy's least squares."""

import json
import sys
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from scipy.optimize import least_squares

CASE = Path(sys.argv[1] if len(sys.argv) > 1 else "out/dataset/tracer/none_1")
if not (CASE / "bag").exists():
    sys.exit(f"no {CASE}/bag: python research/make_dataset.py out/dataset --method tracer")
LENGTH, TARGET, CIRCLE, START = 0.3e-6, 1e-6, 0.1e-6, (0.0569, -0.0318, 0.1225)  # m: its README

# What was read in each step, from its orders to those of the next one.
steps = []
with AnyReader([CASE / "bag"]) as reader:
    for connection, _, data in reader.messages():
        message, topic = reader.deserialize(data, connection.msgtype), connection.topic
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        if topic == "/cell/table_angle":
            steps.append({"angle": message.angle, "rest": np.inf, "lengths": []})
        elif topic == "/cell/probe_target":
            steps[-1]["place"] = message.position
        elif topic == "/cell/probe_point" or abs(getattr(message, "velocity", [0.0])[0]) > 1e-3:
            steps[-1] |= {"rest": stamp + 0.2, "lengths": []}
        elif topic == "/cell/tracer_length" and message.status == 1 and stamp > steps[-1]["rest"]:
            steps[-1]["lengths"].append(message.length)
angles, station = np.unique([step["angle"] for step in steps], return_inverse=True)
known, target = np.unique([step["place"] for step in steps], axis=0, return_inverse=True)
length, m = np.array([np.mean(step["lengths"]) for step in steps]), len(angles)


def misfit(x):
    """Of L = |T - P| - d, targets T, circle of P, in their std; x: P and d of each, T, circle."""
    stations, targets, circle = x[: 4 * m].reshape(m, 4), x[4 * m : -6].reshape(-1, 3), x[-6:]
    away = np.linalg.norm(targets[target.ravel()] - stations[station, :3], axis=1)
    lengths = (away - stations[station, 3] - length) / LENGTH
    off = stations[:, :3] - circle[:3]
    away = np.hypot(*off.T[:2]) - circle[3], off[:, 2] - off[:, :2] @ circle[4:]
    return np.hstack([lengths, ((targets - known) / TARGET).ravel(), *np.divide(away, CIRCLE)])


def turned(x):
    """By how much the stations turn about the centre of their circle beyond the command, rad."""
    east, north = (x[: 4 * m].reshape(m, 4)[:, :2] - x[-6:-4]).T
    return np.angle(np.exp(1j * (np.arctan2(north, east) - angles - np.arctan2(*START[1::-1]))))


turn = np.exp(1j * angles) * complex(*START[:2])
stations = np.column_stack([turn.real, turn.imag, np.full(m, START[2]), np.zeros(m)])
first = np.hstack([stations.ravel(), known.ravel(), 0, 0, START[2], abs(turn[0]), 0, 0])
best = least_squares(misfit, first, x_scale="jac")
spread = np.linalg.cholesky(np.linalg.inv(best.jac.T @ best.jac)).T
changes = np.array([turned(best.x + column) for column in spread]) - turned(best.x)
std = np.sqrt((changes**2).sum(axis=0) + (CIRCLE / abs(turn)) ** 2)
error = turned(best.x) - json.loads((CASE / "truth.json").read_text())["deviations"]["ECC"]
print(f"rms error / stated standard uncertainty: {np.std(error) / np.sqrt(np.mean(std**2)):.2f}")
found = {"deviations": {"ECC": turned(best.x).tolist()}, "std": {"ECC": std.tolist()}}
(CASE / "result_mine.json").write_text(json.dumps({"angles_rad": angles.tolist(), **found}))
