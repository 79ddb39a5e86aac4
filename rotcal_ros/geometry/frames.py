"""Static frames and the transforms between them, as a tree.

Named and used as in ROS (REP 103, REP 105): right-handed, metres; a transform holds the origin and
the axes of the child in its parent. Quaternions are (x, y, z, w).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats

_LEAST_NORM: Final = 1e-6


@dataclass(frozen=True)
class StaticFrame:
    """Where ``child`` lies in ``parent``: moved by ``translation`` (m), turned by ``rotation``."""

    parent: str
    child: str
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]

    @property
    def usable(self) -> bool:
        """Whether the numbers are finite and the quaternion is one that turns."""
        numbers = np.array([*self.translation, *self.rotation])
        return bool(np.isfinite(numbers).all() and np.linalg.norm(self.rotation) > _LEAST_NORM)


@dataclass(frozen=True)
class Pose:
    """Axes (3, 3), the columns of a rotation, and ``origin`` (3,), m, of one frame in another."""

    axes: Floats
    origin: Floats

    def __matmul__(self, inner: Pose) -> Pose:
        """Return the pose of what lies at ``inner`` in this one."""
        return Pose(self.axes @ inner.axes, self.axes @ inner.origin + self.origin)

    def inverse(self) -> Pose:
        """Return the pose of the outer frame in this one."""
        return Pose(self.axes.T, -self.axes.T @ self.origin)


class FrameTree:
    """Frames that stand still; of a child that is stated twice the last one counts.

    What cannot be used is left out; a name may begin with a slash, as old ones do.
    """

    def __init__(self, frames: Iterable[StaticFrame]) -> None:
        self._parents = {
            _name(f.child): (_name(f.parent), pose_from_frame(f)) for f in frames if f.usable
        }

    def __contains__(self, frame: str) -> bool:
        name = _name(frame)
        return name in self._parents or any(name == p for p, _ in self._parents.values())

    def pose(self, frame: str, reference: str) -> Pose | None:
        """Return where ``frame`` lies in ``reference``; None if nothing static joins them."""
        here, there = self._to_root(_name(frame)), self._to_root(_name(reference))
        common = next((name for name in here if name in there), None)
        return None if common is None else there[common].inverse() @ here[common]

    def _to_root(self, name: str) -> dict[str, Pose]:
        """Return the pose of ``name`` in each frame from itself to its root, a loop once."""
        pose, found = Pose(np.eye(3), np.zeros(3)), {}
        while name not in found:
            found[name] = pose
            if name not in self._parents:
                break
            name, step = self._parents[name]
            pose = step @ pose
        return found


def pose_from_frame(frame: StaticFrame) -> Pose:
    """Return a transform as a pose; its quaternion is scaled to norm 1 (it must not be 0)."""
    x, y, z, w = np.asarray(frame.rotation) / np.linalg.norm(frame.rotation)
    axes = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return Pose(axes, np.array(frame.translation, dtype=np.float64))


def _name(frame: str) -> str:
    return frame.lstrip("/")
