"""Hold the fits of rotcal_ros.geometry against public reference data, in a folder of your own.

Read are the reference pairs of NIST's Algorithm Testing System (the archive
NIST-L2-reference-pairs, after ASME B89.4.10-2000). NAME.ds holds the number of points and then a
point x y z in each line, NAME.fit the numbers of its least-squares fit. Names begin with the kind:
pla (point, normal), sph (centre, diameter), cir (centre, normal, diameter). Lines, cylinders and
cones are no fits of this project and are counted only. Units are millimetres.

    python research/check_public_sets.py FOLDER

The exit code is 1 when a plane or sphere differs from its reference by more than 1 nm or 1e-9 rad.
Circles are shown, not judged: the fit of the laser tracer paper is algebraic, the references are
of orthogonal distance.
"""

from __future__ import annotations

import sys
from collections import Counter, defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.foundation.errors import GeometryError
from rotcal_ros.geometry.plane import fit_circle, fit_plane
from rotcal_ros.geometry.sphere import fit_spheres

Floats = NDArray[np.float64]
LIMIT = {"mm": 1e-6, "rad": 1e-9}
JUDGED = ("pla", "sph")
Difference = dict[str, tuple[float, str]]
"""Name of a quantity -> difference from the reference and its unit."""


def read_points(path: Path) -> Floats:
    """Return the points (n, 3) of a data set; ValueError when there are more or fewer."""
    lines = path.read_text().split("\n")
    points = np.array([line.split() for line in lines[1:] if line.strip()], dtype=np.float64)
    if points.shape != (int(lines[0]), 3):
        raise ValueError(f"{path}: {lines[0].strip()} points announced, shape {points.shape}")
    return points


def angle(first: Floats, second: Floats) -> float:
    """Return the angle between two directions whose signs mean nothing, rad."""
    turned = second if first @ second > 0.0 else -second
    return 2.0 * float(np.arcsin(min(1.0, np.linalg.norm(first - turned) / 2.0)))


def plane(points: Floats, reference: Floats) -> Difference:
    """Compare a plane: its normal, and how far the reference point lies from it."""
    found = fit_plane(points)
    away = abs(float(found.distances(reference[None, :3])[0]))
    return {"normal": (angle(found.normal, reference[3:]), "rad"), "place": (away, "mm")}


def sphere(points: Floats, reference: Floats) -> Difference:
    """Compare a sphere of unknown radius; GeometryError when the project refuses the points."""
    found = fit_spheres(points[None], radius=None, reject=False)
    if found.reason[0]:
        raise GeometryError(found.reason[0])
    centre = float(np.linalg.norm(found.centres[0] - reference[:3]))
    return {
        "centre": (centre, "mm"),
        "diameter": (abs(2.0 * float(found.radii[0]) - float(reference[3])), "mm"),
    }


def circle(points: Floats, reference: Floats) -> Difference:
    """Compare a circle in the plane of least squares through its points."""
    found = fit_plane(points)
    basis = found.basis()
    flat = fit_circle((points - found.centroid) @ basis.T)
    centre = found.centroid + flat.centre @ basis
    return {
        "normal": (angle(found.normal, reference[3:6]), "rad"),
        "centre": (float(np.linalg.norm(centre - reference[:3])), "mm"),
        "diameter": (abs(2.0 * flat.radius - float(reference[6])), "mm"),
    }


KINDS: dict[str, Callable[[Floats, Floats], Difference]] = {
    "cir": circle,
    "pla": plane,
    "sph": sphere,
}


def main(folder: Path) -> int:
    """Compare all pairs below ``folder`` and print the largest differences of each kind."""
    worst: dict[tuple[str, str, str], float] = defaultdict(float)
    sets: Counter[str] = Counter()
    refused: list[str] = []
    for path in sorted(folder.rglob("*.ds")):
        kind, fit = path.stem[:3], path.with_suffix(".fit")
        sets[kind] += 1
        if kind not in KINDS or not fit.exists():
            continue
        reference = np.array(fit.read_text().split(), dtype=np.float64)
        try:
            differences = KINDS[kind](read_points(path), reference)
        except GeometryError as error:
            refused.append(f"{path.name} refused: {error}")
            continue
        for name, (value, unit) in differences.items():
            worst[kind, name, unit] = max(worst[kind, name, unit], value)
    print(f"{folder}: sets", ", ".join(f"{kind} {count}" for kind, count in sets.items()) or 0)
    for (kind, name, unit), value in worst.items():
        print(f"{kind} {name:8s} largest difference {value:.2e} {unit}")
    for text in refused:
        print(text)
    judged = {key: value for key, value in worst.items() if key[0] in JUDGED}
    return int(not judged or any(value > LIMIT[key[2]] for key, value in judged.items()))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    sys.exit(main(Path(sys.argv[1])))
