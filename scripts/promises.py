"""What other people build upon, found in the code; docs/compatibility.json is what was promised.

usage: python scripts/promises.py            say what is no longer as promised; exit code 1 then
       python scripts/promises.py --write    promise what there is now: new things, or a new major

Needs rotcal_msgs for the hashes of messages, and all packages beside the core.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import io
import json
import os
import re
import runpy
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import redirect_stdout
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import click

import rotcal_ros as rc
from rotcal_ros.bags import names
from rotcal_ros.cli.main import rotcal
from rotcal_ros.compensation import plain_csv
from rotcal_ros.foundation import errors
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods.settings_reference import all_sections, kind_in_words
from rotcal_ros.report.terminal.tables import print_result

ROOT = Path(__file__).resolve().parents[1]
RECORD = ROOT / "docs" / "compatibility.json"
BESIDE = sorted(path.parent.name for path in ROOT.glob("packages/*/setup.py"))
PUBLISHES, SERVES = ("create_publisher", "_instrument"), ("offer", "ActionServer")
NOT_OF_A_CELL = ("check", "player", "client")
"""Folders of nodes whose topics are their own, or those of a bag."""
CODE = re.compile("`([^`]+)`")
Promises = dict[str, Any]


def promises() -> Promises:
    """Return kind of promise -> name -> what holds of it, all of them sorted."""
    found: dict[str, Callable[[], Promises]] = {
        "messages": messages,
        "topics": lambda: {role: set() for role in names.ROLES} | _spoken(PUBLISHES),
        "services and actions": lambda: _spoken(SERVES), "settings": settings,
        "verbs": lambda: dict(verbs(rotcal, "rotcal")), "exit codes": exit_codes,
        "result.json": result_fields, "columns of CSV": columns, "entry points": entry_points,
        "Python": python_names,
    }  # fmt: skip
    whole = {kind: make() for kind, make in found.items()}
    sorted_text = json.dumps(whole, sort_keys=True, default=sorted)
    return dict(json.loads(sorted_text))


def broken(promised: Any, found: Any, place: str = "") -> Iterator[str]:
    """Yield what was promised and is not found; what is new breaks nothing."""
    if isinstance(promised, dict):
        for name, value in promised.items():
            where = f"{place}: {name}" if place else name
            if name not in found:
                yield f"{where} is gone"
            else:
                yield from broken(value, found[name], where)
    elif isinstance(promised, list):
        yield from (f"{place}: {name} is gone" for name in promised if name not in found)
    elif promised != found:
        yield f"{place} was {promised}, and is {found}"


def messages() -> Promises:
    """Return the hash of each message, service and action, and the constants, which it lacks."""
    os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)  # as of an activated environment
    from rotcal_ros.nodes.runtime.message_types import installed_hash

    found = {}
    for path in sorted((ROOT / "msg_defs").glob("*/*.*")):
        name = f"rotcal_msgs/{path.parent.name}/{path.stem}"
        lines = (line.partition("#")[0].strip() for line in path.read_text().splitlines())
        parted = (line.partition("=") for line in lines if "=" in line)
        constants = {
            left.split()[1]: value.strip() for left, _, value in parted if left.split()[1:]
        }
        found[name] = {"hash": installed_hash(name), "constants": constants}
    return found


def _spoken(calls: Iterable[str]) -> Promises:
    """Return topic -> types and qualities of service as the code of the nodes has them."""
    found: Promises = {}
    nodes = [*ROOT.glob("rotcal_ros/nodes/**/*.py"), *ROOT.glob("packages/*/*/node*/**/*.py")]
    for path in [*nodes, *ROOT.glob("packages/*/*/node.py")]:
        if path.relative_to(ROOT).parts[2] in NOT_OF_A_CELL:
            continue
        tree = ast.parse(path.read_text())
        constants = {
            target.id: node.value
            for node in tree.body
            if isinstance(node, ast.Assign | ast.AnnAssign)
            for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
            if isinstance(target, ast.Name)
        }
        for call in filter(lambda node: isinstance(node, ast.Call), ast.walk(tree)):
            words = [ast.unparse(word) for word in call.args if ast.unparse(word) != "self"]
            if ast.unparse(call.func).rpartition(".")[2] in calls and len(words) > 2:
                kind, place, quality = words[0].rpartition(".")[2], *words[1:3]
                node = constants.get(place)
                text = ast.literal_eval(node) if node is not None else _named(place)
                if text is not None:
                    quality = quality if quality.isupper() else ""
                    found.setdefault(text, set()).add(
                        f"{kind.rpartition('.')[2]} {quality}".strip()
                    )
    return found


def _named(place: str) -> str | None:
    """Return the text of a literal or of a name of a bag; None for what a configuration says."""
    if place.startswith("names."):
        return str(getattr(names, place.removeprefix("names.")))
    return str(ast.literal_eval(place)) if re.fullmatch("(['\"]).*\\1", place) else None


def settings() -> Promises:
    """Return ``group.name`` -> method -> kind of value."""
    found: Promises = {}
    for section in all_sections():
        for name, declared in section.settings():
            kinds = found.setdefault(name if section.group else f"goal: {name}", {})
            kinds[section.method or "all"] = kind_in_words(declared)
    return found


def verbs(command: click.Command, name: str) -> Iterator[tuple[str, Any]]:
    """Yield each verb with the names of its options and arguments."""
    context = click.Context(command)
    if isinstance(command, click.Group):
        for below in command.list_commands(context):
            inner = command.get_command(context, below)
            if inner is not None:
                yield from verbs(inner, f"{name} {below}")
    else:
        yield name, {opt for option in command.params for opt in option.opts}


def exit_codes() -> Promises:
    """Return error -> exit code."""
    found = inspect.getmembers(errors, inspect.isclass)
    return {n: c.exit_code for n, c in found if issubclass(c, errors.RotcalError)}


def result_fields() -> Promises:
    """Return field -> methods -> shape and unit."""
    found: Promises = {}
    for field in runpy.run_path(str(ROOT / "scripts" / "result_schema.py"))["documented"]():
        for method in field.methods or ("all",):
            found.setdefault(field.path, {})[method] = f"{field.shape} {field.unit}".strip()
    return found


def columns() -> Promises:
    """Return the columns of plain tables that are read, and of what ``rotcal solve`` prints."""
    page = (ROOT / "docs" / "formats.md").read_text().partition("## A map of columns")[0]
    read = {text for line in page.splitlines() if line[:1] == "|" for text in CODE.findall(line)}
    found: Promises = {"read": read, "of csv": set(plain_csv.OWN_STD.split(","))}
    for path in sorted(ROOT.glob("test/golden/*/table/result.json")):
        with redirect_stdout(io.StringIO()) as text:
            print_result(Result.from_dict(json.loads(path.read_text())))
        found[f"printed: {path.parents[1].name}"] = set(text.getvalue().split("\n")[0].split(","))
    return found


def entry_points() -> Promises:
    """Return group -> names, of the core and of the packages beside it."""
    found: Promises = {}
    for package in ("rotcal_ros", *BESIDE):
        for point in distribution(package).entry_points:
            found.setdefault(point.group, set()).add(point.name)
    return found


def python_names() -> Promises:
    """Return name of the interface -> its parameters, or the public names in it."""
    found: Promises = {}
    for name in dir(rc):
        thing = getattr(rc, name)
        if inspect.isroutine(thing):
            found[name] = _parameters(thing)
        elif inspect.isclass(thing) or inspect.ismodule(thing):
            found[name] = {"holds": {n for n in _held(thing) if not n.startswith("_")}}
        else:
            found[name] = {}
    return found


def _held(thing: Any) -> Iterator[str]:
    """Yield the names in a module that it lists, or in a class and those of ours above it."""
    if inspect.ismodule(thing):
        yield from thing.__all__
    else:
        for above in inspect.getmro(thing):
            if above.__module__.startswith("rotcal_"):
                yield from (*vars(above), *getattr(above, "__dataclass_fields__", ()))


def _parameters(function: Callable[..., Any]) -> Promises:
    """Return which parameters a function needs, and which it may be given."""
    given = inspect.signature(function).parameters.values()
    needed = [p.name for p in given if p.default is p.empty and p.kind is not p.VAR_KEYWORD]
    return {"needs": ", ".join(needed), "may have": {p.name for p in given} - set(needed)}


def main() -> int:
    """Compare the code with the record, or write that."""
    parser = argparse.ArgumentParser(description="What is promised, and is it kept?")
    parser.add_argument("--write", action="store_true", help="promise what there is now")
    found = promises()
    if parser.parse_args().write:
        parts = (
            f"{json.dumps(kind)}: {{\n"
            + ",\n".join(f" {json.dumps(n)}: {json.dumps(v)}" for n, v in held.items())
            + "\n}"
            for kind, held in found.items()
        )
        RECORD.write_text("{\n" + ",\n".join(parts) + "\n}\n")
        return 0
    lines = list(broken(json.loads(RECORD.read_text()), found))
    print("\n".join(lines) or "all promises are kept")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
