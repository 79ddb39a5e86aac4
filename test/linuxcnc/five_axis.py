"""A real LinuxCNC with XYZAC or XYZBC, whose rotary axes are not where its kinematics think."""

import json
import subprocess

from real_linuxcnc import HERE, INI, JOINT, LINEAR, TABLE

from rotcal_ros.compensation.linuxcnc_machine import AGENT

HAL = """loadrt {kins}
loadrt motmod servo_period_nsec=1000000 num_joints=5
loadrt sum2 names=off-x,off-y,off-z
loadrt hypot names=off
loadrt comp names=touch
loadrt near names=there-tilting,there-c
loadrt and2 names=there
addf motion-command-handler servo-thread
addf motion-controller servo-thread
net c joint.4.motor-pos-cmd => joint.4.motor-pos-fb
net a joint.3.motor-pos-cmd => joint.3.motor-pos-fb
net x joint.0.motor-pos-cmd => joint.0.motor-pos-fb off-x.in0
net y joint.1.motor-pos-cmd => joint.1.motor-pos-fb off-y.in0
net z joint.2.motor-pos-cmd => joint.2.motor-pos-fb off-z.in0
net by-x off-x.out => off.in0
net by-y off-y.out => off.in1
net by-z off-z.out => off.in2
net distance off.out => touch.in0
net probe touch.out => motion.probe-input
setp off-x.gain1 -1
setp off-y.gain1 -1
setp off-z.gain1 -1
setp touch.in1 {reach}
net a => there-tilting.in1
net c => there-c.in1
net there-tilting there-tilting.out => there.in0
net there-c there-c.out => there.in1
net there there.out => motion.digital-in-00
setp there-tilting.difference 1e-9
setp there-c.difference 1e-9
addf there-tilting servo-thread
addf there-c servo-thread
addf there servo-thread
addf off-x servo-thread
addf off-y servo-thread
addf off-z servo-thread
addf off servo-thread
addf touch servo-thread
net kinematics motion.analog-out-03 => motion.switchkins-type
net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
net prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared
net change iocontrol.0.tool-change => iocontrol.0.tool-changed
"""
REACH_MM = 14.0
FAST = {"limits": (-1000, 1000), "velocity": 1000, "acceleration": 20000}


class FiveAxis:
    """The files of such a machine in ``folder``; ``pins``: HAL lines that place its axes, mm.

    ``plant``: the lines of C and of what tilts it, the axis ``letter``, and the ball, with both
    at zero, as (point, direction).
    """

    def __init__(self, folder, plant, letter="A"):
        self.folder, self.kins = folder, f"xyz{letter.lower()}c-trt-kins"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "tool.tbl").write_text("")
        (folder / "axis.var").write_text("5161\t0.0\n")
        (folder / "plant.json").write_text(json.dumps(plant))
        self.ini = folder / "axis.ini"
        kinds = [LINEAR | FAST] * 3 + [TABLE] * 2
        joints = (
            JOINT.format(letter=a, number=n, **k)
            for n, a, k in zip(range(5), f"XYZ{letter}C", kinds, strict=True)
        )
        text = INI.replace("trivkins coordinates=XYZA", self.kins)
        text = text.replace("JOINTS = 4", "JOINTS = 5")
        text = text.replace("COORDINATES = XYZA", f"COORDINATES = XYZ{letter}C").replace(
            "[TRAJ]", "[TRAJ]\nMAX_LINEAR_VELOCITY = 1000\nDEFAULT_LINEAR_VELOCITY = 1000"
        )
        self.ini.write_text(text + "".join(joints))
        self.place("")

    def place(self, pins):
        """Take the HAL lines that tell the kinematics where the axes are."""
        (self.folder / "axis.hal").write_text(HAL.format(kins=self.kins, reach=REACH_MM) + pins)

    def run(self, *programs):
        """Start the controller, run programs, and end it."""
        inside = ["/usr/bin/python3", str(HERE / "by_hand.py"), str(self.ini)]
        plant = [str(HERE / "ball_plant.py"), str(self.folder / "plant.json")]
        agent = AGENT[1].rpartition("/")[0]
        subprocess.run(
            ["unshare", "--ipc", *inside, "/usr/bin/python3", *plant, agent, *map(str, programs)],
            check=True, capture_output=True, text=True, timeout=900,
        )  # fmt: skip
