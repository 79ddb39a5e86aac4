"""Put small faults into the code, one by one, and see whether the tests notice.

mutmut makes the mutants: of functions with decorators and of constants too, which its own runner
cannot try. Left out are those that put None for a value (they crash and show nothing), those in
the words of an error or of another sentence, and those of ``strict=``, ``dtype=np.float64``, type
aliases, the names of indices in ``einsum`` and the -1 of ``reshape`` (any negative number says the
same), which change nothing. A uniform random sample of the rest is tried, as ``mutant_trials.py``
says.
"""

from __future__ import annotations

import argparse
import difflib
import json
import math
import os
import random
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import libcst as cst
import libcst.matchers as m
from libcst.metadata import MetadataWrapper, PositionProvider
from mutant_trials import (
    BESIDE,
    ENOUGH_S,
    PACKAGE,
    ROOT,
    SOURCES,
    Suite,
    digest_of,
    measure,
    side_by_side,
    tests_of,
)
from mutmut.mutation.file_mutation import MutationVisitor, deep_replace
from mutmut.mutation.mutators import mutation_operators
from mutmut.mutation.pragma_handling import IgnoredCode

OTHERS = [path.name for path in BESIDE]
PACKAGES = [
    *sorted(path.parent.name for path in Path(ROOT, PACKAGE).glob("*/__init__.py")), *OTHERS, "top"
]  # fmt: skip
"""The folders of the core, the packages beside it, and ``top`` for the files in none of them."""
FOLDERS = [
    *sorted({path.parent.name for path in Path(ROOT, "test").glob("*/test_*.py")}), *OTHERS, "top"
]  # fmt: skip
"""The folders of tests, and ``top`` likewise."""
CHANGES_NOTHING = re.compile(r",\s*(?:strict=\w+|dtype=np\.float64|(?=\)))")
INDICES = re.compile(r'"[a-z.,]+->[a-z.]*"')
"""The text of an ``einsum``, all in lower case: in upper case it says the same."""
DUMB = (
    m.Raise()
    | m.Subscript(m.Name("Literal"))
    | m.Assign([m.AssignTarget(m.Name("__all__"))])
    | m.Arg(keyword=m.Name("strict"))
)
"""Nodes whose parts are words for people or names for tools, or a check that never speaks up."""
RESHAPE = m.Call(m.Attribute(attr=m.Name("reshape")))
OPEN_SIZE = m.Arg(m.UnaryOperation(m.Minus(), m.Integer("1")))
OPERATORS = [
    (kind, make)
    for kind, make in mutation_operators
    if make.__name__ not in ("operator_assignment", "operator_dict_arguments")
]


@dataclass(frozen=True, eq=False)
class Mutant:
    """One fault: where it is, in which text, before, after, and the whole file with it."""

    package: str
    path: Path
    line: int
    text: str
    before: str
    after: str
    mutated: Callable[[], str]

    @property
    def key(self) -> tuple[str, ...]:
        """What distinguishes it from others; not the number of its line, which may move."""
        return str(self.path.relative_to(ROOT)), self.text, self.before, self.after

    def diff(self) -> str:
        """Return the lines that differ."""
        old, new = self.path.read_text().splitlines(), self.mutated().splitlines()
        return "\n".join([*difflib.unified_diff(old, new, n=0, lineterm="")][3:])


class Collector(MutationVisitor):
    """Collects the mutations of a file and their lines, of functions with decorators too."""

    def __init__(self) -> None:
        super().__init__(OPERATORS, IgnoredCode(set(), set(), set()))
        self.lines: list[int] = []
        self.open_sizes: set[cst.CSTNode] = set()

    def on_visit(self, node: cst.CSTNode) -> bool:
        """Note on which line the mutations of a node begin; pass by what cannot be felt."""
        if m.matches(node, DUMB) or node in self.open_sizes:
            return False
        if isinstance(node, cst.Call) and m.matches(node, RESHAPE):
            sizes = (arg.value for arg in node.args if m.matches(arg, OPEN_SIZE))
            self.open_sizes |= {cst.ensure_type(s, cst.UnaryOperation).expression for s in sizes}
        deeper = super().on_visit(node)
        if new := len(self.mutations) - len(self.lines):
            self.lines += [self.get_metadata(PositionProvider, node).start.line] * new
        return deeper

    def _skip_node_and_children(self, node: cst.CSTNode) -> bool:
        return not isinstance(node, cst.FunctionDef) and super()._skip_node_and_children(node)


def mutants_of(package: str, path: Path) -> Iterator[Mutant]:
    """Yield all mutants of a file that may show something."""
    collector = Collector()
    source = path.read_text()
    module = MetadataWrapper(cst.parse_module(source)).visit(collector)
    texts = [text.strip() for text in source.splitlines()]
    for mutation, line in zip(collector.mutations, collector.lines, strict=True):
        old, new = mutation.original_node, mutation.mutated_node
        before, after = module.code_for_node(old), module.code_for_node(new)
        if (
            (isinstance(old, cst.SimpleString) and " " in before)
            or (INDICES.fullmatch(before) and after == before.upper())
            or CHANGES_NOTHING.sub("", before) == CHANGES_NOTHING.sub("", after)
            or (isinstance(old, cst.Call) and _same_but_none(old, new))
        ):
            continue

        def mutated(old: cst.CSTNode = old, new: cst.CSTNode = new) -> str:
            whole = deep_replace(module, old, new)
            assert isinstance(whole, cst.Module)
            return whole.code

        yield Mutant(package, path, line, texts[line - 1], before, after, mutated)


def _same_but_none(old: cst.Call, new: cst.CSTNode) -> bool:
    return isinstance(new, cst.Call) and new.func is old.func and len(new.args) == len(old.args)


def files_of(package: str) -> list[Path]:
    """Return the files of a package."""
    whole = Path(ROOT, PACKAGE)
    place = ROOT / "packages" / package if package in OTHERS else whole
    return sorted(whole.glob("*.py") if package == "top" else Path(place, package).rglob("*.py"))


def folders_for(packages: Sequence[str]) -> list[str]:
    """Return the folders of tests that name one of the packages; all of them for all packages."""
    names = tuple(p if p in OTHERS else f"{PACKAGE}.{p}" for p in packages)

    def concerned(folder: str) -> bool:
        texts = (path.read_text() for path in tests_of(folder).rglob("*.py"))
        return folder in packages or any(name in text for text in texts for name in names)

    return [folder for folder in FOLDERS if "top" in (folder, *packages) or concerned(folder)]


def choose(
    packages: Sequence[str], seed: int, count: int, again: dict[tuple[str, ...], str] | None
) -> tuple[int, list[Mutant]]:
    """Return how many mutants there are, and those to try: a sample, or those tried before."""
    found = [
        mutant
        for package in packages
        for path in files_of(package)
        for mutant in mutants_of(package, path)
    ]
    if again is None:
        return len(found), random.Random(seed).sample(found, min(count, len(found)))
    random.Random(seed).shuffle(found)
    return len(found), [mutant for mutant in found if mutant.key in again]


def main() -> None:
    """Try the mutants and report: shares on the terminal, every mutant in the file."""
    parser = argparse.ArgumentParser(description="See which small faults the tests notice.")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sample", type=int, default=400)
    parser.add_argument("--package", choices=PACKAGES, action="append", help="all when not given")
    parser.add_argument("--again", type=Path, help="try the mutants of this report instead")
    parser.add_argument("--survivors", type=Path, help="try those that survived in this report")
    parser.add_argument("--minutes", type=float, help="stop the sample after so long")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument(
        "--enough-s", type=float, default=ENOUGH_S, help="of tests for each mutant"
    )
    parser.add_argument("--output", type=Path, default=ROOT / "out" / "mutants.json")
    given = parser.parse_args()
    packages, former = given.package or PACKAGES, given.again or given.survivors
    killers = None if former is None else killers_of(former, survivors_only=not given.again)
    total, chosen = choose(packages, given.seed, given.sample, killers)
    print(f"{total} mutants, {len(chosen)} of them are tried", flush=True)
    folders, start = folders_for(packages), time.monotonic()
    side_by_side(given.jobs, lambda number: measure(folders[number :: given.jobs]))
    suite = Suite(folders, given.enough_s)
    given.output.parent.mkdir(parents=True, exist_ok=True)
    code = digest_of(*SOURCES, ROOT / "test", *(path / "test" for path in BESIDE))[
        :8
    ]  # of other code nothing counts
    notes = given.output.with_suffix(f".{code}.jsonl")
    end = start + 60.0 * (given.minutes or math.inf)
    rest = left(chosen, notes)
    side_by_side(
        given.jobs, lambda number: attempt(suite, rest[number :: given.jobs], killers, end, notes)
    )
    noted = {tuple(entry["key"]): entry for entry in read(notes)}
    tried = [noted[mutant.key] for mutant in chosen if mutant.key in noted]
    of_room = {
        package: [entry for entry in tried if entry["package"] == package] for package in packages
    }
    report = {
        "seed": given.seed,
        "mutants": total,
        "seconds": round(time.monotonic() - start),
        "packages": {package: share(entries) for package, entries in of_room.items() if entries},
        "overall": share(tried),
        "tried": tried,
    }
    given.output.write_text(json.dumps(report, indent=1))
    notes.unlink()
    for name, row in [*report["packages"].items(), ("overall", report["overall"])]:
        print(f"{name:18}", *(f"{key} {value:<6}" for key, value in row.items()))
    print(f"{report['seconds']} s; every mutant stands in {given.output}")


def left(chosen: Sequence[Mutant], notes: Path) -> list[Mutant]:
    """Return the mutants that an interrupted run of the same output has not tried."""
    known = {tuple(entry["key"]) for entry in read(notes)}
    if known:
        print(f"goes on after {len(known)} that {notes} holds", flush=True)
    return [mutant for mutant in chosen if mutant.key not in known]


def read(notes: Path) -> list[dict[str, Any]]:
    """Return what has been tried so far."""
    return [json.loads(line) for line in notes.read_text().splitlines()] if notes.exists() else []


def attempt(
    suite: Suite,
    mutants: Sequence[Mutant],
    killers: dict[tuple[str, ...], str] | None,
    end: float,
    notes: Path,
) -> None:
    """Try mutants until the time is over and note each one at once, for a run that is stopped."""
    for mutant in mutants:
        if time.monotonic() > end:
            break
        killer = (killers or {}).get(mutant.key, "")
        outcome, by, tests = suite.outcome(mutant.path, mutant.line, mutant.mutated(), killer)
        place = f"{mutant.key[0]}:{mutant.line}"
        entry: dict[str, Any] = {
            "package": mutant.package,
            "place": place,
            "outcome": outcome,
            "by": by,
        }
        entry |= {"tests": tests, "diff": mutant.diff(), "key": mutant.key}
        with notes.open("a") as file:
            file.write(json.dumps(entry) + "\n")
        if outcome in ("survived", "untested"):
            print(f"{place}  met {tests} tests\n{mutant.diff()}", flush=True)


def killers_of(report: Path, survivors_only: bool) -> dict[tuple[str, ...], str]:
    """Return the tests that killed the mutants of an earlier report, which are tried first."""
    tried = json.loads(report.read_text())["tried"]
    alive = ("survived", "untested")
    wanted = [entry for entry in tried if entry["outcome"] in alive or not survivors_only]
    return {tuple(entry["key"]): entry["by"] for entry in wanted}


def share(tried: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Return counts, the share killed and its standard error in percent.

    Who never ends counts as killed; "met" is the share of those that met a test at all.
    """
    counts = Counter(entry["outcome"] for entry in tried)
    dead, n = counts["killed"] + counts["timeout"], len(tried)
    return {
        **{name: counts[name] for name in ("killed", "timeout", "survived", "untested")},
        "percent": round(100 * dead / n, 1),
        "error": round(100 * math.sqrt(dead * (n - dead) / n**3), 1),
        "met_percent": round(100 * dead / max(n - counts["untested"], 1), 1),
    }


if __name__ == "__main__":
    main()
