"""Limits of a controller met exactly, its steps, its words, and the folder it keeps."""

import os
import socket
import stat
import threading

import numpy as np
import pytest
from compensation_examples import TAU, arc, turn

from rotcal_ros.compensation.controller_store import STATE_FOLDER, ControllerFolder
from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.compensation.linuxcnc import load_as_linuxcnc
from rotcal_ros.compensation.writing import check_file_name, check_stem, write_files
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import BagError, ConfigurationError, ControllerError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC, DEGREE

UP, DOWN = Approach.POSITIVE, Approach.NEGATIVE


def assert_fits_exactly(controller, most, words):
    """As many rows as ``most`` are written, and one more is refused in ``words``."""
    assert controller.read(controller.write(turn(np.zeros(most)), "t"))
    with pytest.raises(ConfigurationError, match=words):
        controller.write(turn(np.zeros(most + 1)), "t")


@pytest.mark.parametrize(
    ("settings", "most", "words"),
    [
        ({}, 255, r"linuxcnc: 256 rows x 1 turns \+ 1: 257, and the controller holds "
         r"256: choose a spacing of at least 1\.41 deg$"),
        ({"turns": 3}, 85, r"linuxcnc: 86 rows x 3 turns \+ 1: 259, and the controller holds"
         r" 256: choose a spacing of at least 4\.24 deg, or at most 2 turns at this spacing$"),
    ],
)  # fmt: skip
def test_the_limit_itself_fits_and_one_more_does_not(settings, most, words):
    assert_fits_exactly(make_controller("linuxcnc", settings), most, words)


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


@pytest.mark.parametrize("name", ["csv", "linuxcnc"])
def test_travel_and_columns(name):
    controller = make_controller(name)
    travel = (0.0, TAU) if name == "linuxcnc" else (-TAU, 2.0 * TAU)
    assert controller.travel == pytest.approx(travel)
    assert not controller.staircase
    assert not controller.one_direction


def test_the_travel_is_that_of_the_turns():
    controller = make_controller("linuxcnc", {"first_turn": -2, "turns": 5})
    assert controller.travel == pytest.approx((-2.0 * TAU, 3.0 * TAU))


def test_steps_of_values_and_positions_of_a_plain_table():
    controller = make_controller("csv")
    assert controller.position_resolution / DEGREE == pytest.approx(1e-9)
    assert controller.resolution(turn([0.0, 0.008])) / DEGREE == pytest.approx(1e-6 / 3600.0)


def test_steps_of_values_and_positions_of_linuxcnc():
    controller, table = make_controller("linuxcnc"), turn([0.0, 0.008, 0.0, 0.0])
    assert controller.position_resolution / DEGREE == pytest.approx(1e-9)
    single = 0.008 * np.finfo(np.float32).eps  # trim and slope are held in single precision
    found = controller.resolution(table) / DEGREE
    assert 2e-9 + 2.0 * single < found < 2e-9 + 20.0 * single
    assert controller.resolution(turn(np.zeros(4))) / DEGREE == pytest.approx(2e-9)


# Reading.


def test_linuxcnc_without_rows_corrects_nothing_and_one_row_is_held():
    at = np.array([-1.0, 0.0, 9.0])
    np.testing.assert_array_equal(load_as_linuxcnc("", 1).correction(at, UP), np.zeros(3))
    np.testing.assert_allclose(
        load_as_linuxcnc("10 0.5 -0.5\n", 1).correction(at, DOWN), -0.5 * DEGREE
    )


def test_linuxcnc_says_what_it_swallows():
    """As the real program does: an entry too many, and one that does not increase."""
    rows = "".join(f"{k} 0 0\n" for k in range(257))
    assert load_as_linuxcnc(rows, 1).messages == ("too many compensation entries",)
    assert load_as_linuxcnc("0 0 0\n0 0 0\n1 0 0\n", 1).messages == (
        "compensation values must increase",
    )
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
            ConfigurationError, match=r"the controller 'odd' is .*, which is not a subclass of"
        ):
            make_controller("odd")


def test_settings_are_refused_with_their_place():
    with pytest.raises(ConfigurationError, match=r"^linuxcnc\.turns: 0 is out of range 1 to inf"):
        make_controller("linuxcnc", {"turns": 0})
    with pytest.raises(ConfigurationError, match=r"^bridge\.options\.turns: 0 is out of range"):
        make_controller("linuxcnc", {"turns": 0}, "bridge.options")


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
        ControllerError, match=rf"is already fed by process {os.getpid()} on .*: one"
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
        with pytest.raises(ControllerError, match=f"is already fed by {owner}"):
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
    words = rf"gone does not answer: cannot {what}: No such file or directory; check the path$"
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

    with pytest.raises(
        ControllerError,
        match=rf"does not answer: no {what} within 0\.05 s; make sure that it runs",
    ):
        call(Silent(tmp_path, 0.05))
    free.set()
