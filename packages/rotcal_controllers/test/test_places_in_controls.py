"""Where the axes of a machine stand, in the parameters of these controls."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_axis_location import A, C, about, location, measured

from rotcal_ros.foundation.errors import ConfigurationError, DataError


def turned_by_vectors(work, i2, i3, v1, v2, first, second):
    """Where a point (3,) of the work stands by the vectors of a swivel table (type 40), mm.

    Each axis turns right-handed about its vector for a growing angle (deg): from the machine's
    zero by I2 to the first axis, by I3 to the second.
    """
    turn, tilt = (
        Rotation.from_rotvec(np.radians(angle) * v / np.linalg.norm(v))
        for v, angle in ((v2, second), (v1, first))
    )
    return i2 + tilt.apply(i3 + turn.apply(work - i2 - i3))


@pytest.mark.parametrize("senses", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_the_vectors_of_sinumerik_close_and_turn_the_work_as_the_chain_says(senses):
    table_sense, tilt_sense = senses
    files, words = location(measured("A", senses=senses), "sinumerik", accept_unverified=True)
    found = re.findall(r"\$MC_TRAFO5_(\w+)\[(\d)\]=(\S+)", files["c_sinumerik_axis.ini"])
    data = {(name, int(k)): float(x) for name, k, x in found}
    names = ("BASE_TOOL_1", "JOINT_OFFSET_PART_1", "PART_OFFSET_1", "AXIS1_1", "AXIS2_1")
    i2, i3, i4, v1, v2 = (np.array([data[name, k] for k in range(3)]) for name in names)
    assert i2 + i3 + i4 == pytest.approx(0.0, abs=2e-6)
    assert i2 == pytest.approx(1e3 * np.array(A[0]))
    assert i2 + i3 == pytest.approx(1e3 * np.array(C[0]), abs=2e-6)
    upright, lying = np.array([-3e-5, -2e-5, 1.0]), np.array([1.0, -5e-5, -4e-5])
    work = np.array([150.0, 20.0, 80.0])
    for tilt, turn in ((25.0, 40.0), (-90.0, 100.0)):
        stands = about(work, (1e3 * np.array(C[0]), upright), table_sense * turn)
        stands = about(stands, (1e3 * np.array(A[0]), lying), tilt_sense * tilt)
        away = turned_by_vectors(work, i2, i3, v1, v2, tilt, turn) - stands
        assert np.abs(away).max() < 4e-6
    assert ["clockwise" in word for word in words[:2]] == [sense < 0 for sense in senses]


def test_a_table_that_turns_clockwise_by_iso_841_has_its_vector_reversed():
    files, _ = location(measured(senses=(-1,)), "sinumerik", accept_unverified=True)
    assert "$MC_TRAFO5_AXIS2_1[2]=-1." in files["c_sinumerik_axis.ini"]
    with pytest.raises(DataError, match="does not say which way C turns"):
        location(measured(senses=(0,)), "sinumerik", accept_unverified=True)


def test_the_rows_of_heidenhain_lead_from_axis_to_axis():
    files, _ = location(measured("A"), "heidenhain", accept_unverified=True)
    at, seen = np.zeros(3), {}
    for line in files["c_heidenhain_axis.txt"].splitlines():
        if line.startswith("Trans"):
            _, axis, value = line.split()
            at["XYZ".index(axis)] += float(value)
        if line.startswith("MachAxis"):
            seen[line.split()[1]] = at.copy()
    assert list(seen) == ["A", "C"]
    assert seen["A"] == pytest.approx(1e3 * np.array(A[0]), abs=1e-4)
    assert seen["C"] == pytest.approx(1e3 * np.array(C[0]), abs=1e-4)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("fanuc", "no parameters are known for the place"),
        ("sinumerik", "not verified: .*--accept-unverified"),
    ],
)
def test_a_place_that_is_not_known_or_not_verified_is_refused(name, words):
    with pytest.raises(ConfigurationError, match=words):
        location(measured(), name)
