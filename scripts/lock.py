"""Writes locks/DISTRIBUTION.txt: all packages, direct or brought in, with versions and hashes.

usage: python scripts/lock.py [jazzy] [kilted]     needs uv, and an index that it can reach

The versions follow from what the core and the packages beside it ask for, constraints.txt and
constraints-DISTRIBUTION.txt, for every Python from 3.10 on by markers. A line `# for: core ros`
before each says who needs it, directly or not: the core, its extras, packages with all of theirs.
scripts/setup.sh installs what was asked for.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections import defaultdict
from importlib.metadata import requires
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OLDEST_PYTHON = "3.10"
TOOLS = ("setuptools", "uv", "wheel")
"""What sets up the environment itself, as the part `tools`."""
DISTRIBUTIONS = ("jazzy", "kilted")
NOT_INSTALLED = {"mutants", "peers", "release"}
"""Extras that set-up never installs: they are asked for by hand."""
_BLOCK = re.compile(r"(?m)^(?P<name>[\w.-]+)==[^\n]*(?:\n    (?:--hash|#)[^\n]*)*\n")
_VIA = re.compile(r"#\s+(?:via\s+)?(\S+)")


def wanted_by_part(distribution: str) -> dict[str, set[str]]:
    """Return part -> its direct dependencies as they are stated."""
    found: defaultdict[str, set[str]] = defaultdict(set, tools={*TOOLS})
    left_out = {f"build-{d}" for d in DISTRIBUTIONS} - {f"build-{distribution}"} | NOT_INSTALLED
    packages = [path.parent.name for path in sorted(ROOT.glob("packages/*/setup.py"))]
    for package in ("rotcal_ros", *packages):
        for text in requires(package) or ():
            wanted, _, condition = text.partition(";")
            extra = re.search(r"extra == ['\"]([\w-]+)['\"]", condition)
            part = package if package in packages else extra[1] if extra else "core"
            if part not in left_out and not wanted.startswith("rotcal_"):
                found[part].add(wanted.strip())
    return dict(found)


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def resolved(distribution: str, wanted: set[str]) -> str:
    """Return what uv resolves, with hashes, and with who needs each package as comments."""
    pins = ("constraints.txt", f"constraints-{distribution}.txt")
    command = [
        Path(sys.executable).with_name("uv"), "pip", "compile", "-", "--quiet",
        "--universal", "--python-version", OLDEST_PYTHON, "--generate-hashes", "--no-header",
        "--no-emit-index-url", "--no-emit-find-links", "--annotation-style", "split",
        *(part for pin in pins for part in ("--constraint", pin)),
    ]  # fmt: skip
    outcome = subprocess.run(
        command, cwd=ROOT, input="\n".join(sorted(wanted)), capture_output=True, text=True,
        check=False, env={**os.environ, "UV_PYTHON_DOWNLOADS": "never"},
    )  # fmt: skip
    if outcome.returncode:
        raise SystemExit(outcome.stderr)
    return outcome.stdout


def locked(distribution: str) -> str:
    """Return the text of a lock."""
    wanted = wanted_by_part(distribution)
    text = resolved(distribution, set().union(*wanted.values()))
    blocks = [(_plain(m["name"]), m[0]) for m in _BLOCK.finditer(text)]
    needs: defaultdict[str, set[str]] = defaultdict(set)
    for name, block in blocks:
        for by in _VIA.findall(block):
            needs[_plain(by)].add(name)
    parts: defaultdict[str, set[str]] = defaultdict(set)
    for part, names in wanted.items():
        waiting = [_plain(re.split(r"[\[<>=!~ ]", name, maxsplit=1)[0]) for name in names]
        while waiting:
            if part not in parts[name := waiting.pop()]:
                parts[name].add(part)
                waiting += needs[name]
    lines = [
        f"# Made by scripts/lock.py for ROS 2 {distribution.capitalize()}: do not edit.\n",
        "# Before each package stands who needs it; `tools` set up the environment.\n",
    ]
    for name, block in blocks:
        pinned = re.sub(r"\n    #[^\n]*", "", block)
        lines += [f"# for: {' '.join(sorted(parts[name]))}\n", pinned]
    return "".join(lines)


def main() -> None:
    """Write the locks."""
    (ROOT / "locks").mkdir(exist_ok=True)
    for distribution in sys.argv[1:] or DISTRIBUTIONS:
        (ROOT / "locks" / f"{distribution}.txt").write_text(locked(distribution))


if __name__ == "__main__":
    main()
