"""What some tests run and nobody brings along: fetched once, before the tests, never by them.

usage: python test/aids.py    fetches packages of Node.js and NIST's test suite for I++ DME

It all stays in the user's cache. A test without its aid is skipped, or fails where that aid is
required (ROTCAL_REQUIRE_NODE=1).
"""

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
HOW = "make test-aids"
PROGRAMS = (
    HERE / "bags" / "node" / "read_bag.mjs",
    *sorted(HERE.parent.glob("packages/*/test/**/node/*.mjs")),
)
AXE = HERE / "report" / "node" / "axe.js"
"""A place beside the list of packages; the program is in one of them."""
NIST = "https://github.com/aschet/nistippdmetestsuite"
"""NIST's suite, made ready for the compilers of today."""
COMMIT = "890b29966b741e4cbdeda67a14954b61b3721a0f"


def cache(name):
    """Return the folder of one aid."""
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return caches / f"rotcal_{name}"


def packages_of(program):
    """Return the folder with the packages that a program on Node.js needs."""
    package = program.with_name("package.json")
    return cache(f"node_{hashlib.sha256(package.read_bytes()).hexdigest()[:12]}")


def on_node(program):
    """Return ``program`` beside its packages; skip the test where it cannot run."""
    return Path(shutil.copy(program, installed(program)))


def axe():
    """Return the script of axe-core, which finds faults of accessibility in a page."""
    return (installed(AXE) / "node_modules" / "axe-core" / "axe.min.js").read_text()


def installed(program):
    """Return the folder with the packages of a program; skip the test where they are missing."""
    folder = packages_of(program)
    if shutil.which("node") is None:
        why = "Node.js is not installed: apt install nodejs npm"
    elif not (folder / "installed").exists():
        why = f"packages of Node.js are not here: {HOW}"
    else:
        return folder
    if os.environ.get("ROTCAL_REQUIRE_NODE"):
        pytest.fail(f"required here (ROTCAL_REQUIRE_NODE): {why}")
    return pytest.skip(why)


def nist_suite():
    """Return NIST's stand-alone components (ROTCAL_NIST_DME names a copy), or skip the test."""
    folder = Path(os.environ.get("ROTCAL_NIST_DME") or cache(f"nist_{COMMIT[:12]}"))
    if shutil.which("g++") is None:
        pytest.skip("no compiler for NIST's I++ DME test suite: apt install g++")
    if not folder.exists():
        pytest.skip(f"NIST's I++ DME test suite is not here: {HOW}")
    inside = folder / "standAloneTestSuiteComponents"
    return inside if inside.exists() else folder


def fetch_packages(program):
    folder = packages_of(program)
    if (folder / "installed").exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(program.with_name("package.json"), folder)
    command = ["npm", "install", "--no-audit", "--no-fund", "--ignore-scripts"]
    subprocess.run(command, cwd=folder, check=True)
    (folder / "installed").touch()


def fetch_nist():
    folder = cache(f"nist_{COMMIT[:12]}")
    if folder.exists():
        return
    made = folder.with_suffix(".part")
    shutil.rmtree(made, ignore_errors=True)
    made.mkdir(parents=True)
    for arguments in (
        ["init", "-q"],
        ["fetch", "-q", "--depth=1", NIST, COMMIT],
        ["checkout", "-q", "FETCH_HEAD"],
    ):
        subprocess.run(["git", *arguments], cwd=made, check=True, timeout=60)
    made.rename(folder)


def failure(work, *arguments):
    """Return why something could not be fetched; empty: it is here."""
    try:
        work(*arguments)
    except (OSError, subprocess.SubprocessError) as error:
        return str(error)
    return ""


def main():
    """Fetch what can be had; return 1 where something is missing."""
    failures = [
        failure(fetch_nist),
        *(failure(fetch_packages, program) for program in (*PROGRAMS, AXE)),
    ]
    for text in filter(None, failures):
        sys.stderr.write(f"{text}\n")
    return 1 if any(failures) else 0


if __name__ == "__main__":
    sys.exit(main())
