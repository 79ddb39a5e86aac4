"""What each control does with a file, from its text alone: no reader or rule of the package.

Every function takes the texts by name and returns the correction in degrees at angles in degrees,
for approaches with increasing (up) or decreasing angle.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np


class Control(NamedTuple):
    """What a control makes of files, and the settings of the controller that they are for."""

    kind: str
    correction: Callable
    settings: Mapping[str, Any]


def text_of(files, suffix):
    return next(text for name, text in files.items() if name.endswith(suffix))


def every_turn(rows, up, down, factor):
    def correction(angle, rising):
        return factor * np.interp(np.mod(angle, 360.0), rows, up if rising else down)

    return correction


def csv(files):
    angle, up, down = np.loadtxt(
        text_of(files, ".csv").splitlines()[1:], delimiter=",", usecols=(0, 1, 2)
    ).T
    if angle[-1] - angle[0] > 359.999:
        return every_turn(angle, up, down, 1 / 3600)
    return lambda at, rising: np.interp(at, angle, up if rising else down) / 3600


def linuxcnc(files):
    """Type 1: trims, added; outside of the rows the end row holds."""
    angle, up, down = np.loadtxt(text_of(files, ".comp").splitlines()).T
    return lambda at, rising: np.interp(at, angle, up if rising else down)


CONTROLS = {
    "csv": Control("csv", csv, {}),
    "linuxcnc": Control("linuxcnc", linuxcnc, {"turns": 2, "first_turn": -1}),
}
