"""Start a node as ``ros2 run`` does, see it on the graph, end it by Ctrl-C.

usage: check_node.py INSTALL_FOLDER NODE
"""

import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

APPEAR_S, END_S = 60.0, 30.0
os.environ |= {
    "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
}

import rclpy  # noqa: E402
from ament_index_python.packages import get_package_prefix  # noqa: E402

from rotcal_ros.foundation.machine_load import load_scaled_timeout  # noqa: E402


def expect(good: bool, complaint: str) -> None:
    """Stop with the complaint unless all is good."""
    if not good:
        sys.exit(f"check_node: {complaint}")


def is_on_graph(name: str, process: subprocess.Popen[bytes]) -> bool:
    """Wait until a node of that name can be seen."""
    deadline = time.monotonic() + load_scaled_timeout(APPEAR_S)
    rclpy.init()
    try:
        observer = rclpy.create_node("check_node")
        while time.monotonic() < deadline and process.poll() is None:
            rclpy.spin_once(observer, timeout_sec=0.1)
            if name in observer.get_node_names():
                return True
        return False
    finally:
        rclpy.try_shutdown()


def main(install: Path, name: str) -> None:
    """Check one node."""
    for package in ("rotcal_ros", "rotcal_msgs"):
        place = Path(importlib.util.find_spec(package).origin)
        expect(install in place.parents, f"{package} comes from {place}, not from {install}")
    # What ros2 run does: <prefix of the package in the ament index>/lib/<package>/<executable>
    executable = Path(get_package_prefix("rotcal_ros"), "lib", "rotcal_ros", name)
    expect(install in executable.parents, f"{executable} is not in {install}")
    expect(os.access(executable, os.X_OK), f"{executable} is not an executable file")
    process = subprocess.Popen([executable])
    try:
        expect(
            is_on_graph(name, process),
            f"{name} did not appear within {load_scaled_timeout(APPEAR_S):g} s",
        )
        process.send_signal(signal.SIGINT)
        code = process.wait(timeout=load_scaled_timeout(END_S))
    finally:
        process.kill()
    expect(code in (0, 130), f"{name} ended with {code} after Ctrl-C")
    print(f"{executable}: seen on the graph, ended by Ctrl-C")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve(), sys.argv[2])
