"""Tables of ours in the real LinuxCNC: it takes them all, and moves as our model says."""

import os
import shutil
import subprocess
from dataclasses import replace
from datetime import datetime, timezone

import numpy as np
import pytest
from real_linuxcnc import Axis, Running

from rotcal_ros.compensation import linuxcnc
from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC, DEGREE

pytestmark = pytest.mark.linuxcnc

TOLERANCE_DEG = 1e-6
FROM_BELOW = (-340.0, -181.3, -60.0, 3.7, 10.0, 17.5, 45.0, 88.8, 90.0, 135.2, 180.0, 201.1, 240.0,
              277.77, 300.0, 354.9, 359.5, 360.0, 361.0, 370.0, 402.5, 450.0, 555.5, 719.0, 720.0,
              733.3)  # fmt: skip
FROM_ABOVE = FROM_BELOW[-2::-1]


def table():
    """Two different directions, ten arcseconds and more, rows from a closed curve."""
    angles = np.arange(24) * np.pi / 12

    def curve(t, phase):
        return 40 * ARCSEC * (np.sin(t + phase) - np.sin(phase) + 0.4 * np.sin(3 * t))

    return CompensationTable(
        axis="A",
        method="example",
        angles=angles,
        correction_forward=curve(angles, 0.3),
        correction_reverse=curve(angles, 0.8) + 6 * ARCSEC,
        std=np.full(24, 0.1 * ARCSEC),
        period=2 * np.pi,
        reference_angle=0.0,
        verdict="ok",
    )


def exported(**settings):
    made = prepare_export(
        table(),
        "linuxcnc",
        now=datetime(2024, 1, 1, tzinfo=timezone.utc),
        spacing=10 * DEGREE,
        settings=settings,
    )
    return {n: t for n, t in made.files.items() if not n.endswith(".json")}


def take(axis, files, file_type=1):
    (text,) = (text for name, text in files.items() if name.endswith(".comp"))
    axis.load(text, file_type)


@pytest.mark.parametrize(
    ("file_type", "every"), [pytest.param(1, 1, marks=pytest.mark.slow), (0, 5)]
)
def test_the_real_motion_follows_our_model(axis, file_type, every):
    settings = {"first_turn": -1, "turns": 3, "file_type": file_type}
    files = exported(**settings)
    take(axis, files, file_type)
    rule = linuxcnc.LinuxCnc(**settings).read(files)
    worst = 0.0
    with Running(axis) as running:
        running.go(-350.0, 1)
        both = ((FROM_BELOW, 1, Approach.POSITIVE), (FROM_ABOVE, -1, Approach.NEGATIVE))
        for angles, side, approach in both:
            for angle in angles[::every]:
                state = running.go(angle, side)
                moved = state["motor_deg"] - angle
                at = np.array([angle * DEGREE])
                model = rule.correction(at, approach)[0] / DEGREE
                assert moved == pytest.approx(model, abs=TOLERANCE_DEG), (angle, side)
                worst = max(worst, abs(moved - model))
        assert running.errors == []
    assert worst > 0.0  # it did move on its own account
    assert len(FROM_BELOW) + len(FROM_ABOVE) >= 30


@pytest.mark.parametrize("part", ["io", "milltask"])
def test_a_part_that_starts_late_is_waited_for(axis, part, tmp_path, monkeypatch):
    late = tmp_path / part
    late.write_text(f'#!/bin/sh\nsleep 1.5\nexec {shutil.which(part)} "$@"\n')
    late.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    with Running(axis) as running:
        assert running.go(10.0, 1)["motor_deg"] == pytest.approx(10.0, abs=1e-6)


def test_a_full_table_of_256_rows_is_taken_without_a_message(axis):
    made = prepare_export(
        table(),
        "linuxcnc",
        now=datetime(2024, 1, 1, tzinfo=timezone.utc),
        spacing=360 / 85 * DEGREE,
        settings={"turns": 3},
    )
    take(axis, made.files)
    (rows,) = (t for n, t in made.files.items() if n.endswith(".comp"))
    assert rows.count("\n") == 256
    with Running(axis) as running:
        state = running.go(1080.0, 1)
        assert state["motor_deg"] == pytest.approx(1080.0, abs=TOLERANCE_DEG)
        state = running.go(1000.0, -1)
        assert abs(state["motor_deg"] - 1000.0) > 1e-3
        assert running.errors == []


@pytest.mark.parametrize(
    ("damage", "complaint"),
    [
        (lambda text: "# a comment\n" + text, ""),
        (lambda text: text.replace("\n", "\n\n", 1), ""),
        (lambda text: text.replace(" ", ","), ""),
        (lambda text: text + "5 0 0\n", "must increase"),
    ],
    ids=["comment", "blank line", "commas", "not ascending"],
)
def test_our_reader_refuses_what_the_real_one_swallows(axis, damage, complaint):
    """What LinuxCNC does in silence with a damaged table is what our model of its reader says."""
    files = exported()
    files = {n: damage(t) if n.endswith(".comp") else t for n, t in files.items()}
    (text,) = (t for n, t in files.items() if n.endswith(".comp"))
    with pytest.raises(linuxcnc.BagError):
        linuxcnc.LinuxCnc().read(files)
    loaded = linuxcnc.load_as_linuxcnc(text, 1)
    take(axis, files)
    with Running(axis) as running:
        for angle in (33.0, 145.0):
            state = running.go(angle, 1)
            at = np.array([angle * DEGREE])
            model = loaded.correction(at, Approach.POSITIVE)[0] / DEGREE
            assert state["motor_deg"] - angle == pytest.approx(model, abs=TOLERANCE_DEG)
        assert bool(running.errors) == bool(complaint), running.errors
        assert complaint in " ".join(running.errors)


def test_a_machine_that_is_off_is_not_switched_on_by_the_driver(axis):
    run = subprocess.run(
        axis.command(start=False),
        input="",
        capture_output=True,
        text=True,
        timeout=load_scaled_timeout(60),
        check=False,
    )
    assert run.returncode == 1
    assert "switch it on and home it first" in run.stderr


def exported_for(axis, forward_arcsec, reverse_arcsec, reference):
    """Write a table of 36 rows for the machine of ``axis`` and let this take it."""
    columns = {
        "correction_forward": forward_arcsec * ARCSEC,
        "correction_reverse": reverse_arcsec * ARCSEC,
        "angles": np.arange(36) * 10 * DEGREE,
        "std": np.full(36, 0.1 * ARCSEC),
    }
    made = prepare_export(
        replace(table(), **columns, reference_angle=reference * DEGREE),
        "linuxcnc",
        now=datetime(2024, 1, 1, tzinfo=timezone.utc),
        settings={"machine_ini": str(axis.ini)},
        spacing=10 * DEGREE,
    )
    axis.take(made)
    return made


ZONES_ARCSEC = {(20, 70): 10.0, (120, 200): 25.0, (250, 340): 50.0}
"""Reversals below, within and above the dead band of 18 to 36 arcsec of this machine."""


def test_a_reversal_in_the_dead_band_of_the_real_trim_stays_as_stated(tmp_path):
    axis = Axis(tmp_path / "axis", limits=(0, 360))
    reverse = np.zeros(36)
    for (first, last), arcsec in ZONES_ARCSEC.items():
        reverse[first // 10 : last // 10 + 1] = arcsec
    made = exported_for(axis, np.zeros(36), reverse, reference=0)
    left = []
    with Running(axis) as running:
        for (first, last), arcsec in ZONES_ARCSEC.items():
            middle = (first + last) / 2
            running.go(middle, 1)
            trim = (running.go(middle, -1)["motor_deg"] - middle) * 3600
            left.append(arcsec - trim)
        assert running.errors == []
    assert left == pytest.approx([0.0, 25.0, 0.0], abs=0.004)
    assert 25.0 < made.residual.simulated / ARCSEC < made.residual.stated / ARCSEC < 60.0
    assert made.residual.following == pytest.approx(36.0 * ARCSEC, rel=0.011)
    assert any("stands still for those of 18 to 36" in warning for warning in made.warnings)


def test_the_trim_of_a_homed_machine_stays_at_zero_as_stated(tmp_path):
    """Homed at 0, where a table with its reference elsewhere asks for one in the dead band."""
    axis = Axis(tmp_path / "axis", limits=(0, 360))
    column = np.full(36, 25.0)
    column[10:16], column[20] = 60.0, 0.0
    made = exported_for(axis, column, column, reference=200)
    with Running(axis) as running:
        trims = [(running.go(at, 0)["motor_deg"] - at) * 3600 for at in (30.0, 80.0, 130.0, 30.0)]
        assert running.errors == []
    assert trims == pytest.approx([0.0, 0.0, 60.0, 25.0], abs=0.004)
    assert 25.0 < made.residual.simulated / ARCSEC < 41.0
    assert made.residual.stated > made.residual.simulated
    assert any("has been homed, at 0 deg" in warning for warning in made.warnings)
