"""A real LinuxCNC with the axes XYZA, and optionally a plant with a known error in HAL."""

import json
import shutil
import subprocess
import time
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread

import numpy as np
import pytest

from rotcal_ros.compensation.linuxcnc_machine import IniFile, agent_command
from rotcal_ros.foundation.machine_load import load_scaled_timeout

HERE = Path(__file__).parent
DEADLINE_S = 60.0

# milltask begins anew, with the table too, when an answer of the real-time part takes longer than
# COMM_TIMEOUT: on a machine that is as busy as one that tests, seconds are not enough.
INI = """[EMC]
VERSION = 1.1
MACHINE = rotary
NML_FILE = by_hand.nml
DEBUG = 0
[DISPLAY]
DISPLAY = none
[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[RS274NGC]
PARAMETER_FILE = axis.var
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 60.0
SERVO_PERIOD = 1000000
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.100
TOOL_TABLE = tool.tbl
[HAL]
HALFILE = axis.hal
[KINS]
JOINTS = 4
KINEMATICS = trivkins coordinates=XYZA
[TRAJ]
COORDINATES = XYZA
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
DEFAULT_ANGULAR_VELOCITY = 2000
MAX_ANGULAR_VELOCITY = 2000
"""
JOINT = """[AXIS_{letter}]
MIN_LIMIT = {limits[0]}
MAX_LIMIT = {limits[1]}
MAX_VELOCITY = {velocity}
MAX_ACCELERATION = {acceleration}
[JOINT_{number}]
TYPE = {kind}
HOME = {home}
HOME_SEQUENCE = 0
MIN_LIMIT = {limits[0]}
MAX_LIMIT = {limits[1]}
MAX_VELOCITY = {velocity}
MAX_ACCELERATION = {acceleration}
FERROR = 5.0
MIN_FERROR = 5.0

"""
LINEAR = {
    "kind": "LINEAR", "limits": (-100, 100), "velocity": 100, "acceleration": 1000, "home": 0
}  # fmt: skip
TABLE = {
    "kind": "ANGULAR", "limits": (-1e6, 1e6), "velocity": 2000, "acceleration": 20000, "home": 0
}  # fmt: skip
OFFSET = "5224\t10.0\n"
"""The work offset of A: positions of the table are machine coordinates all the same."""

HAL = """loadrt trivkins coordinates=XYZA
loadrt motmod servo_period_nsec=1000000 num_joints=4
{load}addf motion-command-handler servo-thread
addf motion-controller servo-thread
{plant}net motor joint.3.motor-pos-cmd => joint.3.motor-pos-fb
net x joint.0.motor-pos-cmd => joint.0.motor-pos-fb
net y joint.1.motor-pos-cmd => joint.1.motor-pos-fb
net z joint.2.motor-pos-cmd => joint.2.motor-pos-fb
net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
net prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared
net change iocontrol.0.tool-change => iocontrol.0.tool-changed
"""

PLANT_PIN = "plant.actual"


def command(ini, *arguments):
    """Return the command that runs LinuxCNC with the agent, private on this machine."""
    inside = ["/usr/bin/python3", str(HERE / "by_hand.py"), str(ini)]
    agent = [*agent_command(str(ini), "A", 0), *arguments]
    return ["unshare", "--ipc", *inside, *agent]


def why_not():
    """Return why LinuxCNC cannot run here, empty if it can."""
    missing = [p for p in ("milltask", "io", "halcmd", "unshare") if shutil.which(p) is None]
    if missing:
        return f"LinuxCNC is not installed (no {', '.join(missing)}): apt install linuxcnc-uspace"
    if subprocess.run(["unshare", "--ipc", "true"], capture_output=True, check=False).returncode:
        return "LinuxCNC's shared memory cannot be made private: 'unshare --ipc' needs root"
    return ""


def plant_hal(first_deg, last_deg, step_deg, error_deg, play_deg=0.0):
    """Return (load, plant): actual = table + error(table), linear between points in HAL.

    The table follows the motor with a play: the motor moves it only at an end of the play.
    A HAL curve has 16 points at most and holds its ends, so a chain of curves that all begin at
    zero adds up to a long one.
    """
    count = int(np.ceil((last_deg - first_deg) / step_deg / 15))
    nodes = first_deg + step_deg * np.arange(15 * count + 1)
    values = error_deg(nodes)
    load = [f"loadrt lincurve count={count} personality={','.join(['16'] * count)}"]
    names = [*(f"sum{k}" for k in range(count)), "plant", "low", "high"]
    load += [f"loadrt sum2 names={','.join(names)}", "loadrt limit1 names=play"]
    plant = [
        f"setp low.in1 {-play_deg / 2:.15g}",
        f"setp high.in1 {play_deg / 2:.15g}",
        "net motor => low.in0 high.in0",
        "net low low.out => play.min",
        "net high high.out => play.max",
        "net table play.out => play.in",
        *(f"addf {name} servo-thread" for name in ("low", "high", "play")),
    ]
    for k in range(count):
        part = slice(15 * k, 15 * k + 16)
        for i, (x, y) in enumerate(zip(nodes[part], values[part], strict=True)):
            y = y - values[15 * k]
            plant.append(f"setp lincurve.{k}.x-val-{i:02d} {x:.12g}")
            plant.append(f"setp lincurve.{k}.y-val-{i:02d} {y:.15g}")
        plant.append(f"net table => lincurve.{k}.in")
        plant.append(f"net error{k} lincurve.{k}.out => sum{k}.in0")
        plant.append(f"addf lincurve.{k} servo-thread")
        if k:
            plant.append(f"net total{k - 1} sum{k - 1}.out => sum{k}.in1")
        plant.append(f"addf sum{k} servo-thread")
    # The first value enters as a constant.
    plant.append(f"setp sum0.in1 {values[0]:.15g}")
    plant.append(f"net total{count - 1} sum{count - 1}.out => plant.in1")
    plant.append("net table => plant.in0")
    plant.append("addf plant servo-thread")
    return "\n".join([*load, ""]), "\n".join([*plant, ""])


class Axis:
    """The files of a LinuxCNC whose table is A, joint 3, in ``folder``; ``table`` of its ini."""

    def __init__(self, folder, plant=("", ""), **table):
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "tool.tbl").write_text("")
        (folder / "axis.var").write_text(OFFSET)
        load, chain = plant
        self.actual = "plant.out" if chain else ""
        (folder / "axis.hal").write_text(HAL.format(load=load, plant=chain))
        self.ini = folder / "axis.ini"
        kinds = [LINEAR] * 3 + [TABLE | table]
        joints = (
            JOINT.format(letter=a, number=n, **k)
            for n, a, k in zip(range(4), "XYZA", kinds, strict=True)
        )
        self.ini.write_text(INI + "".join(joints))

    def load(self, text, file_type):
        """Take a table as it is."""
        (self.folder / "own.comp").write_text(text)
        lines = {"COMP_FILE": "own.comp", "COMP_FILE_TYPE": file_type}
        self.ini.write_text(IniFile.read(self.ini).merged("JOINT_3", lines))

    def take(self, made):
        """Take what an export for this machine wrote, the copy of the ini file included."""
        for name, text in made.with_machine_files().items():
            (self.folder / name).write_text(text)

    def command(self, start=True):
        arguments = ["--actual", self.actual] if self.actual else []
        return command(self.ini, *(["--start"] if start else []), *arguments)


class Running:
    """A running LinuxCNC; a context manager."""

    def __init__(self, axis):
        self.errors = []
        self._log = axis.folder / "linuxcnc.log"
        self._process = subprocess.Popen(
            axis.command(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        self._lines = SimpleQueue()
        Thread(target=self._read, daemon=True).start()

    def wait_until_ready(self):
        self._next(lambda line: line.get("event") == "ready")

    def go(self, angle_deg, side):
        """Move and return the state after the motor has come to rest, trim included."""
        order = {"angle_deg": angle_deg, "side": side}
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()
        recent = []

        def resting(line):
            if "motor_deg" not in line:
                return False
            recent.append((line["angle_deg"], line["motor_deg"]))
            # On a busy machine LinuxCNC itself may not have moved between two looks.
            looks = int(load_scaled_timeout(15))
            (a0, m0), (a1, m1) = recent[-min(len(recent), looks)], recent[-1]
            there = abs(line["angle_deg"] - angle_deg) < 1e-7 and len(recent) > looks
            return there and abs(a1 - a0) < 1e-10 and abs(m1 - m0) < 1e-10

        return self._next(resting)

    def _next(self, wanted):
        begun, line = time.monotonic(), None
        # the load may grow while we wait, and LinuxCNC's own time goes slower then
        while time.monotonic() - begun < load_scaled_timeout(DEADLINE_S):
            try:
                line = self._lines.get(timeout=1.0)
            except Empty:
                continue
            if line is None:
                said = self._log.read_text()[-2000:] if self._log.exists() else ""
                pytest.fail(f"LinuxCNC ended with code {self._process.wait()}: {said}")
            self.errors += line.get("errors", [])
            if wanted(line):
                return line
        waited = time.monotonic() - begun
        pytest.fail(f"LinuxCNC: nothing within {waited:.0f} s; errors {self.errors}; last {line}")

    def _read(self):
        for line in self._process.stdout:
            self._lines.put(json.loads(line))
        self._lines.put(None)

    def __enter__(self):
        self.wait_until_ready()
        return self

    def __exit__(self, *_):
        self._process.stdin.close()
        try:
            self._process.wait(load_scaled_timeout(30.0))
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
