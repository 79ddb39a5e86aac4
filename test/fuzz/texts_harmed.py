"""Harm to texts that knows their form: YAML, JSON, journals, tables and controllers' files."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Sequence
from random import Random
from typing import Any, Final

import yaml
from mutations import HOSTILE, harmed_bytes, harmed_tree

_YAML: Final = (b"&a ", b"*a", b"<<: *a\n", b"!!python/object:os.system ", b"? ", b"- - - ", b"{",
                b"[" * 300, b"[", b": ", b"\t", b"%YAML 9.9\n", b"---\n", b"...\n", b"|\n", b">\n",
                b"0x" + b"f" * 6000, b"1_0", b"190:20:30", b".inf", b".nan", b"~", b"2001-99-99",
                b"!!binary x", b"!!timestamp x", b"!!int x", b"!!float ''", b"!!bool x",
                b"!!set {a}", b"!!omap [a: 1]", b"9" * 5000, b"\xef\xbb\xbf", b"\x85", b"\xff",
                b'"\\ud800"', b'"\\0"', b"=", b"a: &a [*a]\n")  # fmt: skip


class _Plain(yaml.CSafeDumper):
    """Writes what stands twice twice."""

    def ignore_aliases(self, _data: Any) -> bool:
        return True


_BOMB: Final = "x: &x0 [0, 0, 0, 0, 0, 0, 0, 0]\n" + "".join(
    f"x{k}: &x{k} [{', '.join([f'*x{k - 1}'] * 9)}]\n" for k in range(1, 12)
)
_JSON: Final = (b"NaN", b"Infinity", b"-Infinity", b"1e999", b"9" * 5000, b"[" * 2000, b'{"a":',
                b"null", b'"\\ud800"', b'"\\u0000"', b"\xff", b"\xef\xbb\xbf", b"1" * 30, b"{}",
                b"[]", b"-0", b'"x"', b"tru")  # fmt: skip
_CSV: Final = (b",", b",,,", b";", b"\t", b'"', b'""', b"\r", b"\n\n", b"\0", b"#", b"nan", b"inf",
               b"1e999", b"-1", b"99999999999", b"1,5", b"=1+1", b"\xff", b"\xef\xbb\xbf", b"\x1b",
               b"x" * 140_000, b"0", b"360", b"\x0c", b"\xe2\x80\xa8")  # fmt: skip
_LINES: Final = (b"[JOINT_4]\n", b"#INCLUDE x.ini\n", b"= = =\n", b"\0", b"\r", b"9" * 400, b"nan",
                 b"1e999", b"-", b"\xff", b";", b"N99999A4P1;", b"[END]", b"COMP_FILE = /dev/zero",
                 b"$AA_ENC_COMP[0,0,C]=", b"E", b"inf", b"\x1b]0;x\x07")  # fmt: skip


def harmed_yaml(rng: Random, data: bytes) -> bytes:
    """Return YAML with other values, in other places; or harm to the text itself."""
    how = rng.random()
    if how < 0.3 or b"*" in data.replace(b"/**", b""):  # an alias may stand for very much
        return harmed_bytes(rng, data, _YAML)
    if how < 0.33:
        return _BOMB.encode() + data
    try:
        tree = harmed_tree(rng, yaml.load(data, Loader=yaml.CSafeLoader))
        return bytes(yaml.dump(tree, Dumper=_Plain, sort_keys=False).encode())
    except (yaml.YAMLError, ValueError, TypeError, AttributeError, LookupError):
        return harmed_bytes(rng, data, _YAML)


def harmed_json(rng: Random, data: bytes) -> bytes:
    """Return JSON with other values, in other places; or harm to the text itself."""
    if rng.random() < 0.2:
        return harmed_bytes(rng, data, _JSON)
    try:
        return _json(harmed_tree(rng, json.loads(data)))
    except (ValueError, RecursionError):
        return harmed_bytes(rng, data, _JSON)


def harmed_json_lines(rng: Random, data: bytes) -> bytes:
    """Return a journal with harm to one line, or with lines lost, doubled and exchanged."""
    lines = data.split(b"\n")
    k = rng.randrange(len(lines))
    how = rng.randrange(5)
    if how == 0:
        del lines[k]
    elif how == 1:
        lines.insert(rng.randrange(len(lines) + 1), lines[k])
    elif how == 2:
        rng.shuffle(lines)
    else:
        lines[k] = harmed_json(rng, lines[k]) if lines[k] else rng.choice(_JSON)
    return b"\n".join(lines)


def harmed_csv(rng: Random, data: bytes) -> bytes:
    """Return a table with other cells, rows and columns; or harm to the text itself."""
    if rng.random() < 0.4:
        return harmed_bytes(rng, data, _CSV)
    rows = [line.split(",") for line in data.decode("utf-8", "replace").splitlines()]
    for _ in range(rng.randint(1, 3)):
        if not rows:
            break
        _harm_row(rng, rows)
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(rows)
    return stream.getvalue().encode("utf-8", "replace")


def _harm_row(rng: Random, rows: list[list[str]]) -> None:
    k = rng.randrange(len(rows))
    how = rng.randrange(6)
    if how == 0:
        del rows[k]
    elif how == 1:
        rows.insert(rng.randrange(len(rows) + 1), list(rows[k]))
    elif how == 2 and rows[k]:
        del rows[k][rng.randrange(len(rows[k]))]
    elif how == 3:
        rows[k].append(rng.choice(HOSTILE))
    elif rows[k]:
        words = (*HOSTILE, "nan", "-inf", "1e999", "-1", "0", "1000000", "1e-320", "0x10", "1_0")
        rows[k][rng.randrange(len(rows[k]))] = rng.choice(words)


def harmed_lines(rng: Random, data: bytes) -> bytes:
    """Return a controller's file with harm to its text and its lines."""
    lines = data.splitlines(keepends=True)
    if rng.random() < 0.5 and lines:
        k = rng.randrange(len(lines))
        lines[k : k + 1] = rng.choice(([], [lines[k]] * 2, [rng.choice(_LINES), lines[k]]))
        return b"".join(lines)
    return harmed_bytes(rng, data, _LINES)


def _json(tree: Any) -> bytes:
    return json.dumps(tree, default=str, skipkeys=True).encode()


Harm = Callable[[Random, bytes], bytes]
TOKENS: Final[Sequence[bytes]] = (*_YAML, *_JSON, *_CSV, *_LINES)
