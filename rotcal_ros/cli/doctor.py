"""``rotcal doctor``: what this machine lacks, and what to do about it."""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib import metadata, util
from itertools import chain
from pathlib import Path
from typing import Final

import click

from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.escapes import printable
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.foundation.middleware import SUPPORTED, distribution, middleware, rclpy_version
from rotcal_ros.sessions.domains import free_domain
from rotcal_ros.sessions.processes import messages_are_current

COMPILERS: Final = (("CC", "cc"), ("CXX", "c++"))
NEEDED_BYTES: Final = 2_000_000_000
"""A calibration of an hour at 1 kHz takes a fraction of this."""
TRIAL_DEADLINE_S: Final = 60.0


@dataclass(frozen=True, slots=True)
class Check:
    """One check: what was found and, if it is bad, what to do."""

    name: str
    ok: bool
    found: str
    advice: str = ""


@click.command()
@click.option(
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("out"),
    show_default=True,
    help="Folder for calibrations.",
)
@click.option("--machine-ini", type=path_type, metavar="FILE", help="Ini file of LinuxCNC.")
@json_option
def command(output: Path, machine_ini: Path | None, as_json: bool) -> int:
    """Check this machine and say what to do.

    Without ROS a bag can still be solved: the lines about ROS concern live calibration only. With
    --machine-ini it shows which tables this LinuxCNC loads, and what is wrong with them.
    """
    done: list[Check] = []
    for check in chain(
        run_checks(output), check_linuxcnc_tables(machine_ini) if machine_ini else ()
    ):
        done.append(check)
        if not as_json:
            mark = click.style("✓", "green") if check.ok else click.style("✗", "red")
            advice = "" if check.ok else f"; {check.advice}"
            click.echo(f"{mark} {printable(f'{check.name}: {check.found}{advice}')}")
    good = all(check.ok for check in done)
    if as_json:
        print_json({"ok": good, "checks": [asdict(check) for check in done]})
    return 0 if good else 1


def run_checks(output: Path) -> Iterator[Check]:
    """Yield all checks in the order in which they depend on each other."""
    yield Check("Python", True, f"{platform.python_version()} at {sys.executable}")
    yield check_compiler()
    yield check_packages()
    live = (check_ros(), check_messages())
    yield from live
    if all(check.ok for check in live):
        yield (path := check_loopback())
        if path.ok:
            yield check_nodes()
            yield check_rate(output)
    yield check_writable(output)
    yield check_disk_space(output)


def check_linuxcnc_tables(machine_ini: Path) -> Iterator[Check]:
    """Check whether the ini file of a LinuxCNC puts its tables into force as intended."""
    from rotcal_ros.compensation.linuxcnc import find_loaded_tables

    advice = "the copy that 'rotcal export --machine-ini' writes has the lines where they belong"
    try:
        found = list(find_loaded_tables(machine_ini))
    except ConfigurationError as error:
        found = [(machine_ini.name, (str(error),))]
    for about, wrong in found:
        yield Check("LinuxCNC table", not wrong, "; ".join((about, *wrong)), advice)
    if not found:
        yield Check("LinuxCNC table", False, f"{machine_ini} names none", advice)


def check_compiler() -> Check:
    """Look for the compilers that build the message definitions."""
    found = [shutil.which(os.environ.get(name, fallback)) for name, fallback in COMPILERS]
    return Check(
        "C and C++ compiler",
        all(found),
        ", ".join(path for path in found if path) or "none",
        "needed to build rotcal_msgs: apt install g++",
    )


def check_packages() -> Check:
    """Look for the packages of the core."""
    stated = [need for need in metadata.requires("rotcal_ros") or () if "extra ==" not in need]
    versions = {name: _version(name) for need in stated for name in re.findall(r"^[\w-]+", need)}
    missing = [name for name, version in versions.items() if version is None]
    return Check(
        "Python packages",
        not missing,
        f"missing {', '.join(missing)}"
        if missing
        else ", ".join(f"{name} {versions[name]}" for name in ("numpy", "scipy", "mcap")),
        "run 'make setup' or 'pip install .' again",
    )


def check_ros() -> Check:
    """Look for rclpy without importing it, because that would load all of ROS."""
    if util.find_spec("rclpy") is None:
        advice = "needed for live calibration only: 'make setup', or source your ROS installation"
        return Check("ROS 2", False, "no rclpy", advice)
    version = rclpy_version()
    name, sourced = distribution(version), os.environ.get("ROS_DISTRO", "")
    title = name.capitalize() if name else "unknown distribution"
    found = f"{title}, rclpy {version or 'of unknown version'}"
    if name and sourced not in ("", name):
        advice = "open a shell that has sourced one ROS installation, or none"
        return Check("ROS 2", False, f"{found}, but ROS_DISTRO={sourced}", advice)
    tried = " and ".join(map(str.capitalize, SUPPORTED))
    return Check("ROS 2", name in SUPPORTED, found, f"live calibration was tried on {tried}")


def check_messages() -> Check:
    """Look for the generated messages."""
    built = util.find_spec("rotcal_msgs") is not None
    current = built and messages_are_current()
    return Check(
        "rotcal_msgs",
        current,
        "built" if current else "built from earlier definitions" if built else "not built",
        "needed for live calibration only: 'make setup', or build msg_defs with colcon",
    )


def check_loopback() -> Check:
    """Send a message there and back over DDS, in a domain of its own on this machine."""
    ok, found = _try("message_trial")
    return Check("DDS on this machine", ok, found, "let UDP through on the loopback interface")


def check_nodes() -> Check:
    """Start the nodes of every cell and end them, in a domain of their own on this machine."""
    ok, found = _try("start_trial")
    return Check("Nodes", ok, found, "'rotcal run' would fail too; report it with this line")


def check_rate(output: Path) -> Check:
    """Let recorder and capture work for 5 s beside whatever this machine is doing."""
    ok, found = _try("rate_trial", str(_existing(output)))
    advice = "give the calibration a computer, or cores, of its own (docs/running.md)"
    return Check("Rate", ok, found, advice)


def _try(module: str, *arguments: str) -> tuple[bool, str]:
    """Run a trial of the nodes as a process; return whether it succeeded, and its last message."""
    private = {"ROS_DOMAIN_ID": str(free_domain()), **middleware(os.environ)}
    try:
        run = subprocess.run(
            [sys.executable, "-m", f"rotcal_ros.nodes.check.{module}", *arguments],
            env=os.environ | private,
            capture_output=True,
            text=True,
            timeout=load_scaled_timeout(TRIAL_DEADLINE_S),
            check=False,
        )
        ok, lines = run.returncode == 0, (run.stdout or run.stderr).strip().splitlines()
    except subprocess.TimeoutExpired:
        ok, lines = False, [f"no answer within {TRIAL_DEADLINE_S:g} s"]
    return ok, lines[-1] if lines else "no answer"


def check_writable(output: Path) -> Check:
    """Check whether files can be created in the output folder."""
    folder = _existing(output)
    try:
        with tempfile.TemporaryFile(dir=folder):
            problem = ""
    except OSError as error:
        problem = f": {error.strerror}"
    return Check(
        "Output folder",
        not problem,
        f"{folder}{problem or ' is writable'}",
        "choose another one with --output",
    )


def check_disk_space(output: Path) -> Check:
    """Check whether there is room for a bag."""
    folder = _existing(output)
    free = shutil.disk_usage(folder).free
    return Check(
        "Disk space",
        free >= NEEDED_BYTES,
        f"{free / 1e9:.1f} GB free at {folder}",
        f"make room: {NEEDED_BYTES / 1e9:.0f} GB are recommended",
    )


def _existing(folder: Path) -> Path:
    """Return the nearest existing folder above: the output folder may not exist yet."""
    folder = folder.absolute()
    return next(path for path in (folder, *folder.parents) if path.exists())


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
