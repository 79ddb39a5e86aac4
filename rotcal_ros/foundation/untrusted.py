"""Input from elsewhere, read within bounds: plain files, JSON and YAML.

A path may lead to a pipe without a writer or a device without an end; a text may nest without end,
or grow when its references are followed. Every reader of such input uses these functions, so that
it ends at once, with a value or with an error of one sentence.
"""

from __future__ import annotations

import errno
import io
import json
import math
import os
import re
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO, Final

from rotcal_ros.foundation.errors import ConfigurationError, RotcalError
from rotcal_ros.foundation.url_secrets import has_secret, secret_error_text

LARGEST_FILE: Final = 1 << 28
"""Bytes of a file that is read whole; the result of 20 000 lengths has 10 million."""
WORKBOOKS: Final = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""First bytes of the files of spreadsheet programs."""
_PART: Final = 1 << 20
LARGEST_YAML: Final = 1 << 22
"""Characters of a YAML text; a plan of 100 000 lengths has a million."""
DEEPEST: Final = 64
"""Levels of nested lists and groups; ours have fewer than ten."""
LARGEST_EXPANSION: Final = 400_000
"""Values of a YAML text after its aliases are expanded."""
_LONGEST_NUMBER: Final = 1000

_KINDS: Final = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


class NotAFileError(OSError):
    """A path does not lead to a plain file; ``strerror`` says what is there."""


def is_plain_file(path: Path) -> bool:
    """Return whether ``path`` leads to a plain file; False if that cannot be found out."""
    try:
        return stat.S_ISREG(path.stat().st_mode)
    except (OSError, ValueError):
        return False


def open_plain(path: Path) -> BinaryIO:
    """Open a plain file for reading; never waits for a writer. OSError for anything else."""
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "no file has a NUL in its name", str(path))
    _require_plain(path, path.stat())
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
    try:
        _require_plain(path, os.fstat(descriptor))
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def require_no_secret(text: str, place: str) -> None:
    """Raise ConfigurationError, which does not repeat it, if a URL in ``text`` has a secret."""
    if has_secret(text):
        raise ConfigurationError(secret_error_text(place))


def require_plain(path: Path) -> None:
    """Raise OSError if ``path`` leads to anything but a plain file; a free name is fine.

    A file that replaces a device takes the device away from the whole machine.
    """
    with suppress(FileNotFoundError):
        _require_plain(path, path.stat())


def read_bytes(path: Path, largest: int = LARGEST_FILE) -> bytes:
    """Return the content of a plain file; OSError: it is none, or larger than ``largest``."""
    data = bytearray()
    with open_plain(path) as file:
        while part := file.read(_PART):
            data += part
            if len(data) > largest:
                what = f"it has more than the {largest:,} bytes that such a file can have"
                raise OSError(errno.EFBIG, what, str(path))
    return bytes(data)


def read_text(path: Path, encoding: str = "utf-8", largest: int = LARGEST_FILE) -> str:
    """Return the text of a plain file with uniform line endings; OSError or UnicodeDecodeError."""
    with io.TextIOWrapper(io.BytesIO(read_bytes(path, largest)), encoding=encoding) as text:
        return text.read()


_CURES: Final = {
    errno.ENOENT: "; check the path",
    errno.ENOTDIR: "; check the path",
    errno.EACCES: "; ask its owner to let you read it",
    errno.EIO: "; check the disk",
    errno.ESTALE: "; mount its drive again",
}


@contextmanager
def read_errors_as(
    path: Path | str, error_type: type[RotcalError], what: str = ""
) -> Iterator[None]:
    """Raise ``error_type`` where ``path`` cannot be read inside; ``what`` it is: "the list "."""
    try:
        yield
    except (OSError, UnicodeDecodeError) as error:
        raise error_type(f"cannot read {what}{path}: {cause_of(error)}") from error


def cause_of(error: Exception) -> str:
    """Return why a file could not be read, without its path, and what to do about it."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror + _CURES.get(error.errno or 0, "")
    if isinstance(error, UnicodeDecodeError):
        return f"it is not text in UTF-8 (byte {error.start}); save it as UTF-8"
    return str(error)


def load_json(text: str | bytes, *, finite: bool = True) -> Any:
    """Return the value that a JSON text states; ValueError for any other text.

    With ``finite`` False the text may have NaN, like our own files between processes.

    >>> load_json("[" * 100 + "]" * 100)
    Traceback (most recent call last):
    ...
    ValueError: more than 64 levels of lists and groups in each other
    """
    try:
        number = _finite if finite else float
        value = json.loads(text, parse_constant=number, parse_float=number)
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
    except UnicodeDecodeError as error:
        raise ValueError(cause_of(error)) from None
    _check_depth(value)
    return value


def load_yaml(text: str, source: str, *, strict: bool = True) -> Any:
    """Return the value that a YAML text states; ConfigurationError, naming ``source``, else.

    ``strict`` is for what people write: what YAML 1.1 and YAML 1.2 read differently is refused
    with its line, such as 1:30 (ninety, or a text), and so is a name that is given twice in its
    group; dates are texts. Otherwise everything is read by YAML 1.1, for what programs have
    written.

    >>> load_yaml("table_start_deg: 1:30", "my.yaml")
    Traceback (most recent call last):
    ...
    rotcal_ros.foundation.errors.ConfigurationError: my.yaml: line 1: 1:30 is 90 in YAML 1.1 \
and something else in YAML 1.2: write a plain number such as 1.5, or a text in quotes
    """
    import yaml

    if len(text) > LARGEST_YAML:
        raise ConfigurationError(
            f"{source}: not valid YAML for us: {len(text):,} characters, expected at most "
            f"{LARGEST_YAML:,}"
        )
    try:
        _check_events(yaml.parse(text, Loader=_loader(yaml)))
        return _loaded_strictly(text) if strict else yaml.load(text, Loader=_loader(yaml))
    except _AmbiguousError as error:
        raise ConfigurationError(f"{source}: {error}") from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        what = error.problem or error.context or "it cannot be read"
        raise ConfigurationError(
            f"{source}: not valid YAML: {where}{what}; correct it there"
        ) from error
    except yaml.YAMLError as error:
        what = " ".join(str(error).split())
        raise ConfigurationError(f"{source}: not valid YAML: {what}; correct it") from error
    except (ValueError, TypeError, LookupError, AttributeError, ArithmeticError) as error:
        # Tagged values, such as an impossible date, raise errors of yaml's own constructors.
        raise ConfigurationError(
            f"{source}: a value cannot be read: {error}; correct it, or put it in quotes"
        ) from error


class _AmbiguousError(Exception):
    """Two readers understand a YAML text differently; the text has the line and the reason."""


_TAG: Final = "tag:yaml.org,2002:"
_ALIKE: Final = {
    f"{_TAG}bool": re.compile("true|True|TRUE|false|False|FALSE"),
    f"{_TAG}int": re.compile("[-+]?(0|[1-9][0-9]*)|0x[0-9a-fA-F]+"),
    f"{_TAG}float": re.compile("[^:_]*"),
}
"""Kind of value in YAML 1.1 -> texts for which YAML 1.2 gives the same value."""


def _loaded_strictly(text: str) -> Any:
    """Return the value of a text that all readers read alike, or raise _AmbiguousError."""
    loader = _strict_loader()(text)
    try:
        root = loader.get_single_node()
        if root is None:
            return None
        _check_nodes(root, loader)
        return loader.construct_document(root)
    finally:
        loader.dispose()


@cache
def _strict_loader() -> Any:
    """Return a loader of YAML 1.1 that reads a date as text."""
    import yaml

    class Strict(_loader(yaml)):  # type: ignore[misc]
        yaml_implicit_resolvers = {  # noqa: RUF012
            first: [(tag, pattern) for tag, pattern in resolvers if tag != f"{_TAG}timestamp"]
            for first, resolvers in _loader(yaml).yaml_implicit_resolvers.items()
        }

    return Strict


def _check_nodes(root: Any, loader: Any) -> None:
    """Raise _AmbiguousError at the first value or name that two readers read differently."""
    waiting, seen = [root], set()
    while waiting:
        node = waiting.pop()
        if id(node) in seen:  # an alias
            continue
        seen.add(id(node))
        if isinstance(node.value, str):
            _check_scalar(node, loader)
        else:
            pairs = [x for x in node.value if isinstance(x, tuple)]
            _check_names([key for key, _ in pairs])
            inner = [part for pair in pairs for part in pair] if pairs else node.value
            waiting += reversed(inner)


def _check_scalar(node: Any, loader: Any) -> None:
    alike = _ALIKE.get(node.tag)
    if alike is None or alike.fullmatch(node.value):
        return
    text, value = node.value, loader.construct_object(node)
    if isinstance(value, bool):
        word = str(value).lower()
        what = f'{word} in YAML 1.1 and a text in YAML 1.2: write {word}, or "{text}" in quotes'
    else:
        plain = "1.5" if ":" in text else value  # who writes 1:30 hardly means 90
        what = (
            f"{value} in YAML 1.1 and something else in YAML 1.2: write a plain number such as "
            f"{plain}, or a text in quotes"
        )
    raise _AmbiguousError(f"line {node.start_mark.line + 1}: {text} is {what}")


def _check_names(keys: Iterable[Any]) -> None:
    lines: dict[tuple[str, str], int] = {}
    for key in keys:
        if isinstance(key.value, str):
            name, line = (key.tag, key.value), key.start_mark.line + 1
            if name in lines:
                raise _AmbiguousError(
                    f"line {line}: {key.value} is given a second time, the first time in line "
                    f"{lines[name]}: keep one of them"
                )
            lines[name] = line


def yaml_line_of(text: str, *names: str) -> int:
    """Return the line of the last of ``names``, each in the group of the one before it; 0: none.

    ``text`` is YAML that :func:`load_yaml` has read.
    """
    import yaml

    node, line = yaml_nodes(text), 0
    for name in names:
        pairs = node.value if isinstance(node, yaml.MappingNode) else []
        found = next(((key, value) for key, value in pairs if key.value == name), None)
        if found is None:
            return 0
        line, node = found[0].start_mark.line + 1, found[1]
    return line


def yaml_nodes(text: str) -> Any:
    """Return the nodes, with their places, of YAML that :func:`load_yaml` has read."""
    import yaml

    return yaml.compose(text, Loader=_loader(yaml))


_TOO_DEEP: Final = f"more than {DEEPEST} levels of lists and groups in each other"


def _require_plain(path: Path, status: os.stat_result) -> None:
    if stat.S_ISREG(status.st_mode):
        return
    kind = next((name for test, name in _KINDS if test(status.st_mode)), "something else")
    number = errno.EISDIR if kind == "a folder" else errno.EINVAL
    raise NotAFileError(number, f"it is {kind}, expected a file", str(path))


def _finite(text: str) -> float:
    """Return a number of JSON, which has neither NaN nor infinity; ValueError for those."""
    if not math.isfinite(number := float(text)):
        raise ValueError(f"{text:.20} is not a finite number")
    return number


def _loader(yaml: Any) -> Any:
    return getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def _check_events(events: Iterable[Any]) -> None:
    """Raise ValueError for what nests too deeply or grows too large; see the constants.

    The loader itself descends level by level, in C, and follows every alias each time.
    """
    import yaml

    sizes: dict[str, int] = {}
    open_: list[tuple[str | None, int]] = []
    total = 0
    for event in events:
        if isinstance(event, yaml.CollectionStartEvent):
            open_.append((event.anchor, total))
            if len(open_) > DEEPEST:
                raise ValueError(_TOO_DEEP)
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = open_.pop()
            total += 1
            if anchor:
                sizes[anchor] = total - before
        elif isinstance(event, yaml.AliasEvent):
            if any(anchor == event.anchor for anchor, _ in open_):
                raise ValueError(f"the alias *{event.anchor} is inside the value that it names")
            total += sizes.get(event.anchor, 1)
        else:
            total += 1
            _check_number(event)
        if total > LARGEST_EXPANSION:
            raise ValueError(f"more than {LARGEST_EXPANSION:,} values")


def _check_number(event: Any) -> None:
    """Raise ValueError for a number too long for Python to print, such as one in hexadecimal."""
    text = getattr(event, "value", "")
    plain = len(text) > _LONGEST_NUMBER and (event.implicit[0] or event.tag)
    if plain and text.lstrip("+-")[:1].isdigit():
        raise ValueError(f"a number of more than {_LONGEST_NUMBER:,} digits")


def _check_depth(value: Any) -> None:
    """Raise ValueError if lists and groups nest deeper than ``DEEPEST``."""
    level: list[Any] = [[value]]
    for _ in range(DEEPEST + 1):
        insides = (x.values() if isinstance(x, dict) else x for x in level)
        level = [x for inside in insides for x in inside if isinstance(x, dict | list)]
    if level:
        raise ValueError(_TOO_DEEP)
