"""Published reference figures: those of NIST's Algorithm Testing System.

The data sets and fits of NIST are of its archive "NIST-L2-reference-pairs" (240 sets after ASME
B89.4.10-2000, computed with 60 digits; C. M. Shakarji, J. Res. Natl. Inst. Stand. Technol. 103,
633 (1998)); pla3, pla25, sph17, sph20 and sph27 are the smallest of them. Millimetres.
"""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.geometry.plane import fit_plane
from rotcal_ros.geometry.sphere import fit_spheres

PLANES = {
    "pla3": (
        [
            [116.28589, 246.88068, 379.92353], [116.28594, 246.05807, 380.64652],
            [116.28602, 245.23542, 381.36952], [116.28603, 246.85165, 379.89046],
            [116.28589, 246.02909, 380.61369], [116.28604, 245.20646, 381.33659],
        ],
        [116.28596833333333333, 246.04356166666666667, 380.63005166666666667],
        [0.99999964494971137778, 0.00057991943628023643881, 0.00061138686492934729436],
    ),
    "pla25": (
        [
            [-0.80755, -1.36199, -0.17755], [-1.01607, -1.98416, 0.06813],
            [-1.22447, -2.60609, 0.31294], [-0.78427, -1.41832, -0.30379],
            [-0.99358, -2.04102, -0.05845], [-1.2008, -2.66386, 0.18796],
        ],
        [-1.0044566666666666667, -2.0125733333333333333, 0.0048733333333333333333],
        [0.94053335499333179607, -0.20929606987242093331, 0.2675671192073981387],
    ),
}  # fmt: skip
"""Name -> points, a point of the plane of least squares, its normal."""
SPHERES = {
    "sph17": (
        [
            [0.01944, -0.48109, -0.32562], [0.42425, 0.4367, -1.01543], [0.12554, 0.6398, 0.15216],
            [0.4708, -0.42821, -0.2201], [0.79329, 0.29515, -0.766], [0.55211, 0.44965, 0.15074],
            [0.84856, 0.05212, -0.20474],
        ],
        [0.19075590244501407165, 0.19829900585603285145, -0.39822410578477485495],
        1.41167711205071703,
    ),
    "sph20": (
        [
            [-3.28214, -4.62268, 8.94832], [9.50848, -3.55822, -4.90606],
            [-4.33536, 9.24629, -3.85555], [1.49357, 0.40526, 10.90308],
            [11.47431, 1.21841, 0.09632], [0.67046, 11.19966, 0.92819],
            [6.88386, 6.57464, 6.30564],
        ],
        [0.58056750546137346649, 0.31124706464948572196, 0.016923947793547932747],
        21.82665848709480931,
    ),
    "sph27": (
        [
            [159.79942, -26.46145, -5.79448], [102.2205, -112.65426, -48.69188],
            [245.97604, -84.02503, -48.69264], [217.36633, 59.73469, -48.69415],
            [73.59328, 31.09117, -48.68726],
        ],
        [159.78778980824916058, -26.457393627511015121, -152.46162213599687549],
        293.33428354040795263,
    ),
}  # fmt: skip
"""Name -> points, centre and diameter of least squares."""
DIGITS = 1e-12


@pytest.mark.parametrize("name", PLANES)
def test_planes_of_nist(name):
    points, place, normal = PLANES[name]
    plane = fit_plane(points, up=normal)
    np.testing.assert_allclose(plane.normal, normal, atol=DIGITS)
    np.testing.assert_allclose(plane.centroid, place, atol=1e3 * DIGITS)
    np.testing.assert_allclose(plane.distances([place]), 0.0, atol=1e3 * DIGITS)


@pytest.mark.parametrize("name", SPHERES)
def test_spheres_of_nist(name):
    points, centre, diameter = SPHERES[name]
    found = fit_spheres(np.array([points]), radius=None, reject=False)
    assert found.reason == (None,)
    np.testing.assert_allclose(found.centres[0], centre, atol=1e3 * DIGITS)
    assert 2.0 * found.radii[0] == pytest.approx(diameter, abs=1e3 * DIGITS)


# The script that takes a folder of such pairs.


@pytest.fixture(scope="module")
def script():
    path = Path(__file__).parents[2] / "research" / "check_public_sets.py"
    spec = importlib.util.spec_from_file_location("check_public_sets", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def write_pair(folder, name, points, numbers):
    lines = [str(len(points)), *("\t".join(map(repr, p)) for p in points)]
    (folder / f"{name}.ds").write_text("\r\n".join(lines) + "\r\n")
    (folder / f"{name}.fit").write_text("\n".join(map(repr, numbers)) + "\n")


def test_script_accepts_the_reference_pairs(script, tmp_path, capsys):
    for name, (points, place, normal) in PLANES.items():
        write_pair(tmp_path, name, points, [*place, *normal])
    for name, (points, centre, diameter) in SPHERES.items():
        write_pair(tmp_path, name, points, [*centre, diameter])
    turn = np.linspace(0.0, 5.0, 9)
    ring = np.column_stack([3 + np.cos(turn), 4 + np.sin(turn), 5 + 0 * turn]).tolist()
    write_pair(tmp_path, "cir1", ring, [3.0, 4.0, 5.0, 0.0, 0.0, -1.0, 2.0])
    write_pair(tmp_path, "con1", ring, [0.0] * 8)
    assert script.main(tmp_path) == 0
    shown = capsys.readouterr().out
    assert "cir 1, con 1, pla 2, sph 3" in shown
    assert shown.count("largest difference") == 2 + 2 + 3


def test_script_finds_a_difference(script, tmp_path, capsys):
    points, centre, diameter = SPHERES["sph20"]
    write_pair(tmp_path, "sph20", points, [*centre, diameter + 1e-5])
    assert script.main(tmp_path) == 1
    assert "sph diameter largest difference 1.00e-05 mm" in capsys.readouterr().out


def test_script_names_what_it_cannot_use(script, tmp_path, capsys):
    assert script.main(tmp_path) == 1
    points, centre, diameter = SPHERES["sph27"]
    write_pair(tmp_path, "sph9", points[:4], [*centre, diameter])
    assert script.main(tmp_path) == 1
    assert "sph9.ds refused: 4 usable touch points" in capsys.readouterr().out
    (tmp_path / "sph9.ds").write_text("7\n1 2 3\n")
    with pytest.raises(ValueError, match="7 points announced"):
        script.main(tmp_path)
