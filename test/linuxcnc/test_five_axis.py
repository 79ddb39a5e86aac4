"""A ball on displaced axes: touched, solved, set and touched again by the real LinuxCNC."""

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
from scipy.spatial.transform import Rotation
from snippets import blocks

from rotcal_ros.cli.main import rotcal

pytestmark = [pytest.mark.linuxcnc, pytest.mark.slow]

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "five_axis"
C_MM = (0.11, -0.07, 80.0)
TILTING_MM = {"A": (0.0, -0.05, 0.09), "B": (-0.05, 0.0, 0.09)}
LEAN = (2e-5, -3e-5)
FIRST_TILT, TILT_STEP = -30.0, 30.0


def plant(letter, tilts):
    """Return where the axes are, and the ball; leans are not what pins hold: a tilt shows them."""
    lean = (0.0, 0.0) if tilts > 1 else LEAN
    along = [1.0, 0.0, 0.0] if letter == "A" else [0.0, 1.0, 0.0]
    lines = {"C": [C_MM, [lean[1], -lean[0], 1.0]], "tilting": [TILTING_MM[letter], along]}
    return lines | {"ball": [150.1, 0.1, 80.05]}


def program(folder, follow, stops, tilts, letter):
    """Return the program of the example, set for this machine."""
    text = (EXAMPLE / "touch_ball.ngc").read_text()
    own = {"follow": follow, "stops": stops, "tilts": tilts, "safe": 250}
    own |= {"tilt_first": FIRST_TILT if tilts > 1 else 0, "b": int(letter == "B")}
    for name, value in own.items():
        text, count = re.subn(rf"^#<{name}> = \S+", f"#<{name}> = {value}", text, flags=re.M)
        assert count == 1, name
    text, count = re.subn(r"^  o35 endif$", r"\g<0>\n  M66 P0 L3 Q60", text, flags=re.M)
    assert count == 1  # the simulated ball has followed; a real one is where its table is
    path = folder / f"follow_{follow}.ngc"
    path.write_text(text)
    return path


def setup_text(stops, tilts, letter):
    """Return the set-up of the example for so many angles."""
    text = (EXAMPLE / "setup.yaml").read_text()
    text = text.replace("table_step_deg: 30.0", f"table_step_deg: {360 / stops}")
    text = text.replace("table_positions: 12", f"table_positions: {stops}")
    if tilts > 1:
        at = [FIRST_TILT + TILT_STEP * k for k in range(tilts)]
        text = text.replace("plan:\n", f"plan:\n  chain: {letter}C\n  tilts_deg: {at}\n")
    return text


def page_commands():
    """Return the words of each command of the page."""
    page = ROOT / "docs" / "five_axis.md"
    lines = [b.text for b in blocks(page) if b.text.startswith("rotcal")]
    return [line.split()[1:] for text in lines for line in text.splitlines()]


def run(words):
    done = CliRunner().invoke(rotcal, words)
    assert done.exit_code == 0, done.output


def moved_mm(path, letter):
    """Return how far a ball goes, in the axes of the table, that the control believes to follow.

    A control that knows where its axes are keeps it where it is.
    """
    head = path.read_text().splitlines()[0].split(",")
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    c, tilt = rows[:, 0], rows[:, 2] if "tilt" in head else np.zeros(len(rows))
    a = FIRST_TILT + TILT_STEP * tilt if "tilt" in head else tilt
    back = Rotation.from_euler("z", -c[:, None], True) * Rotation.from_euler(
        {"A": "x", "B": "y"}[letter], -a[:, None], True
    )
    seen = back.apply(rows[:, -3:])
    across = seen[:, :2] if "tilt" not in head else seen  # a lean of C moves the ball along it
    return np.linalg.norm(across - across[0], axis=1).max()


@pytest.mark.parametrize(("letter", "stops", "tilts"), [("A", 8, 1), ("A", 6, 3), ("B", 6, 3)])
def test_displaced_axes_are_measured_set_and_measured_again(
    tmp_path, monkeypatch, letter, stops, tilts
):
    machine = FiveAxis(tmp_path / "machine", plant(letter, tilts), letter)
    programs = [program(tmp_path, follow, stops, tilts, letter) for follow in (0, 1)]
    machine.run(*programs)
    before = moved_mm(machine.folder / "followed.csv", letter)
    assert before > 0.2

    work = tmp_path / "work"
    work.mkdir()
    (work / "setup.yaml").write_text(setup_text(stops, tilts, letter))
    shutil.copy(machine.ini, work / "machine.ini")
    shutil.copy(machine.folder / "centres.csv", work)
    monkeypatch.chdir(work)
    solve, export, again = page_commands()
    run(solve)
    axis, *tilting = json.loads(Path("result.json").read_text())["axes"]
    true = [C_MM[0] * 1e-3, C_MM[1] * 1e-3, *(LEAN if tilts == 1 else (0.0, 0.0))]
    assert np.abs((np.array(axis["value"]) - true) / axis["std"]).max() < 3.0
    assert axis["value"][:2] == pytest.approx(true[:2], abs=1e-6)
    across = "yx"["AB".index(letter)]
    if tilts > 1:
        line, there = tilting[0]["value"], np.array(TILTING_MM[letter]) * 1e-3
        wanted = [there["xy".index(across)], there[2], 0.0, 0.0]
        assert line == pytest.approx(wanted, abs=2e-6)
    run(export)

    pins = Path("place/c_linuxcnc_axis.hal").read_text("latin-1")
    machine.place(pins)
    machine.run(programs[1])
    assert moved_mm(machine.folder / "followed.csv", letter) < before / SMALLER

    found = {name: float(x) * 1e-3 for name, x in re.findall(r"kins\.(\S+) (\S+)", pins)}
    there = [found["x-rot-point"], found["y-rot-point"]]
    text = setup_text(stops, tilts, letter).replace(
        "axis_m: [0.0, 0.0,", f"axis_m: [{there[0]}, {there[1]},"
    )
    if tilts > 1:
        point = [0.0, 0.0, found["z-rot-point"]]
        point["xy".index(across)] = found[f"{across}-rot-point"] + found[f"{across}-offset"]
        text = text.replace(f"chain: {letter}C", f"chain: {letter}C\n  tilting_axis_m: {point}")
    Path("after.yaml").write_text(text)
    shutil.copy(machine.folder / "followed.csv", work)
    run(again)
    axes = json.loads(Path("after.json").read_text())["axes"]
    left = [place for axis in axes for place in axis["value"][:2]]
    assert max(map(abs, left)) * 1e3 < math.hypot(*C_MM[:2]) / SMALLER
