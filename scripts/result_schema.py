"""Prints the JSON Schema of results, from result_fields.csv and from the code.

The table states field, shape, unit and meaning, and becomes those of docs/result_json.md; names
that a field chooses among, and the group identity, come from the dataclasses. The keyword
``unit`` is an annotation of our own.
"""

from __future__ import annotations

import csv
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

FIELDS = Path(__file__).with_name("result_fields.csv")
HERE = "<!-- `make docs` puts the fields of {} here -->"
"""Where the page has their tables."""
HEAD = "| field | shape | unit | when | meaning |\n| --- | --- | --- | --- | --- |\n"
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
    """Return all fields, in their order."""
    return [
        Field(tuple(row["methods"].split()), path, *_rest(row))
        for row in _rows()
        for path in row["fields"].split(", ")
    ]


def filled(page: str) -> str:
    """Return the page with the tables of the fields; ValueError where it has no place for them."""
    parts = dict[str, list[str]]()
    for row in _rows():
        names = ", ".join(f"`{path}`" for path in row["fields"].split(", "))
        line = f"| {' | '.join([names, *_rest(row)])} |\n"
        parts.setdefault(row["methods"], [HEAD]).append(line)
    every = "".join(parts.pop(""))
    details = "\n".join(
        f"### {', '.join(f'`{name}`' for name in methods.split())}\n\n{''.join(lines)}"
        for methods, lines in parts.items()
    )
    for what, text in {"every result": every, "details": details}.items():
        place = HERE.format(what)
        if place not in page:
            raise ValueError(f"result_json.md has no line {place}")
        page = page.replace(place, text)
    return page


def _rows() -> list[dict[str, str]]:
    with FIELDS.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _rest(row: dict[str, str]) -> tuple[str, str, str, str]:
    return row["shape"], row["unit"], row["when"], row["meaning"]


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
        "description": "SI; made by scripts/result_schema.py.",
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
