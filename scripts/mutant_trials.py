"""Try a mutant on the tests of its room.

A mutant meets the tests that ran its statement, the quickest ones, ``ENOUGH_S`` of them; those
marked ``slow``, ``ros`` or ``linuxcnc`` are left out. It lives in a fork of this process, which
has imported all but the project; no file is changed. Which test runs which line is measured once
and kept in ``out/mutants/`` until code or tests change.
"""

from __future__ import annotations

import ast
import hashlib
import importlib
import importlib.util
import json
import os
import resource
import signal
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import Any

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}

import coverage
import pytest
from hypothesis import Phase, settings

PACKAGE = "rotcal_ros"
ROOT = Path(__file__).parents[1]
KEPT = ROOT / "out" / "mutants"
MARKERS = "not slow and not ros and not linuxcnc"
ENOUGH_S = 20.0
"""Seconds that the tests of one mutant may need without it."""
PATIENCE_S, PATIENCE = 10.0, 5.0
"""A mutant is stopped after the first and so many times as long as its tests need without it."""
MEMORY = 6 << 30
sys.path.insert(0, str(ROOT))


@dataclass(eq=False)
class Meter:
    """Notes which tests run which lines; what a shared fixture runs counts for all its users."""

    coverage: coverage.Coverage
    seconds: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    users: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    stack: list[str] = field(default_factory=lambda: [""])

    def _inside(self, context: str) -> Generator[None, Any, Any]:
        self.stack.append(context)
        self.coverage.switch_context(context)
        try:
            return (yield)
        finally:
            self.stack.pop()
            self.coverage.switch_context(self.stack[-1])

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, Any, Any]:
        """Count for this test what runs now."""
        for name in (item.nodeid, *getattr(item, "fixturenames", ())):
            self.users[name].append(item.nodeid)
        return (yield from self._inside(item.nodeid))

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Generator[None, Any, Any]:
        """Count for the fixture what runs now."""
        shared = fixturedef.scope != "function"
        return (yield from self._inside(fixturedef.argname if shared else self.stack[-1]))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add up the seconds of a test."""
        self.seconds[report.nodeid] += report.duration

    def lines(self) -> dict[str, dict[int, list[str]]]:
        """Return the tests of each line of each file; none for what ran on import alone."""
        data = self.coverage.get_data()
        return {
            file: {
                line: sorted(
                    {test for context in contexts for test in self.users.get(context, ())}
                )
                for line, contexts in data.contexts_by_lineno(file).items()
            }
            for file in data.measured_files()
        }


@dataclass(frozen=True, eq=False)
class Chosen:
    """Runs these tests alone, the quickest file first."""

    seconds: dict[str, float]

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Select and sort."""
        items[:] = [item for item in items if item.nodeid in self.seconds]
        total: defaultdict[Path, float] = defaultdict(float)
        for item in items:
            total[item.path] += self.seconds[item.nodeid]
        items.sort(key=lambda item: total[item.path])


class Replaced(SourceFileLoader):
    """Finds and loads one module from other source code than its file."""

    def __init__(self, fullname: str, path: str, source: str) -> None:
        super().__init__(fullname, path)
        self.source = source

    def find_spec(self, fullname: str, *_: object) -> ModuleSpec | None:
        """Take the one module."""
        if fullname != self.name:
            return None
        return importlib.util.spec_from_file_location(fullname, self.path, loader=self)

    def get_code(self, fullname: str) -> CodeType:
        """Compile the other source code."""
        return compile(self.source, self.path, "exec", dont_inherit=True)


class Room:
    """A room, its tests, and which of them run which line."""

    def __init__(self, name: str) -> None:
        os.chdir(ROOT)
        self.name = name
        kept = KEPT / f"{name}.json"
        digest = _digest(ROOT / PACKAGE, ROOT / "test" / name)
        if not kept.exists() or json.loads(kept.read_text())["digest"] != digest:
            KEPT.mkdir(parents=True, exist_ok=True)
            log = KEPT / f"{name}.log"
            print(f"{name}: measuring which test runs which line", flush=True)
            if code := in_fork(lambda: self._measure(kept, digest), 3600.0, log):
                sys.exit(f"the tests of {name} fail without any mutant ({code}), see {log}")
        measured = json.loads(kept.read_text())
        self.seconds: dict[str, float] = measured["seconds"]
        self.lines: dict[str, dict[str, list[str]]] = measured["lines"]
        for module in measured["imports"]:
            with suppress(Exception):
                importlib.import_module(module)
        path = Path(max(self.lines, key=lambda file: len(self.lines[file])))
        if self.outcome(path, path.read_text(), self.tests_of(path, 1)) != "survived":
            sys.exit(f"the tests of {name} see a mutant where there is none, see {KEPT}/trial.log")

    def _measure(self, kept: Path, digest: str) -> int:
        source = [str(ROOT / PACKAGE / self.name)]
        meter = Meter(coverage.Coverage(data_file=None, config_file=False, source=source))
        meter.coverage.start()
        code = run_pytest([f"test/{self.name}"], meter)
        meter.coverage.stop()
        files = {name: getattr(module, "__file__", "") for name, module in sys.modules.items()}
        foreign = [name for name, file in files.items() if "-packages" in (file or "")]
        if code == 0:
            found = {"digest": digest, "seconds": meter.seconds, "lines": meter.lines()}
            kept.write_text(json.dumps({**found, "imports": foreign}))
        return code

    def tests_of(self, path: Path, line: int) -> dict[str, float]:
        """Return the tests, and their seconds, that run the statement on this line of a file.

        A statement that runs on import alone concerns all that run anything in the file.
        """
        lines = self.lines.get(str(path), {})
        span = _statement(ast.parse(path.read_text()), line)
        tests = {test for n in span or map(int, lines) for test in lines.get(str(n), ())}
        if span is None and not tests:
            tests = set(self.seconds)
        chosen: dict[str, float] = {}
        for test in sorted(tests, key=lambda test: (self.seconds[test], test)):
            if sum(chosen.values()) < ENOUGH_S:
                chosen[test] = self.seconds[test]
        return chosen

    def outcome(self, path: Path, source: str, tests: dict[str, float]) -> str:
        """Return "survived", "killed", "timeout", or "untested" where there are no tests."""
        if not tests:
            return "untested"

        def trial() -> int:
            parts = path.relative_to(ROOT).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            sys.meta_path.insert(0, Replaced(name, str(path), source))
            return run_pytest(sorted({test.split("::")[0] for test in tests}), Chosen(tests))

        limit_s = PATIENCE_S + PATIENCE * sum(tests.values())
        code = in_fork(trial, limit_s, KEPT / "trial.log")
        return {None: "timeout", 0: "survived"}.get(code, "killed")


def _digest(*folders: Path) -> str:
    files = sorted(path for folder in folders for path in folder.rglob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


def _statement(tree: ast.AST, line: int) -> range | None:
    """Return the lines of the innermost statement of a function there, a block's head alone."""
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    nodes = (node for function in functions for part in function.body for node in ast.walk(part))
    heads = []
    for node in nodes:
        if isinstance(node, ast.stmt):
            body = getattr(node, "body", None)
            end = body[0].lineno if body else (node.end_lineno or 0) + 1
            heads.append(range(node.lineno, max(end, node.lineno + 1)))
    return max((head for head in heads if line in head), key=lambda h: h.start, default=None)


def run_pytest(paths: Sequence[str], plugin: object) -> int:
    """Run tests until one fails; hypothesis always tries the same examples."""
    phases = [Phase.explicit, Phase.generate]
    settings.register_profile("mutants", derandomize=True, database=None, phases=phases)
    settings.load_profile("mutants")
    options = ["-x", "-q", "-p", "no:cacheprovider", "-m", MARKERS, "--tb=short"]
    return int(pytest.main([*options, *paths], plugins=[plugin]))


def in_fork(work: Callable[[], int], limit_s: float, log: Path) -> int | None:
    """Return the exit code of ``work`` in a forked process; None if it took too long."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.setsid()
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
            with log.open("w") as output:
                os.dup2(output.fileno(), 1)
                os.dup2(output.fileno(), 2)
            code = work()
        finally:
            sys.stdout.flush()
            os._exit(code)
    end = time.monotonic() + limit_s
    ended = (0, 0)
    try:
        while ended == (0, 0) and time.monotonic() < end:
            time.sleep(0.02)
            ended = os.waitpid(child, os.WNOHANG)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)  # with all that it has started
    if ended == (0, 0):
        os.waitpid(child, 0)
        return None
    return os.waitstatus_to_exitcode(ended[1])
