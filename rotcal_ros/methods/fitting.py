"""Which methods a table without a set-up may be for, by its columns."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError, UndecidedError
from rotcal_ros.foundation.settings import settings_from_changes
from rotcal_ros.foundation.table_columns import AS_IT_STANDS, SheetSettings
from rotcal_ros.foundation.table_forms import read_any, remembered
from rotcal_ros.foundation.tables import has_own_form
from rotcal_ros.foundation.untrusted import load_yaml
from rotcal_ros.methods.configuration import Configuration, changed, parse_configuration
from rotcal_ros.methods.method import Method, TableReader, find_method, usable_methods

NAMED: Final = "method="
"""What ``--set`` begins with where a person says which method a table without set-up is for."""


def fitting_methods(path: Path, sheet: SheetSettings = AS_IT_STANDS) -> list[Method]:
    """Return the methods whose columns a table has, as far as it can be read without a set-up."""
    readers = [(method, method.table) for method in usable_methods() if method.table]
    own = [m for m, t in readers if has_own_form(path, (*t.headers, *t.with_angles))]
    if own:
        return own
    read = [(method, _reads(path, table, sheet)) for method, table in readers]
    sure = [method for method, whole in read if whole]
    return sure or [method for method, whole in read if whole is None]


def _reads(path: Path, table: TableReader, sheet: SheetSettings) -> bool | None:
    """Return whether a table has the columns; None where that is open until something is said."""
    try:
        read_any(path, table.headers, sheet)
    except (BagError, ConfigurationError):
        return False
    except DataError as error:
        return None if isinstance(error, UndecidedError) else True
    return True


def setup_of_its_own(path: Path, changes: Sequence[str]) -> Configuration:
    """Return the set-up of a table that needs none, with ``changes``, one of which may name it.

    Raises ConfigurationError that lists what the table may be for, each with its command, where
    that is not one method alone whose tables state everything.
    """
    named = [change for change in changes if change.startswith(NAMED)]
    of_the_table = [change for change in changes if change.startswith("sheet.")]
    changes = [change for change in changes if change not in named]
    stated = settings_from_changes(SheetSettings, "sheet", of_the_table, load_yaml)
    if named:
        found = [find_method(named[-1].removeprefix(NAMED))]
    else:
        found = fitting_methods(path, remembered(path, stated))
    if not found:  # what stands against the one that would need nothing else
        every = (m for m in usable_methods() if m.table and not m.table.needs_setup)
        found = list(every)[:1]
    alone = found[0].table if len(found) == 1 else None
    if alone is not None and not alone.needs_setup:
        return changed(parse_configuration(f"method: {found[0].name}\n", str(path)), changes)
    if not found:
        raise ConfigurationError(
            f"{path} is a table, and a table needs its set-up: give --setup SETUP.yaml (rotcal "
            "new writes one)"
        )
    ways = "; or ".join(sorted(_ways(path, found), reverse=True))  # the same command comes first
    raise ConfigurationError(
        f"{path} is a table without a set-up, and its columns fit several methods: {ways}"
    )


def _ways(path: Path, methods: Sequence[Method]) -> Iterator[str]:
    table = shlex.quote(str(path))
    for method in methods:
        if method.table and not method.table.needs_setup:
            yield f"the same command with --set {NAMED}{method.name} ({method.title})"
            continue
        yield (
            f"rotcal new --method {method.name} -o {method.name}.yaml && rotcal "
            f"solve {table} --setup {method.name}.yaml ({method.title})"
        )
