"""Try a mutant on the tests that run its statement.

Which test runs which line is measured once for each folder of tests and kept in ``out/mutants/``
until code or tests change. Left out are tests marked ``slow``, ``ros`` or ``linuxcnc``, those that
fail under the meter (they want a terminal, say) and those that take longer than ``LONGEST_S``. A
mutant meets the nearest and quickest tests, ``ENOUGH_S`` of them. It lives in a fork of this
process, which has imported all but the project; no file is changed.
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
import traceback
from collections import defaultdict
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
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
BESIDE = sorted(path.parent for path in ROOT.glob("packages/*/setup.py"))
"""The folders of the packages beside the core."""
SOURCES = [ROOT / PACKAGE, *(path / path.name for path in BESIDE)]
KEPT = ROOT / "out" / "mutants"
MARKERS = "not slow and not ros and not linuxcnc"
ENOUGH_S = 20.0
"""Processor seconds that the tests of one mutant may need without it, unless stated otherwise."""
LONGEST_S = 20.0
"""Processor seconds that one test may take under the meter."""
FILE_S = 0.1
"""Processor seconds to collect a file of tests."""
PATIENCE_S, PATIENCE = 10.0, 5.0
"""A mutant is stopped after the first and so many times as long as its tests need without it."""
WAITS = 4.0
"""It may wait so many times as long as it may compute: the machine may be busy."""
MEMORY = 6 << 30
sys.path.insert(0, str(ROOT))


class Repeatable:
    """Has hypothesis always try the same examples; ``conftest.py`` has set its own by then."""

    def pytest_configure(self) -> None:
        """Set it."""
        phases = [Phase.explicit, Phase.generate]
        settings.register_profile("mutants", derandomize=True, database=None, phases=phases)
        settings.load_profile("mutants")


@dataclass(eq=False)
class Meter(Repeatable):
    """Notes which tests run which lines; what a shared fixture runs counts for all its users."""

    coverage: coverage.Coverage
    seconds: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    parts: dict[str, list[str]] = field(default_factory=dict)
    stack: list[str] = field(default_factory=lambda: [""])
    mark: float = 0.0

    def _inside(self, context: str) -> Generator[None, Any, Any]:
        self._switch()
        self.stack.append(context)
        self.coverage.switch_context(context)
        try:
            return (yield)
        finally:
            self._switch()
            self.stack.pop()
            self.coverage.switch_context(self.stack[-1])

    def _switch(self) -> None:
        now = sum(os.times()[:4])
        self.seconds[self.stack[-1]] += now - self.mark
        self.mark = now

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, Any, Any]:
        """Count for this test what runs now."""
        known = item._fixtureinfo.name2fixturedefs.values()
        shared = [_name(defs[-1]) for defs in known if defs[-1].scope != "function"]
        self.parts[item.nodeid] = [item.nodeid, *shared]
        return (yield from self._inside(item.nodeid))

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Generator[None, Any, Any]:
        """Count for the fixture what runs now."""
        shared = fixturedef.scope != "function"
        return (yield from self._inside(_name(fixturedef) if shared else self.stack[-1]))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self) -> Generator[None, Any, Any]:
        """End a test that takes too long."""
        signal.signal(signal.SIGPROF, lambda *_: pytest.fail("takes too long"))
        signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
        try:
            return (yield)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Forget a test that fails."""
        if report.failed:
            print("left out:", report.nodeid)
            self.parts.pop(report.nodeid, None)


def _name(fixturedef: Any) -> str:
    return f"{fixturedef.baseid}::{fixturedef.argname} (fixture)"


@dataclass(frozen=True, eq=False)
class Chosen(Repeatable):
    """Runs these tests alone, the first file first, and notes which one failed."""

    tests: Sequence[str]
    killer: Path

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Select and sort."""
        wanted = set(self.tests)
        files = files_of(self.tests)
        items[:] = [item for item in items if item.nodeid in wanted]
        items.sort(key=lambda item: files.index(item.nodeid.split("::")[0]))

    def pytest_runtest_logreport(self, report: pytest.TestReport | pytest.CollectReport) -> None:
        """Note which test failed, or which file of them."""
        if report.failed:
            self.killer.write_text(report.nodeid)

    pytest_collectreport = pytest_runtest_logreport


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


class Folder:
    """A folder of tests, and which of them run which line; ``top`` are those in no folder."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.data, kept = KEPT / f"{name}.coverage", KEPT / f"{name}.json"
        digest = digest_of(*SOURCES, *self._paths())
        if not kept.exists() or json.loads(kept.read_text())["digest"] != digest:
            KEPT.mkdir(parents=True, exist_ok=True)
            self.data.unlink(missing_ok=True)
            print(f"measuring which line is run by which test of {name}", flush=True)
            log = KEPT / f"{name}.log"
            code = in_fork(lambda: self._measure(kept, digest), 3600.0, log)[0]
            if code not in (0, int(pytest.ExitCode.TESTS_FAILED)):
                print(f"the tests of {name} are left out: they ended with {code}, see {log}")
                kept.write_text(json.dumps({"digest": digest, "parts": {}, "seconds": {}}))
        measured = json.loads(kept.read_text())
        self.seconds: dict[str, float] = measured["seconds"]
        self.parts: dict[str, list[str]] = measured["parts"]
        self.imports: list[str] = measured.get("imports", [])

    def _paths(self) -> list[Path]:
        return (
            sorted(Path(ROOT, "test").glob("test_*.py"))
            if self.name == "top"
            else [tests_of(self.name)]
        )

    def _measure(self, kept: Path, digest: str) -> int:
        source = [*map(str, SOURCES)]
        meter = Meter(coverage.Coverage(str(self.data), config_file=False, source=source))
        meter.coverage.start()
        code = run_pytest([str(path.relative_to(ROOT)) for path in self._paths()], meter)
        meter.coverage.stop()
        meter.coverage.save()
        files = {name: getattr(module, "__file__", "") for name, module in sys.modules.items()}
        foreign = [name for name, file in files.items() if "-packages" in (file or "")]
        found = {"digest": digest, "seconds": meter.seconds, "parts": meter.parts}
        kept.write_text(json.dumps({**found, "imports": foreign}))
        return code

    @cached_property
    def users(self) -> dict[str, set[str]]:
        """The tests that a part, a test or a shared fixture, is part of."""
        users = defaultdict(set)
        for test, parts in self.parts.items():
            for part in parts:
                users[part].add(test)
        return users

    def lines(self, path: Path) -> dict[int, set[str]]:
        """Return the tests of each line of a file; none for what ran on import alone."""
        data = coverage.CoverageData(str(self.data))
        data.read()
        found = data.contexts_by_lineno(str(path)) if self.parts else {}
        return {
            line: {test for context in contexts for test in self.users.get(context, ())}
            for line, contexts in found.items()
        }


def measure(folders: Iterable[str]) -> None:
    """See to it that what the tests of these folders run is known."""
    os.chdir(ROOT)
    for name in folders:
        Folder(name)


class Suite:
    """All tests, and which of them notice a mutant."""

    def __init__(self, folders: Iterable[str], enough_s: float = ENOUGH_S) -> None:
        os.chdir(ROOT)
        self.enough_s = enough_s
        self.folders = [Folder(name) for name in folders]
        self.parts = {test: parts for f in self.folders for test, parts in f.parts.items()}
        self.seconds = {part: s for f in self.folders for part, s in f.seconds.items()}
        self.trusted: dict[str, bool] = {"": True}
        for module in sorted({module for f in self.folders for module in f.imports}):
            with suppress(Exception):
                importlib.import_module(module)

    def tests_of(self, path: Path, line: int, first: str = "") -> list[str]:
        """Return the tests that run the statement on this line of a file, the nearest first.

        A statement that runs on import alone concerns all that run anything in the file, and the
        nearest: who makes a dataclass runs none of its lines.
        """
        span = _statement(ast.parse(path.read_text()), line)
        tests: set[str] = set()
        for folder in self.folders:
            lines = folder.lines(path)
            tests |= {test for n in span or lines for test in lines.get(n, ())}
        if span is None:
            tests |= {test for test in self.parts if not self._far(path, test)[0]}
        chosen: list[str] = []
        parts: set[str] = set()
        for test in sorted(tests, key=lambda test: (test != first, *self._far(path, test))):
            file = test.split("::")[0]
            trusted = self.trusted.get(test, True) and self.trusted.get(file, True)
            if trusted and self._needs(parts) < self.enough_s:
                chosen.append(test)
                parts |= {file, *self.parts[test]}
        return chosen

    def _far(self, path: Path, test: str) -> tuple[bool, float, str]:
        source = next(place for place in SOURCES if place in path.parents)
        package = source.name if source.parent in BESIDE else path.relative_to(source).parts[0]
        place = tests_of(package).relative_to(ROOT)
        near = test.startswith(f"{place}/") or path.stem in test.split("::")[0]
        return not near, self._needs(self.parts[test]), test

    def _needs(self, parts: Iterable[str]) -> float:
        return sum(self.seconds.get(part, FILE_S) for part in parts)

    def outcome(self, path: Path, line: int, source: str, first: str = "") -> tuple[str, str, int]:
        """Return whether it was noticed, by which test, and how many tests it might meet.

        A test that kills is tried alone and without the mutant: one that fails then, too, counts
        no more.
        """
        while tests := self.tests_of(path, line, first):
            outcome, killer = self._try(path, source, tests)
            if killer not in self.trusted:
                alone = self._try(path, path.read_text(), [killer])
                self.trusted[killer] = alone[0] == "survived"
            if self.trusted[killer]:
                return outcome, killer, len(tests)
        return "untested", "", 0

    def _try(self, path: Path, source: str, tests: list[str]) -> tuple[str, str]:
        killer = KEPT / f"{os.getpid()}.killer"
        killer.write_text("")

        def trial() -> int:
            source = next(place for place in SOURCES if place in path.parents)
            parts = path.relative_to(source.parent).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            sys.meta_path.insert(0, Replaced(name, str(path), source))
            return run_pytest(files_of(tests), Chosen(tests, killer), "-x")

        parts = {part for test in tests for part in self.parts.get(test, ())}
        needs = self._needs(parts.union(files_of(tests)))
        code, late = in_fork(trial, PATIENCE_S + PATIENCE * needs, KEPT / f"{os.getpid()}.log")
        passed = code in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)
        by = killer.read_text()
        killer.unlink()
        return "timeout" if late else "survived" if passed else "killed", by


def tests_of(package: str) -> Path:
    """Return the folder of the tests of a folder of the core, or of a package beside it."""
    beside = ROOT / "packages" / package
    return beside / "test" if beside in BESIDE else ROOT / "test" / package


def files_of(tests: Sequence[str]) -> list[str]:
    """Return the files of these tests, in their order."""
    return [*dict.fromkeys(test.split("::")[0] for test in tests)]


def digest_of(*places: Path) -> str:
    """Return what the files at these places, or the Python files below them, hold as a hash."""
    found = {path for place in places for path in [place, *place.rglob("*.py")]}
    files = sorted(path for path in found if path.is_file())
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


def run_pytest(paths: Sequence[str], plugin: object, *options: str) -> int:
    """Run tests."""
    options = ("-q", "-p", "no:cacheprovider", "-m", MARKERS, "--tb=short", *options)
    return int(pytest.main([*options, *paths], plugins=[plugin]))


def side_by_side(jobs: int, work: Callable[[int], None]) -> None:
    """Run ``work`` in so many forked processes, each with its number.

    Raises
    ------
    SystemExit
        If one of them failed; what it printed says why.

    """
    children = []
    for number in range(jobs):
        child = os.fork()
        if child == 0:
            code = 1
            try:
                work(number)
                code = 0
            except Exception:
                traceback.print_exc()
            finally:
                sys.stdout.flush()
                os._exit(code)
        children.append(child)
    codes = [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children]
    if any(codes):
        raise SystemExit(f"processes ended with {codes}")


def in_fork(work: Callable[[], int], limit_s: float, log: Path) -> tuple[int, bool]:
    """Return the exit code of ``work`` in a forked process, and whether it took too long."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.setsid()
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
            resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s), int(limit_s)))
            nowhere = os.open(os.devnull, os.O_RDONLY)
            os.dup2(nowhere, 0)
            with log.open("w") as output:
                os.dup2(output.fileno(), 1)
                os.dup2(output.fileno(), 2)
            code = work()
        finally:
            sys.stdout.flush()
            os._exit(code)
    end = time.monotonic() + WAITS * limit_s
    ended = (0, 0)
    try:
        while ended == (0, 0) and time.monotonic() < end:
            time.sleep(0.02)
            ended = os.waitpid(child, os.WNOHANG)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)  # with all that it has started
    if ended == (0, 0):
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), True
    code = os.waitstatus_to_exitcode(ended[1])
    return code, code in (-signal.SIGXCPU, -signal.SIGKILL)
