"""Talks to a running LinuxCNC for the driver node, in JSON lines.

LinuxCNC's modules belong to the system's own Python and not to the one that ROS runs on: this
file is a program of its own, run by /usr/bin/python3, and imports nothing of rotcal_ros.

The table is ``--axis`` with its ``--joint``, one among all axes of the machine. The machine must
be on and homed; ``--start`` lets the program do both. It says ``{"event": "ready"}``, then all the
time ``{"stamp_ns", "angle_deg", "motor_deg", "actual_deg", "obeying", "errors"}``: feedback of the
joint, the motor's command, the pin ``--actual`` (null without one), whether an order is still to
be carried out, and what LinuxCNC complained about. Standard input takes
``{"angle_deg": 90.0, "side": 1, "overshoot_deg": 2.0}``: go there in machine coordinates from
below (1), from above (-1), or from anywhere (0). A repeated order moves nothing; an order that
finds the machine at work is not carried out. The end of standard input ends the program.

``--busy`` asks whether the machine is at work: exit code 1 and the reason if so, else 0.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import sys
import threading
import time
from typing import Any

START_TIMEOUT_S = 30.0
MOVE_TIMEOUT_S = 120.0
STANDS_DEG = 1e-6


class LinuxCncMachine:
    """Commands and state of LinuxCNC; one thread uses one object."""

    def __init__(self, linuxcnc: Any, axis: str, joint: int) -> None:
        self._linuxcnc, self._axis, self._joint = linuxcnc, axis, joint
        self.command, self.stat = linuxcnc.command(), linuxcnc.stat()
        self._reached: tuple[float, float] | None = None

    def start(self) -> None:
        """Switch on and home all joints."""
        deadline = time.monotonic() + START_TIMEOUT_S
        lx = self._linuxcnc
        self.command.state(lx.STATE_ESTOP_RESET)
        self.command.state(lx.STATE_ON)
        self._wait(lambda: self.stat.task_state == lx.STATE_ON, deadline, "machine that is on")
        self.command.mode(lx.MODE_MANUAL)
        self.command.wait_complete(START_TIMEOUT_S)
        # LinuxCNC homes single joints only in joint mode, not in teleop mode.
        self.command.teleop_enable(0)
        self.command.wait_complete(START_TIMEOUT_S)
        # -1: all joints, in the sequence of the ini file.
        self.command.home(-1)
        self._wait(self._all_homed, deadline, "homed machine")

    def take(self) -> None:
        """Switch to commands; ends the program when the machine is not ready for them."""
        lx = self._linuxcnc
        # LinuxCNC that has just been started says at first that it has no joints at all.
        deadline = time.monotonic() + START_TIMEOUT_S
        self._wait(lambda: self.stat.joints > 0, deadline, "machine with joints")
        if self._joint >= self.stat.joints:
            sys.exit(f"LinuxCNC has {self.stat.joints} joints and no joint {self._joint}")
        if self.stat.task_state != lx.STATE_ON or not self._all_homed():
            sys.exit("LinuxCNC is not on or not homed: switch it on and home it first")
        self._command_mode()

    def go(self, angle_deg: float) -> None:
        """Move there and wait until it is done."""
        # Machine coordinates: a work offset of the axis must not shift the table.
        self.command.mdi(f"G53 G90 G0 {self._axis}{angle_deg:.9f}")
        self.command.wait_complete(MOVE_TIMEOUT_S)
        idle = self._linuxcnc.INTERP_IDLE
        self._wait(
            lambda: self.stat.inpos and self.stat.queue == 0 and self.stat.interp_state == idle,
            time.monotonic() + MOVE_TIMEOUT_S,
            f"{self._axis} at {angle_deg} deg",
        )

    def move(self, order: dict[str, float]) -> None:
        """Carry out one order, with the overshoot of its side; RuntimeError: other work."""
        if work := current_activity(self._linuxcnc):
            raise RuntimeError(f"{work}: the order for {self._axis} was not carried out")
        self.stat.poll()
        if self.stat.task_mode != self._linuxcnc.MODE_MDI:
            self._command_mode()
        angle = order["angle_deg"]
        ahead = angle - self.stat.joint_position[self._joint]
        side, beyond = order.get("side", 0), order.get("overshoot_deg", 2.0)
        if self._reached == (angle, side) and abs(ahead) < STANDS_DEG:
            return  # one arrival for all targets of a table position
        self._reached = None
        # On the wrong side, or at the goal: go beyond first, to arrive from the ordered side.
        if side and ahead * side <= 0.0:
            self.go(angle - side * beyond)
        self.go(angle)
        self._reached = angle, side

    def _command_mode(self) -> None:
        self._reached = None  # by hand the axis may have come back from another side
        self.command.mode(self._linuxcnc.MODE_MDI)
        self.command.wait_complete(START_TIMEOUT_S)

    def _all_homed(self) -> bool:
        return self.stat.joints > 0 and all(self.stat.homed[: self.stat.joints])

    def _wait(self, done: Any, deadline: float, what: str) -> None:
        while True:
            self.stat.poll()
            if done():
                return
            if time.monotonic() > deadline:
                raise TimeoutError(f"LinuxCNC: no {what}")
            time.sleep(0.002)


def current_activity(linuxcnc: Any) -> str | None:
    """Return what the machine is doing; None: nothing, or LinuxCNC does not run."""
    try:
        stat = linuxcnc.stat()
        stat.poll()
    except linuxcnc.error:
        return None
    if stat.interp_state != linuxcnc.INTERP_IDLE:
        return f"LinuxCNC runs a program or command ({stat.file or 'MDI'})"
    joints = [stat.joint[number] for number in range(stat.joints)]
    if not stat.inpos or stat.queue or any(joint["velocity"] for joint in joints):
        return "LinuxCNC moves the machine"
    return None


def write_event(message: dict[str, Any]) -> None:
    """Write one line."""
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


def execute_orders(
    machine: LinuxCncMachine, orders: queue.Queue[dict[str, float]], errors: list[str]
) -> None:
    """Carry out orders one after the other; a failure is reported, and the next order is tried."""
    while True:
        try:
            machine.move(orders.get())
        except Exception as error:
            errors.append(str(error))
        orders.task_done()


def read_orders(orders: queue.Queue[dict[str, float]]) -> None:
    """Read orders until standard input ends."""
    for line in sys.stdin:
        orders.put(json.loads(line))


def main() -> None:
    """Run until standard input ends."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-ini", required=True, help="ini file of the running LinuxCNC")
    parser.add_argument("--axis", default="A", help="letter of the table's axis")
    parser.add_argument("--joint", type=int, default=0, help="number of its joint")
    parser.add_argument("--actual", default="", help="HAL pin of the actual angle in degrees")
    parser.add_argument("--rate", type=float, default=100.0, help="Hz, lines on standard output")
    parser.add_argument("--start", action="store_true", help="switch on and home all")
    parser.add_argument("--busy", action="store_true", help="say whether it is at work, and end")
    arguments = parser.parse_args()
    os.environ["INI_FILE_NAME"] = arguments.ini
    import linuxcnc

    if arguments.busy:
        work = current_activity(linuxcnc)
        sys.stdout.write(f"{work or ''}\n")
        sys.exit(1 if work else 0)
    import hal

    component = hal.component(f"rotcal-agent-{os.getpid()}")
    component.ready()
    channel = linuxcnc.error_channel()
    machine = LinuxCncMachine(linuxcnc, arguments.axis, arguments.joint)
    if arguments.start:
        machine.start()
    machine.take()
    orders, errors = queue.Queue[dict[str, float]](), list[str]()
    threading.Thread(target=execute_orders, args=(machine, orders, errors), daemon=True).start()
    listener = threading.Thread(target=read_orders, args=(orders,), daemon=True)
    listener.start()
    write_event({"event": "ready"})
    while listener.is_alive():
        while (complaint := channel.poll()) is not None:
            errors.append(str(complaint[1]).strip())
        pins = ("pos-fb", "motor-pos-cmd")
        angle, motor = (hal.get_value(f"joint.{arguments.joint}.{pin}") for pin in pins)
        state = {"stamp_ns": time.time_ns(), "angle_deg": angle, "motor_deg": motor}
        actual = hal.get_value(arguments.actual) if arguments.actual else None
        obeying = orders.unfinished_tasks > 0
        write_event({**state, "actual_deg": actual, "obeying": obeying, "errors": errors[:]})
        errors.clear()
        time.sleep(1.0 / arguments.rate)
    component.exit()


if __name__ == "__main__":
    main()
