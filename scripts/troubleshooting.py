"""Prints a page of what errors say, and the part of them that says what to do; see `make docs`.

The texts are those of all errors of the package's own kinds, as they stand in the source.
"""

from __future__ import annotations

import ast
import builtins
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "rotcal_ros"
GROUPS = (
    ("Starting, running, attaching", "running.md", (
        "sessions/", "nodes/", "cli/attach", "foundation/middleware", "foundation/plugins",
    )),
    ("Machine and instruments", "interfaces.md#why-nothing-is-accepted", (
        "capture/", "rotcal_ipp_dme/", "nodes/instrument_driver",
        "nodes/table_adapter", "methods/simulat", "methods/added_errors",
    )),
    ("Bags, tables, replay", "recording.md#checking-and-repairing", (
        "bags/", "recordings/", "foundation/table_forms",
        "foundation/table", "rotcal_tables/sheets", "foundation/untrusted",
        "methods/measurements", "rotcal_history/fleet", "nodes/player", "cli/replay",
    )),
    ("Plans", "planning.md", ("planning/", "rotcal_design/", "cli/plan")),
    ("Laser tracer", "tracer.md", ("methods/tracer/",)),
    ("Laser tracer at three places", "tracer_six.md", ("methods/tracer_six/",)),
    ("Ball plate", "ball_plate.md", ("methods/ball_plate/",)),
    ("Plane mirror", "plane_mirror.md", ("methods/plane_mirror/",)),
    ("Controller tables and the feed", "compensation.md", (
        "compensation/", "rotcal_controllers/", "cli/export",
    )),
    ("Comparing and reporting", "evaluation.md", (
        "evaluation/", "report/", "rotcal_history/certificate", "page/", "rotcal_tables/",
        "cli/report",
    )),
    ("Configuration and everything else", "settings.md", ("",)),
)  # fmt: skip
"""Headings, the page that explains more, and the beginnings of the files that belong there."""
HEAD = """# Troubleshooting

Search this page (Ctrl-F) for some words of the error; `<...>` is what differs. The right
column says what to do. Three kinds of errors are not listed, because they need no list:

* `expected ...` says what is right at the place that is named: correct it there.
* What the operating system refuses, such as a full disk, is said in its own words.
* A text that only states a fact, such as `the table has no rows`, is the whole reason.

First aid: `rotcal doctor` looks at the machine, `rotcal cell check` at the cell, `rotcal bag
check` at a bag. Why nothing is accepted: [interfaces](interfaces.md#why-nothing-is-accepted).
Other questions: [FAQ](faq.md).
"""
VERBS = (
    "accept add allow announce apply apt ask attach average begin bring call change check "
    "choose close compare confirm continue copy correct delete derive describe do drop end "
    "enlarge exchange export feed find free give go install join keep leave let list look lower "
    "make mark measure mend mount move name offer open order pip put raise read record remove "
    "rename repair repeat replace reset restart restore resume run select send set sign "
    "solve source split start state stop swap take test try turn unpack unset update use wait "
    "widen write"
)
CALLED = "attach|bag|plan|report|run|settings|solve|verify"
_BEGIN = rf"(?!set-up|run <)(?:{'|'.join(VERBS.split())}|'?rotcal (?:{CALLED}))"
CURE = re.compile(rf"(?<=[:;,.?]) (?=(?:first )?{_BEGIN}\b)", re.IGNORECASE)
"""Where a text begins to say what to do: a clause that begins with a verb."""
COMMAND = re.compile(r"(pip install \S+|'rotcal [^']+')")
SPECIAL = re.compile(r"[^\s()'\"]*[<_*|][^\s)'\"]*[^\s)'\".,;:]|<[^>]*>")
"""Words that are no prose: of settings, options, placeholders."""
GLUED = re.compile(r"(?<=[\w)])<[^>]*>$")
"""More advice, which not every case has."""
NAMES = {"error": "reason", "strerror": "reason", "e": "reason", "self": "value"}


class Refusal(NamedTuple):
    """What an error says, and what to do about it."""

    says: str
    cure: str


def page() -> str:
    """Return the text of the page."""
    return HEAD + "".join(_section(*group) for group in _grouped())


def refusals(source: str) -> Iterator[Refusal]:
    """Yield the errors of a module that say what to do, in the order of their lines."""
    tree = ast.parse(source)
    known = dict(_constants(tree))
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and _is_error(node)]
    for call in sorted(calls, key=lambda node: node.lineno):
        for text in _texts(call.args[0], known) if call.args else ():
            says, *cure = CURE.split(text, maxsplit=1)
            if cure and _letters(says):
                yield Refusal(says.rstrip(":;,. "), GLUED.sub("", cure[0].strip()))


def _grouped() -> Iterator[tuple[str, str, list[Refusal]]]:
    places = {path: path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py")}
    beside = (ROOT / "packages").glob("*/rotcal_*/**/*.py")
    places |= {path: "/".join(path.relative_to(ROOT).parts[2:]) for path in beside}
    known = [beginning for *_, beginnings in GROUPS for beginning in beginnings]
    nearest = {f: max(filter(place.startswith, known), key=len) for f, place in places.items()}
    for title, more, beginnings in GROUPS:
        here = [file for file in sorted(places) if nearest[file] in beginnings]
        found = (r for file in here for r in refusals(file.read_text(encoding="utf-8")))
        yield title, more, sorted(set(found), key=_order)


def _order(refusal: Refusal) -> tuple[str, Refusal]:
    return _letters(refusal.says), refusal


def _letters(text: str) -> str:
    """Return the letters that do not differ from case to case."""
    return re.sub(r"<[^>]*>|[^a-z ]", "", text.lower()).strip()


def _section(title: str, more: str, found: Iterable[Refusal]) -> str:
    rows = "".join(f"| {_code(r.says)} | {_prose(r.cure)} |\n" for r in found)
    link = f"[{more.partition('.')[0].replace('_', ' ')}]({more})"
    return f"\n## {title}\n\nMore: {link}.\n\n| it says | do this |\n| --- | --- |\n{rows}"


def _code(text: str) -> str:
    return f"`{text.replace('`', chr(39)).replace('|', chr(92) + '|')}`"


def _prose(text: str) -> str:
    """Set commands in code, and words that Markdown would take for something else."""
    parts = COMMAND.split(text)  # every second one is a command
    parts[1::2] = (_code(part[1:-1] if part[0] == "'" else part) for part in parts[1::2])
    parts[::2] = (SPECIAL.sub(lambda m: _code(m[0]), part) for part in parts[::2])
    return "".join(parts)


def _is_error(call: ast.Call) -> bool:
    name = _name(call.func)
    return name.endswith("Error") and not hasattr(builtins, name)


def _constants(tree: ast.Module) -> Iterator[tuple[str, str]]:
    for node in tree.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.value, ast.Constant):
            yield _name(node.target), str(node.value.value)


def _texts(node: ast.expr, known: dict[str, str]) -> list[str]:
    """Return what an expression can say; none when it is no text."""
    if isinstance(node, ast.IfExp):
        return [*_texts(node.body, known), *_texts(node.orelse, known)]
    if isinstance(node, ast.BinOp):
        before, after = _texts(node.left, known), _texts(node.right, known)
        return [a + b for a in before or ["<...>"] for b in after or ["<...>"]]
    if isinstance(node, ast.JoinedStr):
        return [re.sub(r"\s+", " ", "".join(_piece(value, known) for value in node.values))]
    return [node.value] if isinstance(node, ast.Constant) and isinstance(node.value, str) else []


def _piece(node: ast.expr, known: dict[str, str]) -> str:
    """Return a part of an f-string: its text, a constant of the module, or a placeholder."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    assert isinstance(node, ast.FormattedValue)
    name = _name(node.value)
    placeholder = NAMES.get(name, name).strip("_").lower()
    return known.get(name, f"<{placeholder if len(placeholder) > 1 else '...'}>")


def _name(node: ast.expr) -> str:
    """Return the name that says most about an expression; "" for none."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        return node.attr
    if isinstance(node, ast.Subscript):
        return _name(node.value)
    if isinstance(node, ast.Call) and node.args:
        return _name(node.args[0])
    if isinstance(node, ast.Call):  # of a method: what it is called on
        return _name(node.func.value if isinstance(node.func, ast.Attribute) else node.func)
    return ""


if __name__ == "__main__":
    print(page(), end="")
