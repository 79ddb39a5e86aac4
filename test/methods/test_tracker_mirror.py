from dataclasses import replace

import numpy as np
import pytest
from mirror_cell import measure, paper_cell, ring_cell

from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods.plane_mirror.mirror_physics import FlatMirror, TrackerStation


def still(n):
    return np.zeros((n, 6))


@pytest.mark.parametrize("aside", [(0.4, 0.4), (-0.4, 0.4), (0.5, -0.2)])
def test_glass_that_is_not_flat_folds_the_beam_beside_its_middle_too(aside):
    """Of all ways over the glass, at the grid of its height, the one to the image is shortest."""
    mirror = FlatMirror(lean=0.05, sag=2e-5, twist=-3e-5)
    centre, frame = mirror.pose(np.eye(3))
    station = TrackerStation((2.0, 0.3, 0.35))
    spot = centre + frame[:, :2] @ np.array(aside) * 0.05
    beam = np.array(station.place) - spot
    place = spot + 2.0 * (beam @ frame[:, 2]) * frame[:, 2] - beam  # at about where it goes to
    image = mirror.image((centre, frame), station, place, "here")
    u, v = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-0.6, 0.6, 481)] * 2))
    height = mirror.sag * (u**2 + v**2) + mirror.twist * u * v
    glass = centre + np.column_stack([u * 0.05, v * 0.05, height]) @ frame.T
    ways = np.linalg.norm(glass - station.place, axis=1) + np.linalg.norm(place - glass, axis=1)
    assert np.linalg.norm(image - station.place) == pytest.approx(ways.min(), abs=1e-7)


def test_mirror_turned_away_is_refused():
    angles = np.radians([0.0, 180.0])
    cell = replace(ring_cell(angles, ((0, 1),)), stations=paper_cell().stations[:1])
    with pytest.raises(PlanError, match="table at 180 deg, tracker station 0: the beam misses"):
        measure(cell, still(2))
