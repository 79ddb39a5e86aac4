"""Versions of the code, and what research/yardstick.py measures of them, kept in files."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from math import inf
from pathlib import Path
from threading import Lock
from typing import Any, Final

ROOT: Final = Path(__file__).resolve().parents[1]
GOLDEN: Final = ROOT / "test" / "golden"
POWER_PLANS: Final = {
    path.stem: path for path in sorted((ROOT / "research" / "power_plans").glob("*.yaml"))
}
PLANS: Final = POWER_PLANS | {
    f"golden/{path.parents[1].name}": path for path in sorted(GOLDEN.glob("*/table/setup.yaml"))
}
TIMED: Final = {
    (path.stem.removesuffix("_demo"), angles): path
    if angles is None
    else POWER_PLANS[path.stem.removesuffix("_demo")]
    for path in sorted((ROOT / "config").glob("*_demo.yaml"))
    if path.stem.removesuffix("_demo") in POWER_PLANS
    for angles in (None, 72, 360, 3600)
}
"""Plans that are solved against the clock, with so many angles; None: the demonstration."""
STARTED: Final = {
    **{
        f"golden/{path.parent.name}": ["solve", str(path), "--json"]
        for path in sorted(GOLDEN.glob("*/bag"))
    },
    "settings": ["settings"],
}
PAPERS: Final = ("tracer", "three_rosette", "two_groups", "mirror")
PARTS: Final = ("sound", "power", "time", "start", "claims")
REPEATS, LONG_S = 5, 10.0
"""Of what is timed the least counts; what takes long is timed once."""
SEARCHED: Final = 50
"""Measurements of each size while sizes are searched."""
BEYOND: Final = "beyond 2 min or 6 GB"

Key = tuple[str, str, str, int]
"""Part, plan, case and number of a measurement."""
Record = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Code:
    """A version of the package in a ``folder``; its records are kept in a ``file``."""

    name: str
    folder: Path
    file: Path
    records: dict[Key, Record] = field(default_factory=dict)
    lock: Lock = field(default_factory=Lock)

    @classmethod
    def of(cls, given: str, results: Path) -> Code:
        """Return the code of a folder or a commit, with what was measured of it before."""
        if Path(given).is_dir():
            folder = Path(given).resolve()
            digest = hashlib.sha256()
            for path in sorted((folder / "rotcal_ros").rglob("*.py")):
                digest.update(path.read_bytes())
            name = f"{folder.name}-{digest.hexdigest()[:8]}"
        else:
            name = _git("rev-parse", "--verify", f"{given}^{{commit}}").decode()[:12]
            folder = results.resolve() / "code" / name
            if not (folder / "package.xml").exists():
                folder.mkdir(parents=True, exist_ok=True)
                unpack = ["tar", "-x", "-C", str(folder)]
                subprocess.run(unpack, input=_git("archive", name), check=True)
        code = cls(name, folder, results / f"{name}.jsonl")
        code._load()
        return code

    def _load(self) -> None:
        """Read the file; a last line that was cut is taken away."""
        text = self.file.read_text(encoding="utf-8") if self.file.exists() else ""
        whole = text[: text.rfind("\n") + 1]
        for line in whole.splitlines():
            self._take(json.loads(line))
        if whole != text:
            self.file.write_text(whole, encoding="utf-8")

    def _take(self, record: Record) -> None:
        self.records[record["part"], record["plan"], record["case"], record["number"]] = record

    def measure(self, jobs: Iterable[Record]) -> None:
        """Let a process of this code do those of the ``jobs`` that were not done before."""
        todo = [job for job in jobs if tuple(job["key"].values()) not in self.records]
        if not todo:
            return
        part, plan, case, _ = todo[0]["key"].values()
        print(f"{self.name}: {plan} {case}, {part}: {len(todo)}", file=sys.stderr, flush=True)
        with tempfile.TemporaryFile("w+") as lines:
            lines.writelines(json.dumps(job) + "\n" for job in todo)
            lines.seek(0)
            worker = subprocess.Popen(
                [sys.executable, "-S", str(ROOT / "research" / "yardstick_worker.py")],
                stdin=lines, stdout=subprocess.PIPE, text=True, cwd=self.folder,
                env={**os.environ, "PYTHONPATH": self._paths(), "OMP_NUM_THREADS": "1"},
            )  # fmt: skip
        with worker:
            assert worker.stdout is not None
            for line in worker.stdout:
                self._keep(line)
        if worker.returncode and part == "time":
            self._keep(json.dumps({**todo[0]["key"], "failed": BEYOND}) + "\n")
        elif worker.returncode:
            raise SystemExit(f"{self.name}: the worker ended with {worker.returncode}")

    def _paths(self) -> str:
        """Return where this code, its own plug-ins and the libraries lie: no plug-in of another.

        The environment's own packages of the project would be found as well, so the libraries are
        linked into a folder without them.
        """
        entries, libraries = (self.file.parent / name for name in ("plug-ins", "libraries"))
        entries /= self.name
        libraries.mkdir(exist_ok=True)
        for path in Path(sysconfig.get_path("purelib")).iterdir():
            link = libraries / path.name
            if not (path.name.startswith(("rotcal", "__editable__")) or link.is_symlink()):
                link.symlink_to(path)
        packages = [each.parent for each in self.folder.glob("packages/*/setup.py")]
        if not entries.exists():
            entries.mkdir(parents=True)
            words = ["setup.py", "--quiet", "egg_info", "--egg-base", str(entries.resolve())]
            core = self.folder if (self.folder / "setup.py").exists() else ROOT
            for package in (core, *packages):
                subprocess.run([sys.executable, *words], cwd=package, check=True)
        paths = self.folder, *packages, entries, libraries
        return os.pathsep.join(str(path.resolve()) for path in paths)

    def _keep(self, line: str) -> None:
        with self.lock, self.file.open("a", encoding="utf-8") as kept:
            kept.write(line)
            self._take(json.loads(line))

    def of_case(self, part: str, plan: str, case: str) -> dict[int, Record]:
        """Return the records of a case by their number."""
        return {key[3]: r for key, r in self.records.items() if key[:3] == (part, plan, case)}

    def sizes(self, plan: str) -> list[Record]:
        """Return what was searched of the effects on a plan, in the order of their search."""
        return [r for key, r in self.records.items() if key[:2] == ("sizes", plan)]


def _git(*words: str) -> bytes:
    ran = subprocess.run(["git", "-C", str(ROOT), *words], check=True, stdout=subprocess.PIPE)
    return ran.stdout


def job(part: str, plan: str, case: str, number: int, **more: Any) -> Record:
    """Return what a worker is asked for; the key comes back with the answer."""
    key = {"part": part, "plan": plan, "case": case, "number": number}
    return {"part": part, "number": number, "key": key, **more}


@dataclass(frozen=True, eq=False)
class Comparison:
    """What is compared: ``plans`` (none: all) in so many ``runs``; ``new`` None: the old alone."""

    old: Code
    new: Code | None
    plans: tuple[str, ...]
    runs: int

    @property
    def codes(self) -> list[Code]:
        """The old code and, if there is one, the new."""
        return [self.old, *([self.new] if self.new else [])]

    @property
    def beside(self) -> str:
        """What tells times that were taken side by side from others."""
        return f" beside {self.new.name}" if self.new else ""

    def chosen(self, names: Iterable[str]) -> list[str]:
        """Return those of the names that are wanted."""
        return [name for name in names if not self.plans or name in self.plans]

    def pairs(self, part: str, plan: str, case: str = "") -> list[list[Record]]:
        """Return the records of each code, of the numbers that all have."""
        every = [code.of_case(part, plan, case) for code in self.codes]
        common = sorted(set.intersection(*(set(found) for found in every)))
        return [[found[number] for number in common] for found in every]

    def measure(self, parts: Iterable[str], threads: int) -> None:
        """Measure what is missing, times last and alone."""
        todo = []
        for plan in self.chosen(PLANS) if "sound" in parts else ():
            jobs = [job("sound", plan, "", k, file=str(PLANS[plan])) for k in range(self.runs)]
            todo += [partial(code.measure, jobs) for code in self.codes]
        for plan in self.chosen(POWER_PLANS) if "power" in parts else ():
            todo.append(partial(self._try_effects, plan))
        for paper in self.chosen(PAPERS) if "claims" in parts else ():
            jobs = [job("claims", paper, "", 0, paper=paper)]
            todo += [partial(code.measure, jobs) for code in self.codes]
        with ThreadPoolExecutor(threads) as pool:
            try:
                for done in [pool.submit(task) for task in todo]:
                    done.result()
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
        for timed in self._timed(parts):
            for code in self.codes:
                part, plan, case, _ = timed["key"].values()
                before = code.of_case(part, plan, case).values()
                if all(r.get("seconds", inf) < LONG_S for r in before):
                    code.measure([timed])

    def _try_effects(self, plan: str) -> None:
        """Search the old code's sizes, then try every effect at its size with both codes."""
        file = str(POWER_PLANS[plan])
        known = [found["case"] for found in self.old.sizes(plan)]
        self.old.measure([job("sizes", plan, "", 0, file=file, runs=SEARCHED, known=known)])
        jobs = [
            job("power", plan, of_size(found["case"], size), number, file=file,
                effect=found["case"], size=size)
            for found in self.old.sizes(plan)
            for size in tried(found)
            for number in range(self.runs)
        ]  # fmt: skip
        for code in self.codes:
            code.measure(jobs)

    def _timed(self, parts: Iterable[str]) -> Iterator[Record]:
        """Yield what is timed, again and again, each beside the other code."""
        for number in range(REPEATS):
            for (plan, angles), path in TIMED.items() if "time" in parts else ():
                case, file = of_angles(angles) + self.beside, str(path)
                if self.chosen([plan]):
                    yield job("time", plan, case, number, file=file, angles=angles)
            for name in self.chosen(STARTED) if "start" in parts else ():
                yield job("start", name, self.beside, number, words=STARTED[name])


def tried(found: Record) -> list[float]:
    """Return sizes (SI) of an effect: that which is noticed, and what is allowed or the half."""
    if found["allowed"] is not None:
        return [found["tried"], found["allowed"]]
    return [found["tried"], *([0.5 * found["tried"]] if found["reached"] else [])]


def of_size(effect: str, size: float) -> str:
    """Return the case of an effect of a size."""
    return f"{effect} {size:.6g}"


def of_angles(angles: int | None) -> str:
    """Return the case of a solution against the clock."""
    return f"{angles} angles" if angles else "demonstration"
