"""A table that turns under a tracer, in the time domain; it shares no code with the solver."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

DEGREE, ARCSEC = np.pi / 180.0, np.pi / 648000.0
RATE_HZ = 1000.0


@dataclass(frozen=True)
class TurningScene:
    """Lengths at angles that the table passes; what is true of it.

    ``angle``, ``target``, ``speed`` (rad/s), ``length`` (m), ``time`` (s), (k,); ``turn`` (k,): in
    which each was read; ``angles`` (n,) rad; ``ecc`` (r, n): of each run, rad; ``nominal`` (t, 3):
    targets as the machine states them. ``readings``: time (s), angle (deg), length of each turn.
    """

    angle: np.ndarray
    target: np.ndarray
    run: np.ndarray
    speed: np.ndarray
    length: np.ndarray
    time: np.ndarray
    turn: np.ndarray
    angles: np.ndarray
    ecc: np.ndarray
    nominal: np.ndarray
    place: np.ndarray
    readings: tuple[np.ndarray, ...]


def curve(rng, orders, size, angles):
    """A curve of some orders, of root mean square ``size``."""
    phase = np.multiply.outer(angles, orders)
    a, b = rng.normal(0.0, size / np.sqrt(len(orders)), (2, len(orders)))
    return np.cos(phase) @ a + np.sin(phase) @ b


def noise_in_time(white, correlated_s):
    """White noise at RATE_HZ, as it stands or, as large, correlated over ``correlated_s``."""
    if not correlated_s:
        return white
    keeps = np.exp(-1.0 / (RATE_HZ * correlated_s))
    return lfilter([np.sqrt(1.0 - keeps**2)], [1.0, -keeps], white)


def turning_scene(
    seed,
    *,
    angles=72,
    targets=4,
    speeds_deg_s=(12.0, -12.0),
    noise=0.2e-6,
    correlated_s=0.0,
    motion=0.0,
    lag=1e-3,
    reversal=0.5 * ARCSEC,
    mean_reversal=0.0,
    radius=0.065,
    window_deg=0.5,
    again=(),
):
    """Turn a table and read lengths; each is the centre of a cubic through its window.

    At the end targets ``again``.
    """
    rng = np.random.default_rng(seed)
    around = 2.0 * np.pi * np.arange(targets) / targets + 0.3
    heights = np.where(np.arange(targets) % 2, 0.3, 0.7)
    nominal = np.column_stack([0.5 * np.cos(around), 0.5 * np.sin(around), heights])
    true = nominal + rng.normal(0.0, 1e-6, nominal.shape)
    grid = np.arange(angles) * 360.0 / angles
    fine = np.arange(-10.0, 370.0, 0.05) * DEGREE
    both = curve(rng, np.arange(1, 9), 5.0 * ARCSEC, fine)
    half = 0.5 * (mean_reversal + curve(rng, np.arange(1, 5), reversal, fine))
    moved = [curve(rng, np.arange(2, 8), motion, fine) for _ in "xyz"]
    place = radius * np.array([np.cos(0.4), np.sin(0.4), 0.0]) + [0.0, 0.0, 0.2]
    rows, readings, begun, turn = [], [], 0.0, 0
    for target in [*range(targets), *again]:
        for run, speed_deg_s in enumerate(speeds_deg_s):
            speed, sense = speed_deg_s * DEGREE, np.sign(speed_deg_s)
            time = np.arange(0.0, 364.0 / abs(speed_deg_s), 1.0 / RATE_HZ)
            shown = (-2.0 if sense > 0 else 362.0) * DEGREE + speed * time
            deviation = np.interp(shown, fine, both + sense * half)
            turned = shown + deviation + speed * lag
            c, s = np.cos(turned), np.sin(turned)
            stands = np.column_stack(
                [c * place[0] - s * place[1], s * place[0] + c * place[1], place[2] + 0.0 * c]
            ) + np.column_stack([np.interp(shown, fine, part) for part in moved])
            error = noise_in_time(rng.normal(0.0, noise, len(time)), correlated_s)
            read = np.linalg.norm(stands - true[target], axis=1) + error + rng.normal()
            readings.append(np.column_stack([begun + time, shown / DEGREE, read]))
            for k in range(angles)[:: int(sense)]:
                away = shown / DEGREE - grid[k]
                near = np.abs(away) < window_deg
                value = np.polynomial.polynomial.polyfit(away[near], read[near], 3)[0]
                rows.append((k, target, run, speed, value, begun + time[near].mean(), turn))
            begun, turn = begun + time[-1] + 15.0, turn + 1
    number, target, run, speed, length, time, turn = np.array(rows).T
    at = np.array([np.interp(grid * DEGREE, fine, both + np.sign(v) * half) for v in speeds_deg_s])
    return TurningScene(
        number.astype(int), target.astype(int), run.astype(int), speed, length, time,
        turn.astype(int), grid * DEGREE, at, nominal, place, tuple(readings),
    )  # fmt: skip


def write_turns(scene, folder, *, with_times=True, setup="", rows=None):
    """Write the scene as a table with its targets and a set-up; return table and set-up."""
    lines = ["angle_deg,target,direction,length_m" + ",time_s" * with_times]
    for k in range(len(scene.length)) if rows is None else rows:
        degrees = round(float(scene.angles[scene.angle[k]] / DEGREE), 9)
        sense = int(np.sign(scene.speed[k]))
        line = f"{degrees},{scene.target[k]},{sense},{float(scene.length[k])!r}"
        lines.append(line + f",{float(scene.time[k])!r}" * with_times)
    table, settings = folder / "turns.csv", folder / "setup.yaml"
    table.write_text("\n".join(lines) + "\n")
    places = [f"{i},{x!r},{y!r},{z!r}" for i, (x, y, z) in enumerate(scene.nominal.tolist())]
    (folder / "targets.csv").write_text("\n".join(["target,x_m,y_m,z_m", *places]) + "\n")
    text = f"plan: {{tracer_m: {scene.place.round(3).tolist()}}}\n"
    settings.write_text("method: tracer_multistation\n" + (setup or text))
    return table, settings


def assert_true(scene, measured, length_m):
    """Assert that lengths are those at the angles, and that the curve is the table's."""
    each = zip(scene.run, scene.angle, scene.target, scene.length, strict=True)
    true = {tuple(key): length for *key, length in each}
    assert len(measured.observations) == len(true)
    for o in measured.observations:
        assert o.accepted, o.reason
        assert abs(o.mean[0] - true[o.station, o.table_position, o.target]) <= length_m
    result = measured.solve()
    assert result.verdict == "ok", result.warnings
    centring = np.eye(36) - 1.0 / 36
    error = centring @ (result.deviations["ECC"] - scene.ecc.mean(axis=0))
    std = np.sqrt((centring @ result.covariance["ECC"] @ centring).diagonal())
    assert np.abs(error / std).max() < 4.0
