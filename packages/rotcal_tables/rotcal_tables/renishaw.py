"""Files ``.rtl`` of Renishaw's laser programs: targets, and deviations by run and target.

Sections begin with a name and ``::``. ``Targets :`` lists the targets over several lines up to
``Flags:``; below ``Run Target Data:`` each line has a run, the number of a target from 1, and a
deviation. No unit stands in the file, so it is asked: a public program takes deviations of a
rotary axis for milliradians. The order of the targets in a run is its direction.
docs/deviations.md says what this was looked up in.
"""

from __future__ import annotations

import re

from rotcal_ros.foundation.errors import BagError

HEAD = ("run", "angle", "deviation")
_TARGETS = re.compile(r"^Targets\s*:(.*?)^Flags\s*:", re.MULTILINE | re.DOTALL)
_COUNT = re.compile(r"^Target-count\s*:\s*(\d{1,9})\b", re.MULTILINE)
_DATA = re.compile(r"^Run Target Data:(.*?)(?=^[A-Z -]+::|\Z)", re.MULTILINE | re.DOTALL)
_LINE = re.compile(r"\s*(\d{1,9})\s+(\d{1,9})\s+(\S+)\s*")


def read(text: str) -> list[tuple[str, ...]] | None:
    """Return the rows of a table, its head first; None for a text that is no such file.

    Raises BagError for one that contradicts itself.
    """
    data, listed = _DATA.search(text), _TARGETS.search(text)
    if not (text.lstrip("\ufeff \r\n").startswith("HEADER::") and data and listed):
        return None
    targets, stated = listed[1].split(), _COUNT.search(text)
    if stated and int(stated[1]) != len(targets):
        raise BagError(
            f"Target-count is {stated[1]}, and {len(targets)} targets are listed: export the "
            "file again"
        )
    rows = []
    for line in filter(str.strip, data[1].splitlines()):
        found = _LINE.fullmatch(line)
        if found is None:
            raise BagError(f"{line.strip()[:60]!r} is no run, target and deviation")
        rows.append(found.groups())
    wrong = next((row for row in rows if not 1 <= int(row[1]) <= len(targets)), None)
    if wrong:
        raise BagError(f"run {wrong[0]} has target {wrong[1]}, of {len(targets)}: export it again")
    return [HEAD, *((run, targets[int(number) - 1], value) for run, number, value in rows)]
