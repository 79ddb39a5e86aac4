"""What the readings of two circles cannot show is named; what they can show is found."""

from pathlib import Path

import numpy as np
import pytest
from circle_world import FOUR, NOISE, THREE, TURN, TWO, CircleWorld, solved, stated
from click.testing import CliRunner
from coded import coded

from rotcal_ros import read_result
from rotcal_ros.adjust.engine import adjust
from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.angle_comparison.method import COUNT
from rotcal_ros.methods.angle_comparison.model import model_of, readings_of
from rotcal_ros.methods.dry_run import prospects


def shifted(world, shifts):
    return world.read((shifts[0], shifts[1] + 30.0, *shifts[2:]))


def reversed_(world, shifts):
    return world.read([-s for s in shifts])


def exchanged(world, shifts):
    return world.read(shifts)[[1, 0, *range(2, len(shifts))]]


def rows_exchanged(world, shifts):
    readings = world.read(shifts)
    readings[:, [3, 4]] = readings[:, [4, 3]]
    return readings


def one_off(world, shifts):
    readings = world.read(shifts)
    readings[1, 4] += 2.0
    return readings


def leaning(world, shifts, own=0.0):
    """A polygon that leans by ten minutes of arc: a^2 / 4, twice in a turn."""
    size = (600.0 * ARCSEC) ** 2 / 4.0 / ARCSEC
    way = 0.4 + own * np.arange(len(shifts))[:, None]
    return world.read(shifts) + size * np.sin(2.0 * np.radians(TURN) + way)


def leaning_by_setting(world, shifts):
    return leaning(world, shifts, own=2.0)


def slipping(world, shifts):
    return world.read(shifts) + 0.25 * np.cos(np.radians(TURN))


@pytest.mark.parametrize(
    ("spoil", "shifts", "named"),
    [
        (shifted, TWO, "numbering"),
        (reversed_, TWO, "numbering"),
        (exchanged, TWO, "numbering"),
        (rows_exchanged, TWO, "numbering"),
        (one_off, TWO, "single readings"),
        (leaning, TWO, "polygon tilt"),
        (leaning, THREE, "polygon tilt"),
        (leaning_by_setting, TWO, "polygon tilt"),
        (slipping, THREE, "slip"),
    ],
)
def test_what_no_reading_shows_is_named(spoil, shifts, named):
    world = CircleWorld(1)
    result = solved(stated(shifts), spoil(world, shifts))
    assert world.error(result).max() > 3.0
    assert result.verdict == "ok"
    assert named in result.unprotected
    assert named in result.verdict_line


@pytest.mark.parametrize("shifts", [THREE, FOUR])
@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (shifted, "all readings fit if setting 1 stood at 60 deg, not at 30"),
        (reversed_, "all readings fit if the shifts count the other way round"),
        (exchanged, "all readings fit if settings 0 and 1 are exchanged"),
        (leaning_by_setting, ""),
    ],
)
def test_what_a_third_setting_shows_is_found(spoil, words, shifts):
    result = solved(stated(shifts), spoil(CircleWorld(1), shifts))
    assert result.verdict != "ok"
    assert any(warning.startswith(words) for warning in result.warnings)


def test_a_lean_that_differs_between_settings_is_told_and_its_common_part_named():
    result = solved(stated(THREE), leaning_by_setting(CircleWorld(3), THREE))
    assert "it looks as if the reference leans, by up to" in "".join(result.warnings)
    assert "polygon tilt" in result.unprotected


@pytest.mark.parametrize("shifts", [THREE, FOUR])
def test_sound_readings_with_redundancy_are_not_burdened(shifts):
    for seed in range(3):
        world = CircleWorld(seed)
        named = set(solved(stated(shifts), world.read(shifts)).unprotected)
        assert named.isdisjoint({"numbering", "single readings", "gauge", "axis noise"})


def test_two_settings_of_true_circles_need_no_numbers():
    """Nothing that is exchanged gives another result where there is nothing to exchange."""
    world = CircleWorld(2, size=0.0)
    assert "numbering" not in solved(stated(TWO), world.read(TWO, noise=0.0)).unprotected


def one_face(errors):
    errors[4] += 2.0
    return errors


def backwards(errors):
    return np.append(errors[:1], errors[:0:-1])


@pytest.mark.parametrize("spoil", [one_face, np.negative, backwards])
@pytest.mark.parametrize("shifts", [(0,), TWO, THREE])
def test_a_wrong_certificate_is_seen_by_further_shifts_alone(spoil, shifts):
    world = CircleWorld(1)
    result = solved(stated(shifts, spoil(world.certificate)), world.read(shifts))
    if len(shifts) > 1:
        assert result.verdict != "ok"
    else:
        assert world.error(result).max() > 10.0
        assert "gauge" in result.unprotected
        assert "numbering" in result.unprotected


def test_a_certificate_that_shifts_check_shows_the_sign_of_the_readings():
    world = CircleWorld(1)
    certificate = world.certificate + NOISE * world.rng.standard_normal(12)
    right = solved(stated(TWO, certificate), world.read(TWO))
    assert right.verdict == "ok"
    assert {"gauge", "numbering", "sign of readings"}.isdisjoint(right.unprotected)
    wrong = solved(stated(THREE, world.certificate), -world.read(THREE))
    assert coded(*wrong.warnings)[COUNT] == [("against the table",)]


def test_a_plan_says_beforehand_what_it_cannot_show_and_what_one_more_setting_brings():
    bare, more = prospects(stated(TWO))
    assert {"numbering", "single readings", "axis noise", "polygon tilt"} <= set(bare.untested)
    assert {"numbering", "single readings", "axis noise"}.isdisjoint(more.untested)
    assert "one more setting, plan.shifts_deg [0, 30, 120]" in more.describe(bare)
    std = 0.5 * np.array([0.240, 0.097]) * ARCSEC  # of K / (K^2 - |S|^2), as the page prints it
    assert [bare.std["ECC"], more.std["ECC"]] == pytest.approx(std, rel=0.01)
    certified, shown = prospects(stated((0,), CircleWorld(1).certificate))
    assert {"gauge", "numbering", "sign of readings"} <= set(certified.untested)
    assert {"gauge", "numbering", "sign of readings"}.isdisjoint(shown.untested)


SIX = [
    (12, TWO), (12, THREE), (12, (0, 60, 90)), (24, (0, 15, 60)), (36, (0, 10, 50, 130)),
    (8, (0, 45, 135)),
]  # fmt: skip


@pytest.mark.parametrize(("n", "shifts"), SIX)
@pytest.mark.parametrize("closing", [0, 1])
def test_covariances_are_those_of_the_pseudo_inverse_about_the_same_zero(n, shifts, closing):
    """Of what readings determine. The pseudo-inverse counts the table from a zero of its own.

    That is the one in which all unknowns together are shortest: deviations of the table about any
    zero of their own have other covariances, though every difference of two has the same.
    """
    angles = 360.0 / n * np.arange(n + closing)
    place = np.arange(n + closing) % n
    rows = []
    for k, shift in enumerate(shifts):
        for i in place:
            row = np.zeros(2 * n + len(shifts))
            row[[i, n + (i - round(shift * n / 360.0)) % n, 2 * n + k]] = 1.0, -1.0, 1.0
            rows.append(row)
    design = np.array(rows)
    size, ways = np.linalg.eigh(design.T @ design)
    assert (size > 1e-9 * size[-1]).sum() == len(size) - 2  # a zero of the table, and of the faces
    inverse = (ways[:, 2:] / size[2:]) @ ways[:, 2:].T
    from_first = np.eye(n)[place] - np.eye(n)[0]
    configuration = stated(shifts).configuration
    plan = type(configuration.plan)(table_angles_deg=tuple(angles), shifts_deg=shifts)
    model = model_of(plan, configuration.solver, readings_of(plan))
    found = adjust(model).covariance / (NOISE * ARCSEC) ** 2
    expected = from_first @ inverse[:n, :n] @ from_first.T
    assert found == pytest.approx(expected, rel=0, abs=1e-12 * expected.max())
    assert np.abs(found[:n, :n] - inverse[:n, :n]).max() > 0.1 * expected.max()


def test_settings_beside_each_other_in_a_table_are_solved_to_their_truth(tmp_path):
    """Readings in arcsec as people keep them, with the values that were drawn for them."""
    folder = Path(__file__).parent / "settings_of_a_polygon"
    out = tmp_path / "result.json"
    words = ["solve", str(folder / "readings.csv"), "--setup", str(folder / "setup.yaml")]
    run = CliRunner().invoke(rotcal, [*words, "-o", str(out)])
    assert run.exit_code == 0, run.output
    result = read_result(out)
    _, true, _ = np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1).T
    off = np.abs(result.deviations["ECC"][:12] / ARCSEC - true)
    assert (off <= 2.0 * result.std["ECC"][:12] / ARCSEC + 1e-9).all()
    assert {"numbering", "single readings"}.isdisjoint(result.unprotected)
