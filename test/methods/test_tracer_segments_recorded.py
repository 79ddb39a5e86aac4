"""Segments of lengths that were recorded: from the simulated cell's streams, and from tables."""

from dataclasses import replace
from itertools import product
from math import dist
from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.capture.window import Beam
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.observations import LengthStatus
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.configuration import Configuration, dump_configuration, parse_configuration
from rotcal_ros.methods.measurements import read_measurements
from rotcal_ros.methods.tracer.method import problem
from rotcal_ros.methods.tracer.settings import FaultSettings, SimulatedTracerSettings
from rotcal_ros.methods.tracer.simulation import SimulatedTracer

QUIET = SimulatedTracerSettings(noise_um=0.0, noise_um_per_m=0.0)


def read(faults: FaultSettings, count: int = 4000, cut: int = 700) -> list:
    tracer = SimulatedTracer(QUIET, faults, 5)
    samples = []
    for first in range(0, count, cut):
        n = min(cut, count - first)
        stamps = 1_000_000 * np.arange(first, first + n)
        still = np.full(n, 1.5)
        samples += tracer.readings(first, stamps, still, np.zeros(n), np.zeros(n))
    return samples


def test_the_simulated_zero_changes_at_breaks_and_the_beam_tells_where() -> None:
    samples = read(FaultSettings(break_probability=0.002, break_shift_um=100.0))
    dark = np.array([s.status == LengthStatus.BEAM_BROKEN for s in samples])
    length = np.array([s.length for s in samples])
    stamps = np.array([s.stamp_ns for s in samples])
    assert 2 < dark.sum() < 20
    beam = Beam(1.0, 10.0)
    beam.follow(stamps, np.array([float(s.sequence) for s in samples]), length, ~dark, dark)
    segment = np.array([beam.segment(-1, s, s) for s in stamps.tolist()])
    zeros = [np.unique(length[(segment == k) & ~dark]) for k in np.unique(segment[~dark])]
    assert all(len(zero) == 1 for zero in zeros)
    assert len(np.unique(np.concatenate(zeros))) == len(zeros) > 2
    assert np.ptp(np.concatenate(zeros)) < 1000 * MICROMETRE
    again = read(FaultSettings(break_probability=0.002, break_shift_um=100.0), cut=1)
    assert [s.length for s in again if s.status == LengthStatus.OK] == length[~dark].tolist()


def test_a_simulated_slip_changes_the_zero_by_a_fringe_and_no_status() -> None:
    samples = read(FaultSettings(slip_probability=0.002))
    steps = np.diff([s.length for s in samples])
    assert {s.status for s in samples} == {LengthStatus.OK}
    assert 0 < np.count_nonzero(steps) < 20
    assert steps[steps != 0] == pytest.approx(0.3164 * MICROMETRE, rel=1e-6)


ANGLES = [40.0 * k for k in range(9)]
ALONG = len(ANGLES) - 3
"""What the plane of the stations tells of their error motion along the axis."""
TARGETS = [(0.5 * np.cos(k), 0.4 * np.sin(k), 0.1 * (k % 5)) for k in range(12)]


def table(folder: Path, header: str, break_at: int) -> Path:
    lines = [f"{i},{x!r},{y!r},{z!r}" for i, (x, y, z) in enumerate(np.array(TARGETS).tolist())]
    (folder / "targets.csv").write_text("\n".join(["target,x_m,y_m,z_m", *lines]))
    rows = []
    for k, (p, t) in enumerate(product(range(9), range(12))):
        a = np.radians(ANGLES[p])
        length = dist((0.07 * np.cos(a), 0.07 * np.sin(a), 0.12), TARGETS[t]) - 0.25
        late = int(k >= break_at)
        cells = [str(p), str(t), repr(float(length + 0.01 * late)), str(late)]
        rows.append(",".join(cells[: header.count(",") + 1]))
    path = folder / "lengths.csv"
    path.write_text("\n".join([header, *rows]))
    return path


def setup(**solver: object) -> Configuration:
    plan = {"plan": {"table_angles_deg": ANGLES}, "solver": solver}
    return parse_configuration(dump_configuration("tracer_multistation", plan))


def test_a_table_with_segments_has_a_zero_for_each(tmp_path: Path) -> None:
    path = table(tmp_path, "position,target,length_m,segment", 60)  # position 5 begins with 60
    result = read_measurements(path, setup()).solve()
    assert np.abs(result.deviations["ECC"]).max() < 1e-9
    assert result.dof == 108 - 27 - 2 + ALONG
    own = read_measurements(path, setup(zero="per_station")).solve()
    assert own.dof == 108 - 36 + ALONG
    with pytest.raises(ConfigurationError, match="choose the variant 'joint', or a zero per sta"):
        read_measurements(path, setup(variant="station")).solve()


def test_an_interrupted_run_begins_a_segment(tmp_path: Path) -> None:
    path = table(tmp_path, "position,target,length_m", 999)
    data = read_measurements(path, setup(zero="per_segment"))
    observations = [
        replace(o, run=int(k >= 40), mean=(o.mean[0] + 0.01 * (k >= 40),))
        for k, o in enumerate(data.observations)
    ]
    again = [replace(o, run=1, mean=(o.mean[0] + 0.01,)) for o in observations[:3]]
    posed = problem(data.calibration.configuration, data.calibration.plan, observations)
    assert posed.segment is not None
    assert posed.segment.tolist() == [0] * 40 + [1] * 68
    result = data.calibration.solve([*observations, *again])
    assert np.abs(result.deviations["ECC"]).max() < 1e-9
    assert result.dof == 111 - 27 - 2 + ALONG
