"""The ball plate as a small YAML file: grid, ball steps, circle, balls, material."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from rotcal_ros.errors import ConfigurationError
from rotcal_ros.methods.ball_plate.problem import Floats, grid_angles

_REQUIRED = ("grid", "ball_steps", "circle_radius_m", "ball_diameter_m")
_OPTIONAL = ("method", "name", "material", "separate_groups", "sigma_centre_m", "tip_radius_m")


@dataclass(frozen=True)
class Plate:
    """A circular ball plate; lengths in metres.

    Ball ``ball_steps[r]`` stands at the angle 2 pi step / ``grid``, counter-clockwise seen from
    above. ``sigma_centre`` is the known standard deviation of a ball centre, ``tip_radius`` that
    of the probe, each None when not stated. ``separate_groups`` allows ball steps that share a
    factor with the grid (groups of positions without a connection).
    """

    grid: int
    ball_steps: tuple[int, ...]
    circle_radius: float
    ball_diameter: float
    name: str = "ball plate"
    material: str = ""
    separate_groups: bool = False
    sigma_centre: float | None = None
    tip_radius: float | None = None

    @property
    def nominal_centres(self) -> Floats:
        """Nominal ball centres (R, 3) at table position 0, metres."""
        angle = grid_angles(self.grid)[list(self.ball_steps)]
        return self.circle_radius * np.column_stack(
            [np.cos(angle), np.sin(angle), np.zeros_like(angle)]
        )


def read_plate(path: Path) -> Plate:
    """Read a plate file; raises ConfigurationError with the file, the entry and what is wrong."""
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigurationError(f"cannot read plate file {path}: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{path} is not a YAML file: {error}") from None
    return parse_plate(data, str(path))


def parse_plate(data: Any, where: str) -> Plate:
    """Build a plate from the contents of its file; ``where`` names it in error messages."""
    if not isinstance(data, Mapping):
        raise ConfigurationError(f"{where}: a plate is a list of 'entry: value' lines")
    unknown = sorted(set(map(str, data)) - {*_REQUIRED, *_OPTIONAL})
    missing = [name for name in _REQUIRED if name not in data]
    if unknown or missing:
        raise ConfigurationError(
            f"{where}: missing entries {missing}, unknown entries {unknown}; a plate has "
            f"{', '.join(_REQUIRED)} and may have {', '.join(_OPTIONAL)}"
        )
    if data.get("method", "ball_plate") != "ball_plate":
        raise ConfigurationError(f"{where}: method is {data['method']!r}, not 'ball_plate'")
    grid = _integer(data["grid"], "grid", where)
    plate = Plate(
        grid=grid,
        ball_steps=_steps(data["ball_steps"], grid, where),
        circle_radius=_length(data["circle_radius_m"], "circle_radius_m", where),
        ball_diameter=_length(data["ball_diameter_m"], "ball_diameter_m", where),
        name=str(data.get("name", "ball plate")),
        material=str(data.get("material", "")),
        separate_groups=_truth(data.get("separate_groups", False), where),
        sigma_centre=_optional(data, "sigma_centre_m", where),
        tip_radius=_optional(data, "tip_radius_m", where),
    )
    _check_room(plate, where)
    return plate


def _integer(value: Any, name: str, where: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 3:
        raise ConfigurationError(
            f"{where}: {name} must be a whole number of at least 3: {value!r}"
        )
    return value


def _truth(value: Any, where: str) -> bool:
    if not isinstance(value, bool):
        raise ConfigurationError(f"{where}: separate_groups must be true or false: {value!r}")
    return value


def _steps(value: Any, grid: int, where: str) -> tuple[int, ...]:
    whole = isinstance(value, list) and all(type(step) is int for step in value)
    if not whole or not all(0 <= step < grid for step in value):
        raise ConfigurationError(
            f"{where}: ball_steps must be a list of whole numbers in 0..{grid - 1}: {value!r}"
        )
    twice = sorted({step for step in value if value.count(step) > 1})
    if twice or len(value) < 3:
        raise ConfigurationError(
            f"{where}: at least 3 different ball_steps are needed; {len(value)} found, "
            f"named twice: {twice}"
        )
    return tuple(sorted(value))


def _length(value: Any, name: str, where: str) -> float:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not np.isfinite(value) or value <= 0.0:
        raise ConfigurationError(f"{where}: {name} must be a positive length in metres: {value!r}")
    return float(value)


def _optional(data: Mapping[str, Any], name: str, where: str) -> float | None:
    return None if data.get(name) is None else _length(data[name], name, where)


def _check_room(plate: Plate, where: str) -> None:
    """Refuse lengths in millimetres and balls that overlap."""
    if plate.circle_radius > 10.0:
        raise ConfigurationError(
            f"{where}: a ball circle with a radius of {plate.circle_radius:g} m looks like "
            "millimetres; metres are expected"
        )
    gaps = np.diff(plate.ball_steps, append=plate.ball_steps[0] + plate.grid)
    chord = 2.0 * plate.circle_radius * np.sin(np.pi * int(gaps.min()) / plate.grid)
    if chord < plate.ball_diameter:
        raise ConfigurationError(
            f"{where}: balls {int(gaps.min())} grid steps apart are {chord:.4f} m apart, less "
            f"than their diameter of {plate.ball_diameter:.4f} m; check circle and diameter"
        )
