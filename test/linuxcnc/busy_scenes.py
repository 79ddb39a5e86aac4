"""Runs inside a LinuxCNC: brings it into several states and asks the agent in each of them.

usage: busy_scenes.py AGENT INI; standard output: {"state": [exit code, text], ...}
"""

import importlib.util
import json
import subprocess
import sys
import time
from pathlib import Path

import linuxcnc

AGENT, INI = sys.argv[1:]
A_JOINT = 3
spec = importlib.util.spec_from_file_location("agent", AGENT)
agent = importlib.util.module_from_spec(spec)
spec.loader.exec_module(agent)


def asked():
    command = [sys.executable, AGENT, "-ini", INI, "--busy"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    return run.returncode, run.stdout.strip() or run.stderr.strip()


def rest(machine):
    machine.command.abort()
    machine.command.wait_complete(10)
    deadline = time.monotonic() + 60
    while asked()[0] and time.monotonic() < deadline:
        time.sleep(0.1)


machine = agent.LinuxCncMachine(linuxcnc, "A", A_JOINT)
machine.start()
machine.take()
found = {"at rest": asked()}
machine.command.mdi("G94 G1 A30 F60")
time.sleep(0.5)
found["moving"] = asked()
rest(machine)
program = Path(INI).with_name("dwell.ngc")
program.write_text("G4 P20\nM2\n")
machine.command.mode(linuxcnc.MODE_AUTO)
machine.command.wait_complete(10)
machine.command.program_open(str(program))
machine.command.auto(linuxcnc.AUTO_RUN, 0)
time.sleep(0.5)
found["program"] = asked()
rest(machine)
found["at rest again"] = asked()
machine.command.mode(linuxcnc.MODE_MANUAL)
machine.command.wait_complete(10)
for name, teleop, number in (("joint", 0, A_JOINT), ("axis", 1, 3)):
    machine.command.teleop_enable(teleop)
    machine.command.wait_complete(10)
    machine.command.jog(linuxcnc.JOG_CONTINUOUS, not teleop, number, 5.0)
    time.sleep(0.5)
    found[f"jogging the {name}"] = asked()
    machine.command.jog(linuxcnc.JOG_STOP, not teleop, number)
    rest(machine)
sys.stdout.write(json.dumps(found) + "\n")
