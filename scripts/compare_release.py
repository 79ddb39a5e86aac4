"""Compare two versions: what they make of golden files, and what they promise.

usage: python scripts/compare_release.py OLD NEW     each a commit, or a folder of `make release`

Each version is installed by itself, without its dependencies, in front of those of this
environment, and works in a process of its own, on the golden files of this checkout. For each the
table says whether numbers have the same bits, how far apart deviations are in standard
uncertainties of the old result, or that it is different. Exit code 1 where it is, or where a
promise of OLD (docs/compatibility.json) is broken in NEW.
"""

from __future__ import annotations

import argparse
import json
import os
import runpy
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
GOLDEN = ROOT / "test" / "golden"
SHARE = 0.1
"""Largest difference in standard uncertainties, where bits are not the same."""
Outcomes = dict[str, dict[str, Any]]


class Version:
    """A commit or a folder of wheels, installed below ``place``."""

    def __init__(self, name: str, place: Path) -> None:
        self.name, self._installed = name, place / "installed"
        released = Path(name, "release.json")
        if released.is_file():
            self._commit = json.loads(released.read_text())["commit"]
            sources = sorted(Path(name).resolve().glob("*.whl"))
        else:
            self._commit = name
            source = place / "source"
            source.mkdir(parents=True)
            archive = _git("archive", name)
            subprocess.run(("tar", "-x", "-C", source), input=archive, check=True)
            sources = [source, *(path.parent for path in source.glob("packages/*/setup.py"))]
        pip = (sys.executable, "-m", "pip", "-q", "--disable-pip-version-check", "install")
        here = ("--no-deps", "--no-build-isolation", "--target", self._installed)
        subprocess.run((*pip, *here, *sources), check=True)
        self._environment = {**os.environ, "PYTHONPATH": str(self._installed)}
        where = (sys.executable, "-c", "import rotcal_ros; print(rotcal_ros.__file__)")
        loaded = subprocess.check_output(where, cwd=place, env=self._environment, text=True)
        if not loaded.startswith(str(self._installed)):
            raise SystemExit(f"{name}: what is imported is {loaded.strip()}")

    def promises(self) -> dict[str, Any]:
        """Return the record of what is promised; empty for versions of before."""
        found = subprocess.run(
            ("git", "show", f"{self._commit}:docs/compatibility.json"),
            cwd=ROOT, capture_output=True, check=False,
        )  # fmt: skip
        return dict(json.loads(found.stdout)) if found.returncode == 0 else {}

    def outcomes(self, commands: dict[str, list[str]], arithmetic: dict[str, str]) -> Outcomes:
        """Carry out commands of rotcal: name -> exit code, output and error text."""
        run = subprocess.run(
            (sys.executable, GOLDEN / "golden_commands.py"), cwd=GOLDEN, check=True, text=True,
            input=json.dumps(commands), stdout=subprocess.PIPE,
            env=self._environment | arithmetic,
        )  # fmt: skip
        return dict(json.loads(run.stdout))


def commands(out: Path) -> tuple[dict[str, list[str]], dict[str, str]]:
    """Return all golden commands, tables of controllers into ``out``, and their arithmetic."""
    sys.path.append(str(GOLDEN))
    golden = runpy.run_path(str(GOLDEN / "test_golden.py"))
    found = dict(golden["SOLVED"])
    for name, words in golden["EXPORTED"].items():
        held = f"exported/{name}"
        found[f"{name} written"] = [*words, "--replace", "-o", str(out / f"{name} written")]
        found[f"{name} in force"] = [*words, "--add-to", held, "-o", str(out / f"{name} in force")]
    return found, golden["ARITHMETIC"]


def difference(old: dict[str, Any], new: dict[str, Any]) -> float:
    """Return how far deviations of two results are apart at most, in the old ones' u.

    Infinite where verdict, angles or components differ.
    """
    if any(old[name] != new[name] for name in ("verdict", "angles_rad")):
        return np.inf
    if set(old["deviations"]) != set(new["deviations"]):
        return np.inf
    worst = 0.0
    for name, std in old["std"].items():
        u = np.array(std, dtype=np.float64)
        for field in ("deviations", "std"):
            apart = np.abs(np.subtract(old[field][name], new[field][name], dtype=np.float64))
            shares = np.divide(apart, u, out=np.where(apart > 0.0, np.inf, 0.0), where=u > 0.0)
            worst = max(worst, float(shares.max(initial=0.0)))
    return worst


def judged(old: dict[str, Any], new: dict[str, Any], files: list[dict[str, str]]) -> str:
    """Return what became of one command, in words that begin with `different` if it is."""
    if old["code"] != new["code"]:
        return f"different: exit code {old['code']}, then {new['code']}: {new['error'][-200:]}"
    if files[0] != files[1]:
        changed = sorted(set(files[0].items()) ^ set(files[1].items()))
        return f"different: {changed[0][0]}"
    if old["code"]:
        return f"refused by both: {old['error'][-200:]}"
    if old["out"] == new["out"]:
        return "same bits"
    if not old["out"].startswith("{"):
        return "different: what is printed"
    first, second = json.loads(old["out"]), json.loads(new["out"])
    share = difference(first, second)
    text = f"deviations and u differ by at most {share:.2g} u"
    return text if share <= SHARE else f"different: {text}, or verdict, angles or components"


def written(folder: Path) -> dict[str, str]:
    """Return name -> content of a controller's own files in a folder."""
    side = ".provenance.json"
    return {p.name: p.read_text() for p in folder.glob("*") if not p.name.endswith(side)}


def compared(old: Version, new: Version, place: Path) -> Iterator[tuple[str, str]]:
    """Yield each golden command with what became of it."""
    outs = [place / "old_out", place / "new_out"]
    found = []
    for version, out in zip((old, new), outs, strict=True):
        wanted, arithmetic = commands(out)
        found.append(version.outcomes(wanted, arithmetic))
    for name, before in found[0].items():
        after = found[1][name]
        for outcome, out in zip((before, after), outs, strict=True):
            outcome["out"] = outcome["out"].replace(str(out), "")
        yield name, judged(before, after, [written(out / name) for out in outs])


def _git(*words: str) -> bytes:
    return subprocess.run(("git", *words), cwd=ROOT, check=True, capture_output=True).stdout


def main() -> int:
    """Compare, print a line for each, return the exit code."""
    parser = argparse.ArgumentParser(description="Compare two versions.")
    parser.add_argument("old")
    parser.add_argument("new")
    asked = parser.parse_args()
    broken = runpy.run_path(str(ROOT / "scripts" / "promises.py"))["broken"]
    with tempfile.TemporaryDirectory(prefix="releases") as folder:
        place = Path(folder)
        old, new = (Version(getattr(asked, n), place / n) for n in ("old", "new"))
        lines = dict(compared(old, new, place))
        for name, text in lines.items():
            print(f"{name:32} {text}")
        gone = list(broken(old.promises(), new.promises()))
    print("\n".join(f"broken: {line}" for line in gone) or "no promise is broken")
    different = [name for name, text in lines.items() if text.startswith("different")]
    print(f"{len(lines) - len(different)} of {len(lines)} as promised")
    return 1 if different or gone else 0


if __name__ == "__main__":
    sys.exit(main())
