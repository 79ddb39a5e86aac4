"""Limits of every controller met exactly, its steps, its words, and the folder it keeps."""

import os
import socket
import stat
import threading
from dataclasses import replace

import numpy as np
import pytest
from compensation_examples import TAU, even, result_of, wavy

from rotcal_ros.compensation.controller_store import STATE_FOLDER, ControllerFolder
from rotcal_ros.compensation.controllers import controller_names, make_controller
from rotcal_ros.compensation.linuxcnc import load
from rotcal_ros.compensation.table import CompensationTable, table_from_result
from rotcal_ros.compensation.writing import check_file_name, check_stem, write_files
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import BagError, ConfigurationError, ControllerError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC, DEGREE

UP, DOWN = Approach.POSITIVE, Approach.NEGATIVE


def turn(degrees, angles=None):
    """A table whose correction is minus these degrees in both directions."""
    values = -np.deg2rad(np.asarray(degrees, float))
    angles = even(len(values)) if angles is None else angles
    return CompensationTable(
        axis="C", method="m", angles=angles, correction_forward=values,
        correction_reverse=values, std=np.zeros(len(values)), period=TAU, reference_angle=0.0,
        verdict="ok",
    )  # fmt: skip


def arc(n):
    angles = np.deg2rad(np.arange(n) * 0.5)
    return table_from_result(result_of(angles, wavy(angles)))


@pytest.mark.parametrize(
    ("name", "settings", "most", "words"),
    [
        ("linuxcnc", {}, 255, r"linuxcnc: 256 rows x 1 turns \+ 1: 257, and the controller holds "
         r"256: a spacing of at least 1\.41 deg$"),
        ("linuxcnc", {"turns": 3}, 85, r"linuxcnc: 86 rows x 3 turns \+ 1: 259, and the controller"
         r" holds 256: a spacing of at least 4\.24 deg, or at most 2 turns at this spacing$"),
        ("heidenhain", {}, 255, "heidenhain: rows: 257, and the controller holds 256: choose a"),
        ("fagor", {}, 999, "fagor: points: 1001, and the controller holds 1000: choose a wider"),
        ("fagor", {"max_points": 7}, 6, "fagor: points: 8, and the controller holds 7: choose a"),
        ("twincat", {"max_points": 10}, 8, r"twincat: points: 10, and the controller holds 9: a w"
         "ider spacing, or raise P-COMP-00059"),
        ("sinumerik", {"max_points": 9}, 8, "sinumerik: points at 40 deg: 10, and the controller "
         "holds 9: a wider spacing, or set max_points to MD38000 of the machine"),
        ("sinumerik", {"max_points": 9, "tables": "cec"}, 8, "set max_points to MD18342 of the m"),
        ("fanuc", {"slots": 19, "reference_slot": 9}, 9, "fanuc: last slot for 10 intervals from 9"
         ": 19, and the controller holds 18: choose a wider spacing or a lower reference_slot"),
    ],
)  # fmt: skip
def test_the_limit_itself_fits_and_one_more_does_not(name, settings, most, words):
    controller = make_controller(name, settings)
    assert controller.read(controller.write(turn(np.zeros(most)), "t"))
    with pytest.raises(ConfigurationError, match=words):
        controller.write(turn(np.zeros(most + 1)), "t")


def test_an_arc_of_linuxcnc_has_at_most_256_rows_and_one_turn():
    controller = make_controller("linuxcnc")
    assert len(controller.read(controller.write(arc(256), "t")).nominal_deg) == 256
    with pytest.raises(
        ConfigurationError, match=r"^linuxcnc: rows: 257, and the controller holds"
    ):
        controller.write(arc(257), "t")
    for settings in ({"turns": 2}, {"first_turn": 1}, {"first_turn": -1}):
        with pytest.raises(ConfigurationError, match="arc cannot be repeated, set turns 1, first"):
            make_controller("linuxcnc", settings).write(arc(5), "t")


def test_too_many_rows_for_a_single_turn_leave_no_turns_to_advise():
    with pytest.raises(ConfigurationError, match=r"at least 2\.82 deg$"):
        make_controller("linuxcnc", {"turns": 2}).write(turn(np.zeros(300)), "t")


@pytest.mark.parametrize(
    ("name", "title"),
    [("fanuc", "Fanuc"), ("pmac", "PMAC"), ("sinumerik", "SINUMERIK"), ("twincat", "TwinCAT CNC"),
     ("twincat_nc", "TwinCAT NC"), ("kflop", "KFLOP")],
)  # fmt: skip
def test_uneven_rows_are_refused_by_name(name, title):
    angles = even(12)
    angles[5] += 0.01
    with pytest.raises(ConfigurationError, match=f"^{title} needs evenly spaced rows from 0 to"):
        make_controller(name).write(turn(np.zeros(12), angles), "t")


@pytest.mark.parametrize(
    ("name", "title"),
    [("fanuc", "Fanuc"), ("pmac", "PMAC"), ("sinumerik", "SINUMERIK"), ("twincat", "TwinCAT CNC"),
     ("heidenhain", "Heidenhain"), ("fagor", "Fagor 8055"), ("twincat_nc", "TwinCAT NC"),
     ("kflop", "KFLOP"), ("smoothieware", "Smoothieware")],
)  # fmt: skip
def test_an_arc_is_refused_by_name(name, title):
    words = (
        rf"^{title} takes the table of a whole turn and this one covers only 0 \.\. 19\.5 deg: "
    )
    with pytest.raises(ConfigurationError, match=words):
        make_controller(name).write(arc(40), "t")


@pytest.mark.parametrize(
    ("name", "title"), [("fanuc", "Fanuc"), ("pmac", "PMAC"), ("smoothieware", "Smoothieware")]
)
def test_a_machine_zero_that_is_not_zero_is_refused_by_name(name, title):
    with pytest.raises(ConfigurationError, match=f"^{title} counts its corrections from the mach"):
        make_controller(name).write(turn(np.full(12, 0.01)), "t")


@pytest.mark.parametrize("name", controller_names())
def test_titles_and_travel(name):
    """docs/compensation.md: controls that wrap by themselves are proven from -360 to 720 deg."""
    controller = make_controller(name)
    turns = name in ("linuxcnc", "kflop", "smoothieware")
    travel = (0.0, TAU) if turns else (-TAU, 2.0 * TAU)
    assert controller.travel == pytest.approx(travel)
    assert controller.staircase is (name == "fanuc")
    one_column = ("fanuc", "sinumerik", "twincat_nc", "kflop", "smoothieware")
    assert controller.one_direction is (name in one_column)


@pytest.mark.parametrize("name", ["linuxcnc", "kflop", "smoothieware"])
def test_the_travel_is_that_of_the_turns(name):
    controller = make_controller(name, {"first_turn": -2, "turns": 5})
    assert controller.travel == pytest.approx((-2.0 * TAU, 3.0 * TAU))


@pytest.mark.parametrize(
    ("name", "settings", "value_deg", "place_deg"),
    [
        ("csv", {}, 1e-6 / 3600.0, 1e-9),
        ("heidenhain", {}, 2e-5, 1e-5),
        ("fagor", {}, 1e-4, 1e-4),
        ("sinumerik", {}, 1e-7, 1e-7),
        ("twincat", {}, 1e-4, 0.0),
        ("twincat_nc", {}, 1e-9, 1e-6),
        ("kflop", {}, 1e-9, 1e-6),
        ("pmac", {"counts_per_turn": 3600}, 2.0 * 0.1 / 16.0, 0.0),
        ("fanuc", {"magnification": 3, "detection_unit_deg": 0.01}, 0.03, 0.0),
        ("fanuc", {}, 0.002, 0.0),
        ("linuxcnc", {}, None, 1e-9),
    ],
)
def test_steps_of_values_and_positions(name, settings, value_deg, place_deg):
    """The decimals, the sixteenth of a count, or the detection units that the pages name.

    A way back that is a difference is rounded twice. A step of 0.008 deg needs magnification 2.
    """
    controller = make_controller(name, settings)
    table = turn([0.0, 0.008, 0.0, 0.0])
    assert controller.position_resolution / DEGREE == pytest.approx(place_deg)
    if value_deg is not None:
        assert controller.resolution(table) / DEGREE == pytest.approx(value_deg)
        return
    single = 0.008 * np.finfo(np.float32).eps  # trim and slope are held in single precision
    found = controller.resolution(table) / DEGREE
    assert 2e-9 + 2.0 * single < found < 2e-9 + 20.0 * single
    assert controller.resolution(turn(np.zeros(4))) / DEGREE == pytest.approx(2e-9)


# Fanuc.


@pytest.mark.parametrize(
    ("degrees", "magnification"),
    [([0.0, 0.007, 0.0], 1), ([0.0, 0.008, 0.0], 2), ([0.0, -0.014, 0.0], 2),
     ([0.0, 0.745, 0.0], 100), ([0.0, 0.0, 0.0], 1)],
)  # fmt: skip
def test_fanuc_takes_the_smallest_magnification_that_holds_every_step(degrees, magnification):
    files = make_controller("fanuc").write(turn(degrees), "t")
    assert f"N03623A4P{magnification};" in files["t.txt"]


def test_fanuc_steps_that_no_magnification_holds():
    words = (
        r"^fanuc: a step of 0\.8 deg between rows is more than 7 x 100 x 0\.001 deg: choose a n"
    )
    with pytest.raises(ConfigurationError, match=words):
        make_controller("fanuc").write(turn([0.0, 0.3, -0.5, 0.0]), "t")


def test_fanuc_with_a_magnification_of_ones_own():
    fits = make_controller("fanuc", {"magnification": 2}).write(turn([0.0, 0.014, 0.0, 0.0]), "t")
    assert "N10001P-7;\nN10002P7;\nN10003P0;\nN10004P0;" in fits["t.txt"]
    words = "the step to 180 deg is 8 at magnification 2, and a slot holds -7 .. .7: use a "
    with pytest.raises(ConfigurationError, match=f"^fanuc: {words}magnification of at least 3 or"):
        make_controller("fanuc", {"magnification": 2}).write(turn([0.0, 0.0, -0.016, 0.0]), "t")


def test_fanuc_rounds_the_running_sum_with_halves_away_from_zero():
    """Corrections of -0.0015, 0.0015, 0.0005 and -0.0004 deg are -2, 2, 1 and 0 units."""
    table = turn([0.0, 0.0015, -0.0015, -0.0005, 0.0004])
    text = make_controller("fanuc").write(table, "t")["t.txt"]
    slots = [line.split("P")[1] for line in text.splitlines() if line.startswith("N10")]
    assert slots == ["0;", "-2;", "4;", "-1;", "-1;", "0;"]


def test_fanuc_in_two_directions_by_hand():
    """Up -e is 0, -5, 3, -1 and down 2, -3, 5, 1 thousandths; in steps of two, halves away."""
    up, down = [0.0, 0.005, -0.003, 0.001], [-0.002, 0.003, -0.005, -0.001]
    settings = {"directions": "each", "reference_slot": 60}
    both = replace(turn(up), correction_reverse=turn(down).correction_forward)
    files = make_controller("fanuc", settings).write(both, "t")
    assert files["t.txt"].splitlines()[1:-1] == [
        "N03620A4P60;", "N03621A4P60;", "N03622A4P64;", "N03623A4P2;", "N03624A4P90.000000;",
        "N03625A4P360.0;", "N03626A4P65;", "N03627A4P2;",
        "N10060P1;", "N10061P-3;", "N10062P5;", "N10063P-3;", "N10064P1;",
        "N10065P0;", "N10066P-3;", "N10067P5;", "N10068P-2;", "N10069P0;",
    ]  # fmt: skip
    rule = make_controller("fanuc", settings).read(files)
    back = rule.correction(np.deg2rad([0.0, 90.0, 180.0, 270.0]), Approach.NEGATIVE)
    np.testing.assert_allclose(np.rad2deg(back), [0.002, -0.004, 0.006, 0.002], atol=1e-12)
    with pytest.raises(ConfigurationError, match="last slot for two times 4 intervals from 119"):
        make_controller("fanuc", {**settings, "reference_slot": 119}).write(both, "t")
    assert any(
        "3605#0 to 1 by hand" in text for text in make_controller("fanuc", settings).unverified
    )


@pytest.mark.parametrize(
    ("line", "words"),
    [("N03627A4P2;", "of the parameters 3626 and 3627 one is missing"),
     ("N10067P5;", "not all slots 65 .. 69 are there")],
)  # fmt: skip
def test_fanuc_reads_no_half_of_a_way_back(line, words):
    settings = {"directions": "each", "reference_slot": 60}
    both = replace(
        turn([0.0, 0.005, -0.003, 0.001]),
        correction_reverse=turn([-0.002, 0.003, -0.005, -0.001]).correction_forward,
    )
    text = make_controller("fanuc", settings).write(both, "t")["t.txt"]
    with pytest.raises(BagError, match=words):
        make_controller("fanuc", settings).read({"t.txt": text.replace(f"{line}\n", "")})


def test_fanuc_has_a_slot_for_its_reference():
    assert make_controller("fanuc", {"slots": 5, "reference_slot": 4}).reference_slot == 4
    with pytest.raises(
        ConfigurationError, match=r"reference_slot 5 is none of the 5 slots 0 \.\. 4"
    ):
        make_controller("fanuc", {"slots": 5, "reference_slot": 5})


# Reading.


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (["BEGIN t.COM", "NR A B C", "[END]"], "expected BEGIN in the first line"),
        (["BEGIN t.COM", "NR A B C", "0 0 0 0", "[END]"], r"t\.COM: 1 rows, expected at least 2"),
        (["BEGIN t.COM", "NR A B C", "0 0 0 0", "1 360 0 0", "[END]"], None),
    ],
)
def test_a_heidenhain_table_has_two_rows_at_least(lines, words):
    files = {"t.COM": "\n".join(lines), "t.CMA": "0 * t\n"}
    controller = make_controller("heidenhain")
    if words is None:
        assert controller.read(files).correction(1.0, UP) == 0.0
        return
    with pytest.raises(BagError, match=words):
        controller.read(files)


def test_linuxcnc_without_rows_corrects_nothing_and_one_row_is_held():
    at = np.array([-1.0, 0.0, 9.0])
    np.testing.assert_array_equal(load("", 1).correction(at, UP), np.zeros(3))
    np.testing.assert_allclose(load("10 0.5 -0.5\n", 1).correction(at, DOWN), -0.5 * DEGREE)


def test_linuxcnc_says_what_it_swallows():
    """As the real program does: an entry too many, and one that does not increase."""
    rows = "".join(f"{k} 0 0\n" for k in range(257))
    assert load(rows, 1).messages == ("too many compensation entries",)
    assert load("0 0 0\n0 0 0\n1 0 0\n", 1).messages == ("compensation values must increase",)
    words = "3 lines, of which LinuxCNC uses 2; expected all; compensation values must increase"
    ini = "[JOINT_0]\n  COMP_FILE_TYPE  =  1 \n"
    with pytest.raises(BagError, match=words):
        make_controller("linuxcnc").read({"a.comp": "0 0 0\n0 0 0\n1 0 0\n", "a.ini": ini})
    assert make_controller("linuxcnc").read({"a.comp": "0 0 0\n1 0 0", "a.ini": ini})
    with pytest.raises(
        BagError, match=r"a\.comp: 2 lines, .* uses 1; expected all; a line is not"
    ):
        make_controller("linuxcnc").read({"a.comp": "0 0 0\nx\n", "a.ini": ini})


def test_a_plain_table_is_closed_only_from_0_to_360():
    head = "angle_deg,correction_forward_arcsec,correction_reverse_arcsec,std_arcsec"
    rows = ["0,1,10,0", "90,3,30,0", "360,1,10,0"]
    for last, expected in (("360,1,10,0", 2.0), ("350,1,10,0", 1.0)):
        rule = make_controller("csv").read({"a.csv": "\n".join([head, *rows[:2], last])})
        found = rule.correction(np.array([405.0]) * DEGREE, UP) / ARCSEC
        np.testing.assert_allclose(found, expected, atol=1e-9)
        back = rule.correction(np.array([45.0]) * DEGREE, DOWN) / ARCSEC
        np.testing.assert_allclose(back, 20.0, atol=1e-9)


# Controllers by name, files and folders.


def test_what_is_no_controller_is_refused(monkeypatch):
    for found in (dict, "text", int):
        monkeypatch.setattr(plugins, "load", lambda *_, found=found: found)
        with pytest.raises(
            ConfigurationError, match=r"the controller 'odd' is .*, no subclass of"
        ):
            make_controller("odd")


def test_settings_are_refused_with_their_place():
    with pytest.raises(ConfigurationError, match=r"^fanuc\.slots: 0 is out of range 1 to 1024"):
        make_controller("fanuc", {"slots": 0})
    with pytest.raises(ConfigurationError, match=r"^bridge\.options\.slots: 0 is out of range"):
        make_controller("fanuc", {"slots": 0}, "bridge.options")


def test_files_are_for_everybody_to_read_and_come_back_in_order(tmp_path):
    paths = write_files({"b.txt": "2\n", "a.txt": "1\n"}, tmp_path / "new" / "folder")
    assert paths == (tmp_path / "new" / "folder" / "b.txt", tmp_path / "new" / "folder" / "a.txt")
    assert [path.read_text() for path in paths] == ["2\n", "1\n"]
    assert [stat.S_IMODE(path.stat().st_mode) for path in paths] == [0o644, 0o644]
    folder = tmp_path / "new" / "folder"
    assert {path.name for path in folder.iterdir()} == {"a.txt", "b.txt"}
    with pytest.raises(BagError, match=r"a\.txt exists already .* nothing was written"):
        write_files({"c.txt": "3\n", "a.txt": "4\n"}, folder)
    assert {path.name for path in folder.iterdir()} == {"a.txt", "b.txt"}


@pytest.mark.parametrize(
    ("check", "length", "extra"), [(check_stem, 64, "-_"), (check_file_name, 100, "-_.")]
)
def test_names_of_files_have_a_length_and_letters(check, length, extra):
    good = f"aZ9{extra}"
    for name in (good, "a" * length, "0"):
        assert check(name) == name
    for name in ("a" * (length + 1), "", "-a", "_a", ".a", "a b", "a/b", "ä", "a\n"):
        with pytest.raises(ConfigurationError, match="file name"):
            check(name)


def test_a_lock_names_its_owner(tmp_path):
    store = ControllerFolder(tmp_path, 10.0)
    store.lock()
    store.lock()  # again is nothing new
    lock = tmp_path / STATE_FOLDER / "lock"
    assert lock.read_text() == f"process {os.getpid()} on {socket.gethostname()}\n"
    assert stat.S_IMODE(lock.stat().st_mode) & 0o700 == 0o600
    other = ControllerFolder(tmp_path, 10.0)
    with pytest.raises(
        ControllerError, match=rf"is fed by process {os.getpid()} on .* already: one"
    ):
        other.lock()
    store.close()
    store.close()
    other.lock()
    other.close()


def test_an_owner_without_a_name_is_another_process(tmp_path):
    store, other = ControllerFolder(tmp_path, 10.0), ControllerFolder(tmp_path, 10.0)
    store.lock()
    lock = tmp_path / STATE_FOLDER / "lock"
    for text, owner in (
        (b"", "another process"),
        (b" \n", "another process"),
        (b"me \xff\n", "me �"),
    ):
        lock.write_bytes(text)
        with pytest.raises(ControllerError, match=f"is fed by {owner} already"):
            other.lock()
    store.close()


def test_foreign_files_are_kept_byte_by_byte(tmp_path):
    """Every byte there is; files that are not there are left out or taken away."""
    (tmp_path / "a.bin").write_bytes(bytes(range(256)))
    store = ControllerFolder(tmp_path, 10.0)
    found = store.read(["a.bin", "b.bin"])
    assert list(found) == ["a.bin"]
    store.write({"b.bin": found["a.bin"], "a.bin": None, "c.bin": None})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["b.bin"]
    assert (tmp_path / "b.bin").read_bytes() == bytes(range(256))
    for call in (lambda: store.read(["../x"]), lambda: store.write({"../x": "1"})):
        with pytest.raises(ConfigurationError, match="leaves the output folder"):
            call()


@pytest.mark.parametrize(
    ("what", "call"),
    [
        ("lock", lambda s: s.lock()),
        ("read", lambda s: s.read([])),
        ("write", lambda s: s.write({})),
    ],
)
def test_a_folder_that_is_gone_or_silent_is_told_with_what_was_wanted(what, call, tmp_path):
    gone = ControllerFolder(tmp_path / "gone", 10.0)
    words = rf"gone does not answer: cannot {what}: No such file or directory$"
    with pytest.raises(ControllerError, match=words):
        call(gone)
    free = threading.Event()

    class Silent(ControllerFolder):
        def _take_lock(self):
            return free.wait() and 0

        def _read(self, names):
            return free.wait() and {}

        def _write(self, files):
            free.wait()

    with pytest.raises(ControllerError, match=rf"does not answer: no {what} within 0\.05 s$"):
        call(Silent(tmp_path, 0.05))
    free.set()
