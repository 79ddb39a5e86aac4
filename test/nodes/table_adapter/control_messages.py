"""The package control_msgs, built by the chain that builds rotcal_msgs: it has no wheel.

Only what FollowJointTrajectory needs, field by field as it is published; a test holds the hashes
of the types against those of the published package.
"""

import hashlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
TOLERANCE = "float64 position\nfloat64 velocity\nfloat64 acceleration\n"
INTERFACES = {
    "msg/JointTolerance.msg": "string name\n" + TOLERANCE,
    "msg/JointComponentTolerance.msg": "string joint_name\nuint16 component\n" + TOLERANCE,
    "action/FollowJointTrajectory.action": """
trajectory_msgs/JointTrajectory trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
JointTolerance[] path_tolerance
JointComponentTolerance[] component_path_tolerance
JointTolerance[] goal_tolerance
JointComponentTolerance[] component_goal_tolerance
builtin_interfaces/Duration goal_time_tolerance
---
int32 error_code
int32 SUCCESSFUL = 0
int32 INVALID_GOAL = -1
int32 INVALID_JOINTS = -2
int32 OLD_HEADER_TIMESTAMP = -3
int32 PATH_TOLERANCE_VIOLATED = -4
int32 GOAL_TOLERANCE_VIOLATED = -5
string error_string
---
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
""",
}
BUILDERS = ("cmake", "ninja", "c++")


def built():
    """Return the folder that the package is installed in; skip where it cannot be built."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    missing = [name for name in BUILDERS if shutil.which(name, path=path) is None]
    if missing:
        pytest.skip(f"control_msgs cannot be built without {', '.join(missing)}")
    sources = {**INTERFACES, "CMakeLists.txt": _cmake(), "package.xml": _package()}
    key = hashlib.sha256(repr((sys.version, sys.prefix, sources)).encode()).hexdigest()[:16]
    place = ROOT / "build" / f"control_msgs-{key}"
    if not (place / "made").exists():
        shutil.rmtree(place, ignore_errors=True)
        for name, text in sources.items():
            (place / "source" / name).parent.mkdir(parents=True, exist_ok=True)
            (place / "source" / name).write_text(text)
        _build(place, path)
        (place / "made").touch()
    return place / "installed"


def environment(installed):
    """Return the variables with which a process finds the package."""
    packages = next(installed.glob("lib/python3*/site-packages"))

    def with_own(name, folder):
        return {name: os.pathsep.join(filter(None, [str(folder), os.environ.get(name, "")]))}

    return {
        **with_own("PYTHONPATH", packages),
        **with_own("LD_LIBRARY_PATH", installed / "lib"),
        **with_own("AMENT_PREFIX_PATH", installed),
    }


def _cmake():
    """Return the recipe of rotcal_msgs for these interfaces."""
    text = (
        (ROOT / "msg_defs" / "CMakeLists.txt").read_text().replace("rotcal_msgs", "control_msgs")
    )
    needed = "find_package(std_msgs REQUIRED)\n"
    text = text.replace(needed, needed + needed.replace("std_msgs", "trajectory_msgs"))
    listed = "".join(f'  "{name}"\n' for name in INTERFACES)
    listed += "  DEPENDENCIES std_msgs builtin_interfaces trajectory_msgs\n"
    return re.sub(r"(rosidl_generate_interfaces\(\S+\n)[^)]*\)", rf"\1{listed})", text)


def _package():
    text = (ROOT / "msg_defs" / "package.xml").read_text().replace("rotcal_msgs", "control_msgs")
    needed = "<depend>std_msgs</depend>"
    return text.replace(needed, needed + needed.replace("std_msgs", "trajectory_msgs"))


def _build(place, path):
    variables = {**os.environ, "PATH": path, "AMENT_PREFIX_PATH": sys.prefix}
    for name in ("PYTHONPATH", "LD_LIBRARY_PATH", "CMAKE_PREFIX_PATH"):
        variables.pop(name, None)
    configure = [
        "cmake", "-S", "source", "-B", "made_of", "-G", "Ninja", "-DBUILD_TESTING=OFF",
        "-DCMAKE_BUILD_TYPE=None", f"-DCMAKE_PREFIX_PATH={sys.prefix}",
        f"-DCMAKE_INSTALL_PREFIX={place / 'installed'}", f"-DPython3_EXECUTABLE={sys.executable}",
    ]  # fmt: skip
    for command in (configure, ["ninja", "-C", "made_of", "install"]):
        done = subprocess.run(command, cwd=place, env=variables, capture_output=True, text=True)
        assert done.returncode == 0, f"{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
