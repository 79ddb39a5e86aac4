"""Starts LinuxCNC without display, launcher or network, runs a program, and ends it all.

usage: unshare --ipc /usr/bin/python3 by_hand.py INI PROGRAM ARGUMENTS...

LinuxCNC's shared memory has fixed keys, so that a machine can hold one LinuxCNC; an IPC namespace
of its own makes it private and takes all of it away at the end.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

NML = Path("/usr/share/linuxcnc/linuxcnc.nml")
MODULES = "/usr/lib/linuxcnc/modules"
DEADLINE_S = 300.0
UID = "65534"
"""Nobody: the real-time part refuses to run as root."""
OWNERS = {"emcCommand": "emc", "emcStatus": "emc"}


def without_server(text):
    """Return the NML file for a run without linuxcncsvr: no TCP, io and milltask own buffers."""
    lines = []
    for line in text.replace(" TCP=5005", "").splitlines():
        cells = line.split()
        if cells[:2] == ["P", "emcsvr"]:
            continue
        if cells[:1] == ["P"] and cells[1] == OWNERS.get(cells[2], "tool"):
            cells[8] = "1"
        lines.append(" ".join(cells))
    return "\n".join(lines) + "\n"


def main():
    ini = Path(sys.argv[1])
    (ini.parent / "by_hand.nml").write_text(without_server(NML.read_text()))
    # A short path that LinuxCNC's own user can reach, for the socket of its real-time part.
    with tempfile.TemporaryDirectory(prefix="rotcal-", dir="/tmp") as reachable:
        environment = {
            **os.environ,
            "INI_FILE_NAME": str(ini),
            "HAL_RTMOD_DIR": MODULES,
            "RTAPI_FIFO_PATH": f"{reachable}/rtapi",
        }
        if os.getuid() == 0:
            environment["RTAPI_UID"] = UID
            Path(reachable).chmod(0o777)
        with (ini.parent / "linuxcnc.log").open("ab") as log:
            options = {"env": environment, "stdout": log, "stderr": log, "cwd": ini.parent}
            return live(ini, sys.argv[2:], options)


def live(ini, program, options):
    """Start the parts in their order, run the program, end the parts; return its exit code."""
    parts = []

    def run(*command):
        subprocess.run(
            command, check=True, stdin=subprocess.DEVNULL, timeout=DEADLINE_S, **options
        )

    def start(*command):
        parts.append(subprocess.Popen(command, stdin=subprocess.DEVNULL, **options))

    try:
        # The real-time part first: it holds the shared memory. Else a halcmd that only looks, and
        # is the last to leave, takes it away just when io has found it, and io ends.
        run("halcmd", "loadrt", "tpmod")
        run("halcmd", "loadrt", "homemod")
        start("io", "-ini", str(ini))
        wait_for("iocontrol", parts, options["env"])  # it has the pins that axis.hal connects
        run("halcmd", "-i", str(ini), "-f", str(ini.parent / "axis.hal"))
        run("halcmd", "start")
        start("milltask", "-ini", str(ini))
        wait_for("inihal", parts, options["env"])
        return subprocess.call(program, env=options["env"], cwd=ini.parent)
    finally:
        # One after the other: milltask waits 5 s for an answer of an io that is gone.
        for process in reversed(parts):
            end(process)
        subprocess.run(["halcmd", "stop"], check=False, **options)
        subprocess.run(["halcmd", "unload", "all"], check=False, **options)


def wait_for(component, parts, environment):
    deadline = time.monotonic() + DEADLINE_S
    while component not in ready(environment):
        if time.monotonic() > deadline or any(part.poll() is not None for part in parts):
            sys.exit("LinuxCNC did not start; see linuxcnc.log beside its ini file")
        time.sleep(0.05)


def end(process):
    process.terminate()
    try:
        process.wait(60.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def ready(environment):
    """Return the components that have made all their pins."""
    shown = subprocess.run(
        ["halcmd", "-s", "show", "comp"],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    rows = [line.split() for line in shown.stdout.splitlines()]
    return [row[2] for row in rows if row[-1:] == ["ready"]]


if __name__ == "__main__":
    sys.exit(main())
