"""Tables and bags of lengths and readings of a table that turned, from three places."""

from dataclasses import replace

import numpy as np
import pytest
from other_messages import write_messages
from six_turning_scene import ARCSEC, DEGREE, NAMES, six_turning_scene

import rotcal_ros as rc
from rotcal_ros.foundation.errors import DataError, PlanError
from rotcal_ros.recordings.inputs import MeasurementInput

COMPONENTS = dict(zip(NAMES, 3 * [1e-6] + 3 * [ARCSEC], strict=True))


@pytest.fixture(scope="module")
def scene():
    return six_turning_scene(7, angles=12, speed_deg_s=60.0, window_deg=1.01)


def written(scene, folder, lines, plan="", noise=8e-8):
    """Write a table and its set-up; return what is read of it."""
    setup = folder / "setup.yaml"
    places = ", ".join(map(repr, scene.places.ravel().tolist()))
    setup.write_text(
        f"method: tracer_six\nplan: {{places_m: [{places}]{plan}}}\n"
        f"solver: {{length_std_m: {noise}, target_std_m: 1.0e-6}}\n"
    )
    rows = [f"{k},{x!r},{y!r},{z!r}" for k, (x, y, z) in enumerate(scene.nominal.tolist())]
    (folder / "targets.csv").write_text("\n".join(["target,x_m,y_m,z_m", *rows]) + "\n")
    table = folder / "turns.csv"
    table.write_text("\n".join(lines) + "\n")
    return rc.read_table(table, rc.read_configuration(setup))


def lengths(scene):
    """Lines of the table of lengths; the second place and first target of each turn's time."""
    found = ["place,angle_deg,target,direction,length_m,time_s"]
    for k in range(len(scene.length)):
        sense = int(np.sign(scene.speed[k]))
        angle = scene.angles[scene.angle[k]] / DEGREE
        time = 100.0 * scene.turn[k] + sense * angle / 60.0 + (0.0 if sense > 0 else 6.0)
        found.append(
            f"{scene.place[k]},{angle:.9g},{scene.target[k]},{sense},{scene.length[k]:.12f},{time:.6f}"
        )
    return found


def readings(scene, keep=slice(None)):
    """Lines of the table of readings, the targets of each place in their order."""
    found = ["time_s,angle_deg,length_m,place"]
    for number, rows in list(enumerate(scene.readings))[keep]:
        cells = [f"{t!r},{a % 360.0!r},{x!r},{number // 8}" for t, a, x in rows.tolist()]
        found += cells
    return found


def within(scene, result, factor=4.5):
    """Hold all curves, less what defines the axis, against the truth."""
    n = len(scene.angles)
    design = np.zeros((2 * n, 4))
    design[::2, 0] = design[1::2, 1] = 1.0
    design[::2, 2], design[1::2, 2] = np.cos(scene.angles), np.sin(scene.angles)
    design[::2, 3], design[1::2, 3] = -np.sin(scene.angles), np.cos(scene.angles)
    true = scene.true.mean(axis=1)
    for first in (0, 3):
        pair = true[first : first + 2].T.ravel()
        pair = pair - design @ np.linalg.lstsq(design, pair, rcond=None)[0]
        true[first : first + 2] = pair.reshape(-1, 2).T
    for k, name in enumerate(NAMES):
        wanted = true[k] - (true[k].mean() if name in ("EZC", "ECC") else 0.0)
        error = (result.deviations[name] - wanted) / result.std[name]
        assert np.abs(error).max() < factor, name


def test_six_deviations_and_both_directions_come_of_a_table_of_lengths(scene, tmp_path):
    measured = written(scene, tmp_path, lengths(scene))
    assert measured.configuration.plan.turning_deg_s == pytest.approx((60.0, -60.0), rel=1e-3)
    result = measured.solve()
    assert result.verdict == "ok", result.warnings
    assert result.angles == pytest.approx(scene.angles, abs=1e-9)
    within(scene, result)
    assert result.details["turning"]["lag"] == pytest.approx(1e-3, abs=5e-6)
    assert any("mean reversal is zero by definition" in str(w) for w in result.warnings)
    for k, name in enumerate(NAMES):
        both = result.directions[name]
        reversal = both.forward - both.reverse
        true = scene.true[k, 0] - scene.true[k, 1]
        size = COMPONENTS[name]
        assert (reversal - reversal.mean()) == pytest.approx(true - true.mean(), abs=0.6 * size)


def test_readings_become_the_lengths_of_a_cubic_and_broken_beams_begin_a_zero(scene, tmp_path):
    angles = ", table_positions: 12, table_step_deg: 30, passing_deg: 1.01"
    lines = readings(scene)
    first = 1 + sum(map(len, scene.readings[:9]))  # a turn back at the second place
    gone = first + int(np.argmin(np.abs(scene.readings[9][:, 1] - 315.0)))  # between two angles
    time, angle, _, place = lines[gone].split(",")
    lines[gone] = f"{time},{angle},,{place}"
    measured = written(scene, tmp_path, lines, angles)
    assert all(o.accepted for o in measured.observations)
    keys = zip(scene.place, scene.run, scene.angle, scene.target, strict=True)
    true = dict(zip(map(tuple, np.array(list(keys)).tolist()), scene.length, strict=True))
    assert len(measured.observations) == len(true)
    for o in measured.observations:
        run, angle = divmod(o.table_position, 12)
        assert o.mean[0] == pytest.approx(true[o.station, run, angle, o.target], abs=1e-9)
    assert len({(o.station, o.segment) for o in measured.observations}) == 24 + 1
    result = measured.solve()
    assert result.verdict == "ok", result.warnings
    within(scene, result)


def test_what_no_plan_has_is_refused(scene, tmp_path):
    lines = lengths(scene)
    with pytest.raises(DataError, match="row 2: place 3, target 0 is not one of the 4 targets at"):
        written(scene, tmp_path, [lines[0], "3" + lines[1][1:], *lines[2:]])
    angles = ", table_positions: 12, table_step_deg: 30, passing_deg: 1.01"
    with pytest.raises(DataError, match="found 7 turns at place 2, expected one at each of 2"):
        written(scene, tmp_path, readings(scene, slice(0, 23)), angles)
    with pytest.raises(PlanError, match="leave out bidirectional and arrivals"):
        written(scene, tmp_path, lines, ", bidirectional: true")
    few = [line for line in lines if line.split(",")[2] in ("target", "0", "1", "2")]
    with pytest.raises(PlanError, match="3 targets: every turn counts from a zero of its own"):
        written(replace(scene, nominal=scene.nominal[:3]), tmp_path, few)


def bag_of(scene, folder, rows):
    """Write lengths and angles of ``rows`` (k, 3) in JSON, without orders; return bag and set-up.

    The feedback of the table comes as often, and wraps.
    """
    start, messages = 1_700_000_000_000_000_000, []
    for k in range(100):  # the speed of feedback without one is known after a tenth of a second
        at_rest = {"axis": {"degrees": rows[0, 1] % 360.0}}
        messages.append(("/drive", at_rest, start - 2_000_000 * (100 - k)))
    for time, angle, length in rows.tolist():
        at = start + round(time * 1e9)
        messages.append(("/laser", {"metres": length}, at))
        messages.append(("/drive", {"axis": {"degrees": angle % 360.0}}, at))
    write_messages(folder / "turns.mcap", "json", messages)
    setup = folder / "bag.yaml"
    setup.write_text(
        "method: tracer_six\ntopics: {tracer_length: /laser, length_field: metres, "
        "length_clock: sent, joint_states: /drive, angle_field: axis.degrees, angle_unit: deg, "
        f"table_clock: sent}}\nplan: {{places_m: {scene.places.ravel().tolist()}, "
        f"targets_m: {scene.nominal.ravel().tolist()}, table_positions: 12, "
        "table_step_deg: 30, passing_deg: 1.01}\nsolver: {length_std_m: 8.0e-8}\n"
    )
    return folder / "turns.mcap", setup


@pytest.mark.slow
def test_a_bag_without_orders_has_one_place_after_the_other(tmp_path):
    scene = six_turning_scene(8, angles=12, speed_deg_s=120.0, window_deg=1.01)
    bag, setup = bag_of(scene, tmp_path, np.concatenate(scene.readings))
    measured = MeasurementInput(bag, setup).read()
    assert not [o.reason for o in measured.observations if not o.accepted]
    assert [o.station for o in measured.observations] == [k // 96 for k in range(288)]
    result = measured.solve()
    assert result.verdict == "ok", result.warnings
    within(scene, result)


def test_a_bag_that_lacks_a_turn_is_asked_about(tmp_path):
    scene = six_turning_scene(9, angles=3, speed_deg_s=240.0, window_deg=2.01)
    bag, setup = bag_of(scene, tmp_path, np.concatenate(scene.readings[:-1])[::2])
    with pytest.raises(DataError, match="found 23 turns, expected 8 at each of 3 places"):
        MeasurementInput(bag, setup).read()
