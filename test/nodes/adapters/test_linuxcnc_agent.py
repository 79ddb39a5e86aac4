"""The agent beside LinuxCNC, with a stand-in for its modules: which axis moves, and when not."""

import queue
from threading import Event, Thread
from types import SimpleNamespace

import pytest

from rotcal_ros.nodes.adapters.linuxcnc_agent import LinuxCncMachine, execute_orders


class Program:
    """Four joints X, Y, Z and A that go at once to where an MDI command sends A."""

    INTERP_IDLE, INTERP_READING, MODE_MDI, MODE_AUTO, STATE_ON = 1, 2, 3, 2, 4
    error = RuntimeError

    def __init__(self):
        self.positions, self.commands = [7.0, 8.0, 9.0, 30.0], []
        self.interp_state, self.task_mode = self.INTERP_IDLE, self.MODE_AUTO
        self.velocity, self.homed = 0.0, [1, 1, 1, 1]
        self.early_polls = 0

    def stat(self):
        stat = SimpleNamespace(
            joints=0 if self.early_polls else 4,
            homed=(*self.homed, *[0] * 12),
            task_state=self.STATE_ON,
            task_mode=self.task_mode,
            interp_state=self.interp_state,
            file="part.ngc",
            inpos=True,
            queue=0,
            joint=[{"velocity": v} for v in (self.velocity, 0.0, 0.0, 0.0)],
            joint_position=self.positions,
        )

        def poll():
            self.early_polls = max(self.early_polls - 1, 0)
            stat.joints = 0 if self.early_polls else 4
            stat.task_mode = self.task_mode

        stat.poll = poll
        return stat

    def command(self):
        return SimpleNamespace(mode=self._mode, mdi=self._mdi, wait_complete=lambda _seconds: 1)

    def _mode(self, mode):
        self.commands.append(f"mode {mode}")
        self.task_mode = mode

    def _mdi(self, text):
        self.commands.append(text)
        self.positions[3] = float(text.rpartition("A")[2])


@pytest.mark.parametrize(
    ("angle", "side", "moves"),
    [(40.0, 1, [40.0]), (20.0, 1, [18.0, 20.0]), (40.0, -1, [42.0, 40.0]), (10.0, 0, [10.0])],
)
def test_the_named_axis_moves_in_machine_coordinates_from_the_wanted_side(angle, side, moves):
    program = Program()
    LinuxCncMachine(program, "A", 3).move({"angle_deg": angle, "side": side})
    assert program.commands == ["mode 3", *(f"G53 G90 G0 A{move:.9f}" for move in moves)]


def moved_by(machine, program, *orders):
    program.commands.clear()
    for angle, side in orders:
        machine.move({"angle_deg": angle, "side": side})
    return [float(text.rpartition("A")[2]) for text in program.commands if "A" in text]


def test_an_order_that_repeats_the_last_one_moves_nothing():
    program = Program()
    machine = LinuxCncMachine(program, "A", 3)
    assert moved_by(machine, program, (40.0, 1), (40.0, 1)) == [40.0]
    assert moved_by(machine, program, (40.0, -1), (40.0, -1)) == [42.0, 40.0]
    assert moved_by(machine, program, (40.0, 1)) == [38.0, 40.0]


def test_after_somebody_else_has_moved_it_the_axis_arrives_again():
    program = Program()
    machine = LinuxCncMachine(program, "A", 3)
    machine.move({"angle_deg": 40.0, "side": 1})
    program.positions[3] = 41.0
    assert moved_by(machine, program, (40.0, 1)) == [38.0, 40.0]
    program.task_mode = 1  # by hand, and back to where it was
    assert moved_by(machine, program, (40.0, 1)) == [38.0, 40.0]


@pytest.mark.parametrize(
    ("work", "why"),
    [({"interp_state": Program.INTERP_READING}, "runs a program"), ({"velocity": 0.1}, "moves")],
)
def test_an_order_that_finds_the_machine_at_work_is_not_carried_out(work, why):
    program = Program()
    vars(program).update(work)
    with pytest.raises(RuntimeError, match=f"{why}.*: the order for A was not carried out"):
        LinuxCncMachine(program, "A", 3).move({"angle_deg": 40.0})
    assert program.commands == []


@pytest.mark.parametrize("joint", [3, 4])
def test_every_joint_has_to_be_homed_and_the_table_has_to_be_one(joint):
    program = Program()
    program.homed[0] = joint - 3
    with pytest.raises(SystemExit, match="not homed" if joint == 3 else "no joint 4"):
        LinuxCncMachine(program, "A", joint).take()


def test_a_linuxcnc_that_has_just_been_started_is_waited_for():
    program = Program()
    program.early_polls = 3
    LinuxCncMachine(program, "A", 3).take()
    assert program.commands == ["mode 3"]


def test_an_order_counts_as_open_until_it_is_carried_out_or_has_failed():
    begun, may_end = Event(), Event()

    def move(order):
        begun.set()
        may_end.wait(10.0)
        if order["angle_deg"] > 90.0:
            raise RuntimeError("no")

    orders, errors = queue.Queue(), []
    Thread(
        target=execute_orders, args=(SimpleNamespace(move=move), orders, errors), daemon=True
    ).start()
    for angle in (10.0, 100.0):
        orders.put({"angle_deg": angle})
    assert begun.wait(10.0)
    assert orders.unfinished_tasks == 2
    may_end.set()
    orders.join()
    assert orders.unfinished_tasks == 0
    assert errors == ["no"]
