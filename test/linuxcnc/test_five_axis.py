"""A ball on a displaced axis: touched, solved, set and touched again by the real LinuxCNC."""

import json
import math
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from five_axis import FiveAxis
from plants import SMALLER
from snippets import blocks

from rotcal_ros.cli.main import rotcal

pytestmark = [pytest.mark.linuxcnc, pytest.mark.slow]

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "five_axis"
AXIS_MM = (0.11, -0.07, 80.0)
LEAN = (2e-5, -3e-5)
STOPS = 8
PLANT = {
    "C": [AXIS_MM, [LEAN[1], -LEAN[0], 1.0]],
    "A": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
    "ball": [150.1, 0.1, 80.05],
}


def program(folder, follow):
    """Return the program of the example for fewer stops."""
    text = (EXAMPLE / "touch_ball.ngc").read_text()
    text = text.replace("#<stops> = 12", f"#<stops> = {STOPS}")
    path = folder / f"follow_{follow}.ngc"
    path.write_text(text.replace("#<follow> = 0 ", f"#<follow> = {follow} "))
    return path


def page_commands():
    """Return the words of each command of the page."""
    page = ROOT / "docs" / "five_axis.md"
    lines = [b.text for b in blocks(page) if b.text.startswith("rotcal")]
    return [line.split()[1:] for text in lines for line in text.splitlines()]


def run(words):
    done = CliRunner().invoke(rotcal, words)
    assert done.exit_code == 0, done.output
    return done


def missed_by_kinematics(table):
    """Return how far (mm) the axis is from where the control turns about: by its own movement.

    A ball that the control follows perfectly stands still.
    """
    angle, _, dx, dy, _ = np.loadtxt(table, delimiter=",", skiprows=1)[:STOPS].T
    turn = np.exp(-1j * np.radians(angle))
    seen = (dx + 1j * dy) * turn  # in the axes of the table
    return abs(np.mean(seen / turn)), np.ptp(seen.real), np.ptp(seen.imag)


def test_a_displaced_axis_is_measured_set_and_measured_again(tmp_path, monkeypatch):
    machine = FiveAxis(tmp_path / "machine", PLANT)
    programs = [program(tmp_path, follow) for follow in (0, 1)]
    machine.run(*programs)
    before = missed_by_kinematics(machine.folder / "followed.csv")
    assert before[0] == pytest.approx(math.hypot(*AXIS_MM[:2]), abs=2e-3)

    work = tmp_path / "work"
    work.mkdir()
    setup = (EXAMPLE / "setup.yaml").read_text()
    setup = setup.replace("table_step_deg: 30.0", f"table_step_deg: {360 / STOPS}")
    setup = setup.replace("table_positions: 12", f"table_positions: {STOPS}")
    (work / "setup.yaml").write_text(setup)
    shutil.copy(machine.ini, work / "machine.ini")
    shutil.copy(machine.folder / "centres.csv", work)
    monkeypatch.chdir(work)
    solve, export, again = page_commands()
    run(solve)
    axis = json.loads(Path("result.json").read_text())["details"]["axis"]
    true = [AXIS_MM[0] * 1e-3, AXIS_MM[1] * 1e-3, *LEAN]
    assert np.abs((np.array(axis["value"]) - true) / axis["std"]).max() < 3.0
    assert axis["value"][:2] == pytest.approx(true[:2], abs=1e-6)
    assert axis["value"][2:] == pytest.approx(true[2:], abs=1e-5)
    run(export)

    machine.place(Path("place/c_linuxcnc_axis.hal").read_text("latin-1"))
    machine.run(programs[1])
    after = missed_by_kinematics(machine.folder / "followed.csv")
    assert max(after) < before[0] / SMALLER

    pins = re.findall(r"rot-point (\S+)", Path("place/c_linuxcnc_axis.hal").read_text("latin-1"))
    there = ", ".join(f"{float(pin) * 1e-3:.9f}" for pin in pins)
    Path("after.yaml").write_text(setup.replace("axis_m: [0.0, 0.0,", f"axis_m: [{there},"))
    shutil.copy(machine.folder / "followed.csv", work)
    run(again)
    left = json.loads(Path("after.json").read_text())["details"]["axis"]["value"]
    assert math.hypot(*left[:2]) * 1e3 < before[0] / SMALLER
