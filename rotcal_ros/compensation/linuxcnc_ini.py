"""The ini file of a LinuxCNC: read as LinuxCNC reads it, and completed in a copy.

LinuxCNC takes the first section of a name and the first line of a key in it, and silently ignores
all later ones. A value goes to the end of its line. Source: IniFile::Find of LinuxCNC 2.9
(src/libnml/inifile/inifile.cc); ``#INCLUDE`` is expanded by its start script.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.untrusted import read_bytes

ENCODING: Final = "latin-1"
"""An encoding for any byte, so that the copy differs only in the new lines."""
_SECTION: Final = re.compile(r"\s*\[([^\]]*)\]")
_PAIR: Final = re.compile(r"\s*([^\s=#;][^\s=]*)\s*=\s*(.*?)\s*")
_INCLUDE: Final = re.compile(r"#INCLUDE\s+(\S+)\s*")
_NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


@dataclass(frozen=True)
class Ini:
    """The text of the ini file at ``path``.

    Raises ConfigurationError when it cannot be read.
    """

    path: Path
    text: str

    @classmethod
    def read(cls, path: Path) -> Ini:
        """Read the file; ConfigurationError when there is none."""
        try:
            return cls(path, read_bytes(path).decode(ENCODING))
        except OSError as error:
            raise ConfigurationError(
                f"cannot read the machine's ini file {path}: {error.strerror}"
            ) from error

    def value(self, section: str, key: str) -> str | None:
        """Return the value that LinuxCNC finds for ``key`` in ``section``; None: none."""
        inside = False
        for line in self._lines():
            if header := _SECTION.match(line):
                if inside:
                    return None
                inside = header[1] == section
            elif inside and (pair := _PAIR.fullmatch(line)) and pair[1] == key:
                return pair[2]
        return None

    def number(self, section: str, key: str, default: float) -> float:
        """Return a number; ``default`` where there is none; ConfigurationError for other text."""
        text = self.value(section, key)
        if text is None:
            return default
        match = _NUMBER.match(text)
        if match is None:
            raise ConfigurationError(
                f"{self.path}: [{section}] {key} = {text!r}, expected a number"
            )
        if not isfinite(number := float(match[0])):
            raise ConfigurationError(f"{self.path}: [{section}] {key} = {text!r:.60} is too large")
        return number

    def count(self, section: str) -> int:
        """Return how many sections there are of that name."""
        headers = (_SECTION.match(line) for line in self._lines())
        return sum(header is not None and header[1] == section for header in headers)

    def merged(self, section: str, values: Mapping[str, str | int]) -> str:
        """Return the text with ``values`` in ``section``: old lines replaced, new ones at its end.

        All other lines stay as they are. Raises ConfigurationError unless this file itself holds
        the section exactly once.
        """
        self.require_once(section)
        lines = self.text.splitlines(keepends=True)
        headers = [i for i, line in enumerate(lines) if _SECTION.match(line)]
        start = [i for i in headers if (m := _SECTION.match(lines[i])) and m[1] == section]
        if not start:
            raise ConfigurationError(
                f"{self.path}: section [{section}] is in an included file: put the two lines "
                "there by hand"
            )
        end = next((i for i in headers if i > start[0]), len(lines))
        kept = [line for line in lines[start[0] : end] if not _holds(line, values)]
        last = max(i for i, line in enumerate(kept) if line.strip())
        newline = "\r\n" if lines[start[0]].endswith("\r\n") else "\n"
        if not kept[last].endswith("\n"):
            kept[last] += newline
        new = [f"{key} = {value}{newline}" for key, value in values.items()]
        return "".join(
            [*lines[: start[0]], *kept[: last + 1], *new, *kept[last + 1 :], *lines[end:]]
        )

    def require_once(self, section: str) -> None:
        """Raise ConfigurationError unless there is exactly one section of that name."""
        if (count := self.count(section)) != 1:
            raise ConfigurationError(
                f"{self.path} holds {count} sections [{section}], expected one"
                + (": LinuxCNC ignores all but the first" if count else "")
            )

    def _lines(self) -> Iterator[str]:
        """Yield all lines, with those of included files in their place.

        Includes are not nested.
        """
        for line in self.text.splitlines():
            if include := _INCLUDE.fullmatch(line):
                yield from Ini.read(self.path.parent / include[1]).text.splitlines()
            else:
                yield line


def _holds(line: str, values: Mapping[str, str | int]) -> bool:
    pair = _PAIR.fullmatch(line.rstrip("\r\n"))
    return pair is not None and pair[1] in values
