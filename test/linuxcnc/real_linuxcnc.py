"""A real LinuxCNC with one rotary axis, and optionally a plant with a known error in HAL."""

import json
import shutil
import subprocess
import time
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread

import numpy as np
import pytest

import rotcal_ros

HERE = Path(__file__).parent
AGENT = Path(rotcal_ros.__file__).parent / "nodes" / "linuxcnc_agent.py"
DEADLINE_S = 60.0

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
COMM_TIMEOUT = 4.0
SERVO_PERIOD = 1000000
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.100
TOOL_TABLE = tool.tbl
[HAL]
HALFILE = axis.hal
[KINS]
JOINTS = 1
KINEMATICS = trivkins coordinates=A
[TRAJ]
COORDINATES = A
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
DEFAULT_ANGULAR_VELOCITY = 2000
MAX_ANGULAR_VELOCITY = 2000
[AXIS_A]
MIN_LIMIT = -1e6
MAX_LIMIT = 1e6
MAX_VELOCITY = 2000
MAX_ACCELERATION = 20000
[JOINT_0]
TYPE = ANGULAR
HOME = 0.0
HOME_SEQUENCE = 0
MIN_LIMIT = -1e6
MAX_LIMIT = 1e6
MAX_VELOCITY = 2000
MAX_ACCELERATION = 20000
FERROR = 5.0
MIN_FERROR = 5.0
"""

HAL = """loadrt trivkins coordinates=A
loadrt motmod servo_period_nsec=1000000 num_joints=1
{load}addf motion-command-handler servo-thread
addf motion-controller servo-thread
{plant}net motor joint.0.motor-pos-cmd => joint.0.motor-pos-fb
net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
net prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared
net change iocontrol.0.tool-change => iocontrol.0.tool-changed
"""

PLANT_PIN = "plant.actual"


def command(ini, *arguments):
    """Return the command that runs LinuxCNC with the agent, private on this machine."""
    inside = ["/usr/bin/python3", str(HERE / "by_hand.py"), str(ini)]
    agent = ["/usr/bin/python3", str(AGENT), "-ini", str(ini), *arguments]
    return ["unshare", "--ipc", *inside, *agent]


def why_not():
    """Return why LinuxCNC cannot run here, empty if it can."""
    missing = [p for p in ("milltask", "io", "halcmd", "unshare") if shutil.which(p) is None]
    if missing:
        return f"LinuxCNC is not installed (no {', '.join(missing)}): apt install linuxcnc-uspace"
    if subprocess.run(["unshare", "--ipc", "true"], capture_output=True, check=False).returncode:
        return "LinuxCNC's shared memory cannot be made private: 'unshare --ipc' needs root"
    return ""


def plant_hal(first_deg, last_deg, step_deg, error_deg):
    """Return (load, plant): actual = motor + error(motor), linear between points in HAL.

    A HAL curve has 16 points at most and holds its ends, so a chain of curves that all begin at
    zero adds up to a long one.
    """
    count = int(np.ceil((last_deg - first_deg) / step_deg / 15))
    nodes = first_deg + step_deg * np.arange(15 * count + 1)
    values = error_deg(nodes)
    load = [f"loadrt lincurve count={count} personality={','.join(['16'] * count)}"]
    names = [*(f"sum{k}" for k in range(count)), "plant"]
    load.append(f"loadrt sum2 names={','.join(names)}")
    plant = []
    for k in range(count):
        part = slice(15 * k, 15 * k + 16)
        for i, (x, y) in enumerate(zip(nodes[part], values[part], strict=True)):
            y = y - values[15 * k]
            plant.append(f"setp lincurve.{k}.x-val-{i:02d} {x:.12g}")
            plant.append(f"setp lincurve.{k}.y-val-{i:02d} {y:.15g}")
        plant.append(f"net motor => lincurve.{k}.in")
        plant.append(f"net error{k} lincurve.{k}.out => sum{k}.in0")
        plant.append(f"addf lincurve.{k} servo-thread")
        if k:
            plant.append(f"net total{k - 1} sum{k - 1}.out => sum{k}.in1")
        plant.append(f"addf sum{k} servo-thread")
    # The first value enters as a constant.
    plant.append(f"setp sum0.in1 {values[0]:.15g}")
    plant.append(f"net total{count - 1} sum{count - 1}.out => plant.in1")
    plant.append("net motor => plant.in0")
    plant.append("addf plant servo-thread")
    return "\n".join([*load, ""]), "\n".join([*plant, ""])


class Axis:
    """The files of a LinuxCNC with one rotary axis in ``folder``."""

    def __init__(self, folder, plant=("", "")):
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        for name in ("tool.tbl", "axis.var"):
            (folder / name).write_text("")
        load, chain = plant
        self.actual = "plant.out" if chain else ""
        (folder / "axis.hal").write_text(HAL.format(load=load, plant=chain))
        self.ini = folder / "axis.ini"
        self.ini.write_text(INI)

    def load(self, files):
        """Take the exported files: the table beside the ini file, its lines into it."""
        (ini,) = (text for name, text in files.items() if name.endswith(".ini"))
        assert ini.startswith("[JOINT_0]\n")
        for name, text in files.items():
            if name.endswith(".comp"):
                (self.folder / name).write_text(text)
        # The section is the last one of the file, so that the lines join it.
        self.ini.write_text(INI + ini.removeprefix("[JOINT_0]\n"))

    def command(self, start=True):
        arguments = ["--actual", self.actual] if self.actual else []
        return command(self.ini, *(["--start"] if start else []), *arguments)


class Running:
    """A running LinuxCNC; a context manager."""

    def __init__(self, axis):
        self.errors = []
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
            (a0, m0), (a1, m1) = recent[-min(len(recent), 15)], recent[-1]
            there = abs(line["angle_deg"] - angle_deg) < 1e-7 and len(recent) > 15
            return there and abs(a1 - a0) < 1e-10 and abs(m1 - m0) < 1e-10

        return self._next(resting)

    def _next(self, wanted):
        deadline = time.monotonic() + DEADLINE_S
        while time.monotonic() < deadline:
            try:
                line = self._lines.get(timeout=1.0)
            except Empty:
                continue
            if line is None:
                pytest.fail(f"LinuxCNC ended with code {self._process.wait()}")
            self.errors += line.get("errors", [])
            if wanted(line):
                return line
        pytest.fail(f"LinuxCNC: nothing within {DEADLINE_S} s; errors {self.errors}")

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
            self._process.wait(30.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
