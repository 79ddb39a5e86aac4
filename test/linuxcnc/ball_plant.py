"""A table on a table with a ball and a touch probe in HAL; runs programs on the LinuxCNC.

usage: /usr/bin/python3 ball_plant.py PLANT.json AGENT_FOLDER PROGRAM.ngc...

Runs beside LinuxCNC, on the system's Python. The ball follows the tilting joint and C by rotations
about lines in space, which the controller does not know; while a touch is made, both stand still.
Its pins `tilting` and `c` say at which angles it is: on a busy machine it comes late.
"""

import json
import math
import sys
import threading
import time
from pathlib import Path

import hal
import linuxcnc

TIMEOUT_S = 600.0
PINS = {axis: f"off-{axis}.in1" for axis in "xyz"}
PINS |= {"tilting": "there-tilting.in2", "c": "there-c.in2"}
"""Pins of the ball, the angles last, and what hears them."""


def turned(point, line, degrees):
    """Return a point that turns about a line (point, direction), by Rodrigues."""
    (through, along), angle = line, math.radians(degrees)
    length = math.sqrt(sum(k * k for k in along))
    k = [component / length for component in along]
    v = [a - b for a, b in zip(point, through, strict=True)]
    cross = [k[1] * v[2] - k[2] * v[1], k[2] * v[0] - k[0] * v[2], k[0] * v[1] - k[1] * v[0]]
    dot = sum(a * b for a, b in zip(k, v, strict=True))
    c, s = math.cos(angle), math.sin(angle)
    return [o + v[i] * c + cross[i] * s + k[i] * dot * (1 - c) for i, o in enumerate(through)]


def follow(plant, component, ended):
    """Move the ball with the joints until ``ended``."""
    while not ended.is_set():
        a, c = (hal.get_value(f"joint.{n}.motor-pos-cmd") for n in (3, 4))
        place = turned(turned(plant["ball"], plant["C"], c), plant["tilting"], a)
        for axis, value in zip(PINS, (*place, a, c), strict=True):
            component[axis] = value
        time.sleep(0.001)


def main():
    plant = json.loads(Path(sys.argv[1]).read_text())
    sys.path.insert(0, sys.argv[2])
    from linuxcnc_agent import LinuxCncMachine

    component, ended = hal.component("ball"), threading.Event()
    for pin in PINS:
        component.newpin(pin, hal.HAL_FLOAT, hal.HAL_OUT)
    component.ready()
    for pin, hearer in PINS.items():
        hal.new_sig(f"ball-{pin}", hal.HAL_FLOAT)
        hal.connect(f"ball.{pin}", f"ball-{pin}")
        hal.connect(hearer, f"ball-{pin}")
    threading.Thread(target=follow, args=(plant, component, ended), daemon=True).start()
    machine = LinuxCncMachine(linuxcnc, "C", 4)
    machine.start()
    for program in sys.argv[3:]:
        run(machine, program)
    ended.set()


def run(machine, program):
    """Run a program to its end; exits with what LinuxCNC complains about."""
    command, stat, errors = machine.command, machine.stat, linuxcnc.error_channel()
    command.mode(linuxcnc.MODE_AUTO)
    command.wait_complete(30.0)
    command.program_open(program)
    command.wait_complete(30.0)
    command.auto(linuxcnc.AUTO_RUN, 0)
    begun = time.monotonic()
    time.sleep(0.5)
    while True:
        stat.poll()
        if (found := errors.poll()) and found[0] in (
            linuxcnc.NML_ERROR,
            linuxcnc.OPERATOR_ERROR,
        ):
            sys.exit(f"{program}, line {stat.motion_line}: {found[1]}")
        if stat.interp_state == linuxcnc.INTERP_IDLE and stat.inpos:
            return
        if time.monotonic() - begun > TIMEOUT_S:
            sys.exit(f"{program} does not end")
        time.sleep(0.02)


if __name__ == "__main__":
    main()
