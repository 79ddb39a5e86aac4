"""Prints the JSON Schema of results, from the tables of docs/result_json.md and from the code.

The page states field, shape, unit and meaning; names that a field chooses among, and the group
identity, come from the dataclasses. The keyword ``unit`` is an annotation of our own.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, get_args

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.identity import Identity, InstrumentIdentity, Instruments
from rotcal_ros.foundation.protection import ALL_EFFECTS, TREATMENTS
from rotcal_ros.foundation.results import COUNTS_FROM, SCHEMA, Verdict

PAGE = Path(__file__).parents[1] / "docs" / "result_json.md"
KINDS: dict[str, Any] = {
    "number": "number", "whole": "integer", "text": "string", "flag": "boolean",
    "argument": ["number", "string", "boolean", "object"],
}  # fmt: skip
ISO, NAME = "ISO", "NAME"
"""Parts of a path that stand for several names: deviations, and any."""
CHOICES: dict[str, Iterable[Any]] = {
    "schema": (SCHEMA,),
    "verdict": get_args(Verdict),
    "zeros.within": get_args(Verdict),
    "zeros.counts_from": COUNTS_FROM,
    "not_protected": ALL_EFFECTS,
    "protections[].effect": ALL_EFFECTS,
    "protections[].treatment": TREATMENTS,
    "residuals.coordinates": (1, 3),
    "residuals.unit": ("m", "rad"),
    "ways[].verdict": get_args(Verdict),
    "links[].component": COMPONENTS,
}
"""Values of fields that have only a few."""


@dataclass(frozen=True)
class Field:
    """One field of the page; ``methods`` whose details have it, none: of every result."""

    methods: tuple[str, ...]
    path: str
    shape: str
    unit: str
    when: str
    meaning: str

    def schema(self) -> dict[str, Any]:
        """Return the schema of its value."""
        shape, missing = re.fullmatch(r"(.*?)( or null| with null|)", self.shape).groups()
        *sizes, kind = shape.split() if shape.split()[-1] in KINDS else [*shape.split(), "number"]
        found: dict[str, Any] = {"type": KINDS[kind]}
        if choices := CHOICES.get(self.path):
            found["enum"] = list(choices)
        if missing == " with null":
            found["type"] = [found["type"], "null"]
        for size in reversed(sizes):
            exact = {"minItems": int(size), "maxItems": int(size)} if size.isdigit() else {}
            found = {"type": "array", "items": found, **exact}
        if missing == " or null":
            found["type"] = [found["type"], "null"]
        when = f" ({self.when})" if self.when else ""
        return {"description": f"{self.meaning}{when}", **self._unit(), **found}

    def _unit(self) -> dict[str, str]:
        return {"unit": self.unit} if self.unit else {}


def documented() -> list[Field]:
    """Return all fields of the page, in its order."""
    found, methods = list[Field](), tuple[str, ...]()
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("### "):
            methods = tuple(re.findall("`([a-z_]+)`", line))
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("| `") and len(cells) == 5:
            paths = [path.strip(" `") for path in cells[0].split(",")]
            found += [Field(methods, path, *cells[1:]) for path in paths]
    return found


def schema() -> dict[str, Any]:
    """Return the whole schema."""
    every, own = documented(), dict[str, list[Field]]()
    for field in every:
        for method in field.methods:
            own.setdefault(method, []).append(field)
    shared = [field for field in every if not field.methods]
    whole = _object((field.path, field) for field in shared)
    whole["properties"]["details"] = {"type": "object", "description": "the method's own"}
    identity = whole["properties"]["circumstances"]["properties"]
    identity["identity"] = _identity()
    always = [field.path for field in shared if not field.when]
    whole["required"] = sorted(
        {path.split(".")[0] for path in always} | {"details", "protections"}
    )
    whole["allOf"] = [
        {
            "if": {"properties": {"method": {"const": method}}},
            "then": {"properties": {"details": {"$ref": f"#/$defs/{method}"}}},
        }
        for method in own
    ]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "result.json of rotcal",
        "description": "SI; made by scripts/result_schema.py from docs/result_json.md.",
        **whole,
        "$defs": {
            method: _object((field.path, field) for field in mine) for method, mine in own.items()
        },
    }


def _object(paths: Iterable[tuple[str, Field]]) -> dict[str, Any]:
    """Return the schema of an object whose fields have these paths below it."""
    below = dict[str, list[tuple[str, Field]]]()
    for path, field in paths:
        name, _, rest = path.partition(".")
        below.setdefault(name, []).append((rest, field))
    properties, found = dict[str, Any](), {"type": "object", "additionalProperties": False}
    for name, inside in below.items():
        inner = inside[0][1].schema() if not inside[0][0] else _object(inside)
        if name.endswith("[]"):
            inner = {"type": "array", "items": inner}
        if name.endswith("?"):
            inner["type"] = ["object", "null"]
        if name.rstrip("[]") in (ISO, NAME):
            found["additionalProperties"] = inner
            if name.startswith(ISO):
                found["propertyNames"] = {"enum": list(COMPONENTS)}
        else:
            properties[name.rstrip("[]?")] = inner
    return {**found, "properties": properties} if properties else found


def _identity() -> dict[str, Any]:
    """Return the schema of the group identity, from its declarations."""
    instrument = _group(InstrumentIdentity)
    names = {field.name: instrument for field in fields(Instruments)}
    whole = _group(Identity)
    whole["properties"]["instruments"] = {
        "type": "object", "additionalProperties": False, "properties": names,
    }  # fmt: skip
    return whole


def _group(cls: type[Any]) -> dict[str, Any]:
    return {"type": "object", "additionalProperties": False, "properties": dict(_settings(cls))}


def _settings(cls: type[Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for field in fields(cls):
        if info := field.metadata.get("setting"):
            kind = "number" if isinstance(field.default, float) else "string"
            yield field.name, {"description": info.description, "type": kind}


def text() -> str:
    """Return the file."""
    return json.dumps(schema(), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    print(text(), end="")
