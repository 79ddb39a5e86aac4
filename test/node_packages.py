"""Programs on Node.js that tests run, with their packages from npm."""

import hashlib
import os
import shutil
import subprocess
from pathlib import Path

import pytest

REQUIRED = bool(os.environ.get("ROTCAL_REQUIRE_NODE"))
INSTALL_TIMEOUT_S = 400


def installed(program):
    """Return ``program`` in a folder where the packages of its ``package.json`` are installed.

    The folder stays in the user's cache. Skips the test where Node.js is missing, and fails it
    where that is required.
    """
    if shutil.which("node") is None or shutil.which("npm") is None:
        if REQUIRED:
            pytest.fail("Node.js is required here (ROTCAL_REQUIRE_NODE): install nodejs and npm")
        pytest.skip("Node.js is not installed: apt install nodejs npm")
    package = program.with_name("package.json")
    name = f"rotcal_node_{hashlib.sha256(package.read_bytes()).hexdigest()[:12]}"
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / name
    if not (cache / "installed").exists():
        cache.mkdir(parents=True, exist_ok=True)
        shutil.copy(package, cache)
        command = ["npm", "install", "--no-audit", "--no-fund", "--ignore-scripts"]
        subprocess.run(
            command, cwd=cache, check=True, timeout=INSTALL_TIMEOUT_S, capture_output=True
        )
        (cache / "installed").touch()
    return Path(shutil.copy(program, cache))
