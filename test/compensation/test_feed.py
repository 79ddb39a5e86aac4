"""Feeding a controller: confirmation, limits, the old table kept, read back, put back."""

import os
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from compensation_examples import even, result_of, wavy

from rotcal_ros.compensation.bridge_settings import BridgeSettings
from rotcal_ros.compensation.controller_store import STATE_FOLDER, ControllerFolder
from rotcal_ros.compensation.feed import Feed
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.foundation.errors import ConfigurationError, ControllerError, DataError
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.configuration import changed, read_configuration

CONFIGURATION = Path(__file__).parents[2] / "config" / "tracer_paper.yaml"
SECOND = 1_000_000_000
BEFORE_NS = (1_700_000_000 - 3600) * SECOND
COMP = "c_linuxcnc.comp"


def table_of(scale=1.0, verdict="ok", axis="C", measured_on="none"):
    deviation = scale * (wavy(even(24)) - wavy(0.0))
    result = result_of(even(24), deviation, verdict=verdict)
    return made_before(table_from_result(replace(result, measured_on=measured_on), axis=axis))


def made_before(table):
    """The table of a measurement before all that the feeds do: no journal knows what was then."""
    return replace(table, measured_from_ns=BEFORE_NS - SECOND, measured_until_ns=BEFORE_NS)


class Clock:
    def __init__(self):
        self.ns = 1_700_000_000 * SECOND

    def __call__(self):
        self.ns += SECOND
        return self.ns


class Cell:
    """A controller's folder and feeds for it."""

    def __init__(self, root):
        self.folder = root / "controller"
        self.folder.mkdir()
        self.output = root / "output"
        self.clock = Clock()
        self.settings = BridgeSettings(
            controller="linuxcnc",
            spacing_deg=15.0,
            controller_folder=str(self.folder),
            output_folder=str(self.output),
            answer_timeout_s=20.0,
        )

    def feed(self, store=None, **changes):
        return Feed(replace(self.settings, **changes), "C", self.clock, store)

    def files(self):
        return {p.name: p.read_bytes() for p in self.folder.iterdir() if p.is_file()}


@pytest.fixture
def cell(tmp_path):
    return Cell(tmp_path)


def applied(feed, table):
    feed.take(table, feed._now_ns())
    return feed.apply(feed.offer.confirmation)


def undone(feed, **limit):
    """Undo the last change."""
    return feed.restore(feed.next_restore(), **limit)


def trims(cell):
    return np.loadtxt(cell.folder / COMP)[:, 1]


def test_a_table_is_written_for_people_but_not_applied_by_itself(cell):
    paths = cell.feed().take(table_of(), 1)
    assert {p.name for p in paths} == {COMP, "c_linuxcnc.ini", "c_linuxcnc.provenance.json"}
    assert all(p.parent.parent == cell.output for p in paths)
    assert cell.files() == {}


def test_the_same_table_again_writes_nothing_new(cell):
    feed = cell.feed()
    assert feed.take(table_of(), 1) == feed.take(table_of(), 2)


def test_applying_replaces_the_table_keeps_the_old_and_tells_the_change(cell):
    feed = cell.feed()
    first = applied(feed, table_of())
    largest = np.max(np.abs(wavy(even(24)) - wavy(0.0)))
    assert first.largest_change == pytest.approx(largest, rel=1e-6)
    old = cell.files()
    second = applied(feed, table_of(1.5))
    assert second.largest_change == pytest.approx(0.5 * largest, rel=1e-6)
    np.testing.assert_allclose(
        trims(cell)[:-1], -1.5 * np.rad2deg(wavy(even(24)) - wavy(0.0)), atol=2e-9
    )
    assert second.backup.is_dir()
    undone(feed)
    assert cell.files() == old
    undone(feed)
    assert cell.files() == {}
    with pytest.raises(DataError, match="no table was applied"):
        undone(feed)


@pytest.mark.parametrize("confirmation", ["", "0" * 64])
def test_the_hash_is_the_confirmation(cell, confirmation):
    feed = cell.feed()
    feed.take(table_of(), 1)
    with pytest.raises(DataError, match="confirm this hash"):
        feed.apply(confirmation)
    assert cell.files() == {}


def test_a_simulated_table_is_for_a_simulated_cell_or_the_word_of_its_user(cell):
    simulated = replace(table_of(), simulated=True)
    feed = cell.feed()
    with pytest.raises(DataError, match="SIMULATED, no instrument measured it"):
        applied(feed, simulated)
    assert cell.files() == {}
    feed.close()
    feed = Feed(cell.settings, "C", cell.clock, simulated=True)
    assert applied(feed, simulated).files
    feed.close()
    assert applied(cell.feed(accept_simulated=True), simulated).files


def test_without_a_table_nothing_is_applied(cell):
    with pytest.raises(DataError, match="no table has arrived"):
        cell.feed().apply("")


@pytest.mark.parametrize("verdict", ["suspect", "failed"])
def test_a_bad_verdict_is_refused_and_the_table_before_it_forgotten(cell, verdict):
    feed = cell.feed()
    feed.take(table_of(), 1)
    confirmation = feed.offer.confirmation
    with pytest.raises(DataError, match=verdict):
        feed.take(table_of(verdict=verdict), 2)
    with pytest.raises(DataError, match="no table has arrived"):
        feed.apply(confirmation)


def test_a_table_of_another_axis_is_refused(cell):
    with pytest.raises(
        DataError, match=r"axis B was measured and this cell has axis C.*accept axis"
    ):
        cell.feed().take(table_of(axis="B"), 1)
    assert not cell.output.exists()


def test_a_spacing_that_the_controller_cannot_hold_is_refused(cell):
    with pytest.raises(ConfigurationError, match="256"):
        cell.feed(spacing_deg=1.0).take(table_of(), 1)
    assert not cell.output.exists()


def test_a_change_above_the_limit_is_refused_and_nothing_is_changed(cell):
    feed = cell.feed(max_change_arcsec=5.0)
    with pytest.raises(DataError, match=r"by up to 1\d\.\d* arcsec, max_change_arcsec is 5"):
        applied(feed, table_of())
    assert cell.files() == {}
    assert applied(feed, table_of(0.2)).largest_change < 5.0 * ARCSEC


def test_the_limit_holds_for_the_change_not_for_the_table(cell):
    first = cell.feed()
    applied(first, table_of())
    first.close()
    feed = cell.feed(max_change_arcsec=2.0)
    assert applied(feed, table_of(1.1)).largest_change < 2.0 * ARCSEC
    with pytest.raises(DataError, match="max_change_arcsec is 2"):
        applied(feed, table_of(1.3))


def test_without_a_controller_nothing_is_applied(cell):
    with pytest.raises(DataError, match="no controller is configured"):
        applied(cell.feed(controller_folder=""), table_of())


def test_a_table_from_before_the_last_restore_is_stale(cell):
    feed = cell.feed()
    table = table_of()
    stamp = feed._now_ns()
    feed.take(table, stamp)
    feed.apply(feed.offer.confirmation)
    undone(feed)
    with pytest.raises(DataError, match="stale"):
        feed.apply(feed.offer.confirmation)
    assert cell.files() == {}
    feed.close()
    again = cell.feed()  # also for a bridge that was started later
    again.take(table, stamp)
    with pytest.raises(DataError, match="stale"):
        again.apply(again.offer.confirmation)
    assert applied(again, table).files


def test_two_bridges_on_one_controller(cell):
    first, second = cell.feed(), cell.feed()
    applied(first, table_of())
    held = cell.files()
    with pytest.raises(ControllerError, match=f"fed by process {os.getpid()}"):
        applied(second, table_of(1.5))
    assert cell.files() == held
    first.close()
    applied(second, table_of(1.5))


def test_the_lock_ends_with_its_process(cell):
    script = (
        "from pathlib import Path; import sys\n"
        "from rotcal_ros.compensation.controller_store import ControllerFolder\n"
        "ControllerFolder(Path(sys.argv[1]), 20.0).lock(); print('locked', flush=True)\n"
        "sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script, str(cell.folder)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as other:
        assert other.stdout.readline() == b"locked\n"
        with pytest.raises(ControllerError, match=f"fed by process {other.pid}"):
            applied(cell.feed(), table_of())
        other.kill()
    applied(cell.feed(), table_of())


def test_a_controller_that_is_not_there(cell):
    feed = cell.feed(controller_folder=str(cell.folder / "gone"))
    with pytest.raises(ControllerError, match="does not answer: cannot lock: No such file"):
        applied(feed, table_of())


def test_options_that_the_controller_does_not_have_are_refused_at_the_start():
    """In the configuration, not when the table arrives."""
    configuration = read_configuration(CONFIGURATION)
    good = ["bridge.controller=linuxcnc", "bridge.options=['turns=3']"]
    assert changed(configuration, good).bridge.controller_settings == {"turns": 3}
    for option, error in [
        ("turn=3", "options: unknown setting 'turn'; did you mean 'turns'"),
        ("turns=0", r"options.turns: 0 is out of range 1 to inf"),
        ("turns=many", r"options.turns: expected int"),
        ("turns", "expected NAME=VALUE"),
    ]:
        with pytest.raises(ConfigurationError, match=error):
            changed(configuration, [good[0], f"bridge.options=[{option!r}]"])
    with pytest.raises(ConfigurationError, match="'linuxcmc'"):
        changed(configuration, ["bridge.controller=linuxcmc"])
    with pytest.raises(ConfigurationError, match="'linuxcmc'; did you mean 'linuxcnc'"):
        BridgeSettings(controller="linuxcmc")


class Broken(ControllerFolder):
    """A controller that swallows writes, damages them, or never answers."""

    def __init__(self, folder, timeout_s, *, damage=0, hang=False):
        super().__init__(folder, timeout_s)
        self.damage, self.hang = damage, threading.Event()
        if not hang:
            self.hang.set()

    def _read(self, names):
        self.hang.wait()
        return super()._read(names)

    def _write(self, files):
        if self.damage:
            self.damage -= 1
            files = {n: None if t is None else t.replace("1", "2") for n, t in files.items()}
        super()._write(files)


def test_a_controller_that_does_not_answer(cell):
    store = Broken(cell.folder, 0.2, hang=True)
    with pytest.raises(ControllerError, match=r"does not answer: no read within 0\.2 s"):
        applied(cell.feed(store), table_of())
    assert cell.files() == {}
    store.hang.set()


def after_a_failure(cell, damage, words):
    """Return a feed whose second table failed, and what the controller held before."""
    good = cell.feed()
    applied(good, table_of())
    good.close()
    held = cell.files()
    feed = cell.feed(Broken(cell.folder, 20.0, damage=damage))
    with pytest.raises(ControllerError, match=words):
        applied(feed, table_of(1.5))
    return feed, held


def test_what_is_read_back_differently_is_put_back(cell):
    feed, held = after_a_failure(cell, 1, r"differ from what was written; the old table")
    assert cell.files() == held
    undone(feed)  # takes back the application before, not the one that failed
    assert cell.files() == {}


def test_when_putting_back_fails_too_the_old_table_is_named(cell):
    feed, held = after_a_failure(cell, 2, r"not known what .* holds\. The old table is in")
    undone(feed)
    assert cell.files() == held


def test_a_crash_while_writing_can_be_undone(cell, monkeypatch):
    feed = cell.feed()
    applied(feed, table_of())
    held = cell.files()

    def crash(files):
        (cell.folder / COMP).write_text("half")
        raise KeyboardInterrupt

    monkeypatch.setattr(feed._store, "write", crash)
    with pytest.raises(KeyboardInterrupt):
        applied(feed, table_of(1.5))
    feed.close()
    undone(cell.feed())
    assert cell.files() == held


def test_a_table_made_by_hand_that_cannot_be_read_is_left_alone(cell):
    (cell.folder / COMP).write_text("# my table\n0 0 0\n")
    with pytest.raises(ControllerError, match="the change is not known"):
        applied(cell.feed(), table_of())
    assert (cell.folder / COMP).read_text() == "# my table\n0 0 0\n"


def test_a_journal_cut_off_by_a_crash_is_continued(cell):
    feed = cell.feed()
    applied(feed, table_of())
    journal = cell.folder / STATE_FOLDER / "journal.jsonl"
    with journal.open("a") as stream:
        stream.write('{"action": "appl')
    applied(feed, table_of(1.2))
    undone(feed)
    np.testing.assert_allclose(
        trims(cell)[:-1], -np.rad2deg(wavy(even(24)) - wavy(0.0)), atol=2e-9
    )


def test_a_damaged_journal_is_told(cell):
    feed = cell.feed()
    applied(feed, table_of())
    (cell.folder / STATE_FOLDER / "journal.jsonl").write_text("nonsense\n")
    with pytest.raises(ControllerError, match="is damaged"):
        undone(feed)


MACHINE = """[KINS]
KINEMATICS = trivkins coordinates=C
[TRAJ]
ANGULAR_UNITS = degree
[JOINT_0]
TYPE = ANGULAR
MIN_LIMIT = 0
MAX_LIMIT = 360
"""


def test_a_table_that_the_machine_would_not_use_is_not_applied(cell):
    machine = cell.folder / "machine.ini"
    machine.write_text(MACHINE)
    feed = cell.feed(options=(f"machine_ini={machine}",), busy_command=("true",))
    with pytest.raises(DataError, match=r"would not use the table: .* names no table"):
        applied(feed, table_of())
    assert COMP not in cell.files()
    machine.write_text(MACHINE + f"COMP_FILE = {COMP}\nCOMP_FILE_TYPE = 1\n")
    applied(feed, table_of())
    assert COMP in cell.files()


MACHINE = """[EMC]
[KINS]
JOINTS = 1
KINEMATICS = trivkins coordinates=C
[TRAJ]
ANGULAR_UNITS = degree
[JOINT_0]
TYPE = ANGULAR
MIN_LIMIT = 0
MAX_LIMIT = 360
MAX_VELOCITY = 90
MAX_ACCELERATION = 2000
BACKLASH = 0.01
"""


def test_the_bridge_puts_what_backlash_did_into_the_table_and_says_so(cell, tmp_path):
    machine = tmp_path / "machine.ini"
    machine.write_text(MACHINE)
    feed = cell.feed(options=(f"machine_ini={machine}",))
    feed.take(table_of(), cell.clock.ns)
    _, up, down = np.array(
        [line.split() for line in feed.offer.files[COMP].splitlines()], dtype=float
    ).T
    assert up - down == pytest.approx(0.01, abs=3e-9)
    (said,) = (text for text in feed.offer.export.warnings if "BACKLASH" in text)
    assert "+18 arcsec in the forward column and -18 in the reverse one" in said
