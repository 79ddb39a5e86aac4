"""A simulated table with a tracer at several places on it: truth and lengths, without rotcal."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from scipy_tracer_six import gauge_free

TARGETS = Path(__file__).parent / "data" / "six_targets.csv"
LENGTH_STD, TARGET_STD = 2e-7, 1e-6


def good_targets():
    """24 targets in x +-0.6, y +-0.5, z 0.17 to 1.02 m, at least 10 degrees above all places.

    Exchanged one by one at random from a draw as long as the largest uncertainty fell.
    """
    return np.loadtxt(TARGETS, delimiter=",", skiprows=1)


def on_circle(n_places=3, radius=0.15, heights=0.0, spacing_deg=120.0):
    angle = np.radians(spacing_deg) * np.arange(n_places)
    height = np.broadcast_to(heights, angle.shape)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


@dataclass(frozen=True)
class SixScene:
    """Curves ``c``, ``d`` (m, 3) of the table; ``rows`` are the arguments of a problem."""

    c: np.ndarray
    d: np.ndarray
    rows: dict

    @property
    def truth(self):
        """The six curves (6, m) in the gauge of the method."""
        angles = self.rows["table_angles"]
        return np.concatenate([gauge_free(self.d, angles).T, gauge_free(self.c, angles).T])


def place_segments(rng, n_places, per_place, breaks):
    """Return the segment of each length, every run broken ``breaks`` times at random."""
    first = [
        np.searchsorted(np.sort(rng.integers(1, per_place, breaks)), np.arange(per_place), "right")
        for _ in range(n_places)
    ]
    return np.concatenate([run + k * (breaks + 1) for k, run in enumerate(first)])


def scene(
    rng, targets=None, places=None, m=12, curves=(2e-6, 1e-5), scatter=(0.0, 0.0), arrivals=1,
    noise=1.0, mounted=1e-3, lean=(0.0, 0.0), zero="per_run", angles=None, breaks=0, table=None,
):  # fmt: skip
    """Return a simulated measurement.

    ``zero`` "per_segment": in each run the beam broke ``breaks`` times, at random.

    ``curves``, ``scatter``: standard deviations in m and rad. ``table``: curves (c, d) of their
    own, as those of another scene. ``mounted``: how far from the
    nominal places the tracer stands, m; ``lean`` of the axis in the machine, rad.
    """
    targets = good_targets() if targets is None else targets
    places = on_circle() if places is None else places
    angles = np.arange(m) * 2.0 * np.pi / m if angles is None else angles
    m, p, n = len(angles), len(places), len(targets)
    d, c = curves[0] * rng.normal(size=(m, 3)), curves[1] * rng.normal(size=(m, 3))
    c, d = (c, d) if table is None else table
    place, position, arrival = (x.ravel() for x in np.mgrid[:p, :m, :arrivals])
    axis = Rotation.from_rotvec([lean[0], lean[1], 0.0])
    turned = axis * Rotation.from_rotvec(c) * Rotation.from_euler("z", angles[:, None])
    mount = places + mounted * rng.normal(size=places.shape)
    arms = turned[position].apply(mount[place])
    moved = scatter[0] * rng.normal(size=arms.shape)
    moved += np.cross(scatter[1] * rng.normal(size=arms.shape), arms)
    stations = arms + axis.apply(d)[position] + moved
    there = targets + noise * TARGET_STD * rng.normal(size=targets.shape)
    count = p if zero == "per_run" else len(stations)
    segment = place if zero == "per_run" else np.arange(count)
    length = np.linalg.norm(there - stations[:, None], axis=2)
    whole = place_segments(rng, p, m * arrivals * n, breaks) if zero == "per_segment" else None
    if whole is None:
        length -= rng.uniform(0.2, 0.5, count)[segment][:, None]
    else:
        length -= rng.uniform(0.2, 0.5, p * (breaks + 1))[whole].reshape(length.shape)
    length += noise * LENGTH_STD * rng.normal(size=length.shape)
    rows = {
        "position": np.repeat(position, n), "place": np.repeat(place, n),
        "target": np.tile(np.arange(n), len(stations)), "length": length.ravel(),
        "length_std": LENGTH_STD, "targets": targets, "target_std": TARGET_STD,
        "table_angles": angles, "places": places, "zero": zero,
        "arrival": np.repeat(arrival, n), "segment": whole,
    }  # fmt: skip
    return SixScene(c, d, rows)
