"""What each control does with a file, as ``independent_controls.py`` has it of the core's."""

import re
from importlib.metadata import distribution

import numpy as np
from independent_controls import Control, every_turn, text_of

OURS = sorted(
    point.name
    for point in distribution("rotcal_controllers").entry_points
    if point.group == "rotcal_ros.controllers"
)
"""The names that people write."""


def sinumerik(files):
    """ENC_COMP moves the axis in the negative direction, whichever way it came."""
    found = re.findall(r"\$AA_ENC_COMP\[0,\d+,C\]=(\S+)", text_of(files, ".ini"))
    values = np.array(found, dtype=float)
    return every_turn(np.linspace(0, 360, len(values)), values, values, -1.0)


def sinumerik_cec(files):
    """Two tables that are added, the first for one direction, the second for the other."""
    text = text_of(files, ".ini")
    found = [re.findall(rf"\$AN_CEC\[{k},\d+\]=(\S+)", text) for k in (0, 1)]
    up, down = (np.array(column, dtype=float) for column in found)
    assert re.findall(r"DIRECTION\[(\d)\]=(-?1)", text) == [("0", "1"), ("1", "-1")]
    return every_turn(np.linspace(0, 360, len(up)), up, down, 1.0)


def twincat(files):
    text = text_of(files, ".lis")
    up, down = (
        np.array([int(v) for v in re.findall(rf"\.{way} (-?\d+)", text)]) for way in ("pos", "neg")
    )
    down = down if "bilateral 1" in text else up
    assert (up[0], down[0]) == (up[-1], down[-1])
    return every_turn(np.linspace(0, 360, len(up)), up, down, -1e-4)


def twincat_nc(files):
    """The additive value of the table whose direction it is, or of the only one."""
    text = text_of(files, ".st")
    column = {}
    for part in text.split("_parameter : ")[1:]:
        cells = re.findall(r"Position := ([-\d.]+), Compensation := ([-\d.]+)", part)
        assert f"NoOfTableElements := {len(cells)}," in part
        assert "Modulo := TRUE" in part
        column[re.search(r"WorkDirection(\w+)", part)[1]] = np.array(cells, dtype=float).T
    at, up = column.get("Both", column.get("Positive"))
    _, down = column.get("Both", column.get("Negative"))
    return every_turn(at, up, down, 1.0)


def kflop(files):
    """Where the axis is to be, and what has to be commanded for that."""
    head, *points = text_of(files, ".txt").split("\n", 3)[2:]
    number, size = text_of(files, ".txt").splitlines()[:2]
    index, commanded = np.loadtxt(points[0].splitlines(), delimiter=",").T
    assert len(index) == int(number)
    wanted = float(head) + float(size) * index
    return lambda at, _: np.interp(at, wanted, commanded) - at


def smoothieware(files):
    """The motor goes to the integral of the multiplier from zero: quadratures of a fine grid."""
    rows = [line.split()[1:] for line in text_of(files, ".dat").splitlines()]
    position, multiplier = np.array(rows, dtype=float).T
    grid = np.union1d(position, np.linspace(position[0], position[-1], 40_001))
    density = np.interp(grid, position, multiplier)
    total = np.append(0.0, np.cumsum(np.diff(grid) * (density[1:] + density[:-1]) / 2))
    total -= np.interp(0.0, grid, total)
    return lambda at, _: np.interp(at, grid, total) - at


def aerotech(files):
    """Arcseconds from 0 on, every SAMPLEDIST; the program that wrote them negates the error."""
    text = re.sub("^;.*\n", "", text_of(files, ".cal"), flags=re.MULTILINE)
    head, *values = text.replace("\n:END\n", "").split("\n")
    assert head.startswith(":START 1 ")
    assert "CORUNIT=PRIMARY/3600" in head
    added = np.array(" ".join(values).split(), dtype=float)
    at = np.arange(len(added)) * float(re.search(r"SAMPLEDIST=(\S+)", head)[1])
    return lambda angle, _: np.interp(angle, at, added) / 3600


def acs(files):
    text = text_of(files, ".prg")
    added = np.array(re.findall(r"^C_CORRECTION\(\d+\)=(\S+)$", text, re.MULTILINE), dtype=float)
    base, step = map(float, re.search(r"^ERRORMAP1D 0, 0, (\S+), (\S+), ", text, re.M).groups())
    assert text.endswith("ERRORMAPON 0, 0\nSTOP\n")
    at = base + step * np.arange(len(added))
    return lambda angle, _: np.interp(angle, at, added)


def mach4(files):
    at, up, down = np.loadtxt(text_of(files, ".txt").splitlines()[4:]).T
    return lambda angle, rising: np.interp(angle, at, up if rising else down)


def centroid(files):
    at, up, down = np.loadtxt(text_of(files, ".tab").splitlines()[5:]).T
    return lambda angle, rising: np.interp(angle, at, up if rising else down)


def encoder_lut(files):
    """The reading less the offset, linear between two of the entries, of 3600000 counts a turn.

    The table stands where the corrected reading is the wanted angle: sought by bisection.
    """
    text = text_of(files, ".h").split("{")[1]
    offset = np.array(re.findall(r"-?\d+", text), dtype=float) * 1e-4
    n = len(offset)

    def corrected(reading):
        place = np.mod(reading, 360.0) * n / 360.0
        low = np.floor(place).astype(int) % n
        share = place - np.floor(place)
        return reading - (1.0 - share) * offset[low] - share * offset[(low + 1) % n]

    def correction(at, _):
        low, high = at - 1.0, at + 1.0
        for _ in range(50):
            middle = (low + high) / 2.0
            beyond = corrected(middle) > at
            low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
        return (low + high) / 2.0 - at

    return correction


def heidenhain(files):
    _, angle, backlash, up = np.loadtxt(text_of(files, ".COM").splitlines()[2:-1]).T
    return every_turn(angle, up, backlash, -1.0)


def fagor(files):
    rows = re.findall(r"P\d+ C (\S+) EC (\S+) EC (\S+)", text_of(files, ".txt"))
    angle, up, down = np.array(rows, dtype=float).T
    return every_turn(angle, up, down, -1.0)


def pmac(files):
    """Sixteenths of a count of 3600000 per turn; BLCOMP and I186 are taken off on the way down.

    A backlash is never negative, and without a rate (I185) nothing is taken off.
    """
    text = text_of(files, ".pmc")
    tables = dict(re.findall(r"#1 DEFINE (\w+) \d+,3600000\n([^\n]+)", text))
    up = np.array([0, *map(int, tables["COMP"].split())])
    play = np.array([0, *map(int, tables["BLCOMP"].split())]) if "BLCOMP" in tables else 0 * up
    variable = {name: int(value) for name, value in re.findall(r"I1(8[56])=(\d+)\n", text)}
    down = up - (play + variable["86"] if variable.get("85") else 0)
    return every_turn(np.linspace(0, 360, len(up)), up, down, 360 / 3_600_000 / 16)


def fanuc(files):
    """Each slot's step comes out amid its interval, in units of 0.0001 deg x magnification.

    With 3605#0 the slots from 3626 on are those of the way down, and 3627 is what it begins with.
    """
    values = dict(re.findall(r"N(\d{5})(?:A\d+)?P(-?[\d.]+);", text_of(files, ".txt")))
    n = int(values["03622"]) - int(values["03621"])

    def way(first, start):
        steps = [int(values[f"{10000 + first + k:05d}"]) for k in range(1, n + 1)]
        return start * 1e-4 + np.concatenate([[0], np.cumsum(steps)]) * 1e-4 * int(values["03623"])

    up = down = way(0, 0)
    if "03626" in values:
        down = way(int(values["03626"]), int(values["03627"]))

    def correction(at, rising):
        place = np.floor(np.mod(at, 360.0) * n / 360.0 + 0.5).astype(int)
        return (up if rising else down)[place]

    return correction


CONTROLS = {
    "sinumerik": Control("sinumerik", sinumerik, {}),
    "sinumerik cec": Control("sinumerik", sinumerik_cec, {"tables": "cec"}),
    "twincat": Control("twincat", twincat, {"backlash_deg": 0.0}),
    "twincat_nc": Control("twincat_nc", twincat_nc, {}),
    "twincat_nc each": Control("twincat_nc", twincat_nc, {"directions": "each"}),
    "kflop": Control("kflop", kflop, {"turns": 2, "first_turn": -1}),
    "smoothieware": Control("smoothieware", smoothieware, {}),
    "aerotech": Control("aerotech", aerotech, {"turns": 3}),
    "acs": Control("acs", acs, {"turns": 2, "first_turn": -1}),
    "mach4": Control("mach4", mach4, {"turns": 2, "first_turn": -1}),
    "mach4 each": Control("mach4", mach4, {"directions": "each"}),
    "centroid": Control("centroid", centroid, {"turns": 2, "first_turn": -1}),
    "encoder_lut": Control("encoder_lut", encoder_lut, {"counts_per_turn": 3_600_000}),
    "heidenhain": Control("heidenhain", heidenhain, {}),
    "fagor": Control("fagor", fagor, {}),
    "pmac": Control("pmac", pmac, {"backlash_sixteenths": 0, "counts_per_turn": 3_600_000}),
    "fanuc": Control("fanuc", fanuc, {"detection_unit_deg": 0.0001, "slots": 512}),
    "fanuc each": Control(
        "fanuc", fanuc, {"directions": "each", "detection_unit_deg": 0.0001, "slots": 1024}
    ),
}
