"""An earlier export in a folder: what it holds, whether it is whole, and what is added to it."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from rotcal_ros.compensation.agreement import (
    AcceptedConflicts,
    MachineIdentity,
    check_table_for_machines,
)
from rotcal_ros.compensation.cascaded_tables import combine_with_table_in_force
from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.compensation.held_table import (
    CorrectionEffect,
    HeldTable,
    effect_from_result,
    held_table,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.compensation.writing import PROVENANCE, SCHEMA, check_file_name
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.in_force import describe, is_table_hash
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.untrusted import load_json, read_errors_as, read_text


def combine_with_earlier_export(
    table: CompensationTable,
    controller_name: str,
    machine: Mapping[str, MachineIdentity],
    accepted: AcceptedConflicts,
    now_ns: int,
    *,
    measured_ns: int = 0,
    replaces: bool = False,
    add_to: Path | None = None,
) -> CompensationTable:
    """Return the table to be written for ``machine`` (its keys are names for people).

    It is ``table`` itself, or ``table`` added to the one in the folder ``add_to``; all have to
    belong to the same machine. ``measured_ns`` is when it was measured (since 1970), if the table
    does not say so. ``replaces``: a person says that none was in force. Raises
    DataError for a contradiction that is not ``accepted``, and if nothing says what was in force;
    ConfigurationError if both options are given.
    """
    make_controller(controller_name)  # a misspelt one is said before all else
    if replaces and add_to is not None:
        raise ConfigurationError(
            "replacing the table in force (--replace) and adding to it (--add-to) exclude each "
            "other"
        )
    if add_to is None:
        agreed = check_table_for_machines(table, machine, accepted, now_ns, measured_ns)
        return combine_with_table_in_force(
            agreed, lambda: None, "replace" if replaces else "as_measured"
        )
    letter = next((m.axis for m in machine.values() if m.axis), table.axis)
    earlier = read_earlier(add_to, controller_name, letter)
    machines = {**machine, f"the table in {add_to}": earlier.machine}
    agreed = check_table_for_machines(table, machines, accepted, now_ns, measured_ns)
    return combine_with_table_in_force(agreed, lambda: earlier, "add")


def read_earlier(folder: Path, controller_name: str, axis: str) -> HeldTable:
    """Return the table for this controller and axis that ``folder`` holds, by its own rule.

    Raises ConfigurationError unless there is exactly one, BagError when its files are damaged.
    """
    found = {}
    for path in _sides(folder):
        text, side = _text(path), _side(path)
        try:
            if (side["controller"], side["axis"]) == (controller_name, axis):
                found[path.name] = (text, dict(side["settings"]), dict(side["files_sha256"]))
        except (KeyError, ValueError, TypeError) as error:
            raise _no_side_file(path, error) from error
    if len(found) != 1:
        raise ConfigurationError(
            f"{folder} holds {len(found)} tables of axis {axis} for {controller_name}, expected "
            f"one: name the folder with the files of the table in force and its *{PROVENANCE}"
        )
    (name, (text, settings, hashes)), *_ = found.items()
    files = {n: _checked(folder / check_file_name(n), h) for n, h in hashes.items()}
    return held_table(make_controller(controller_name, settings), {**files, name: text})


def effect_of_table_in_force(result: Result, folder: Path) -> CorrectionEffect | None:
    """Return what ``result`` says about the table in force, whose files are in ``folder``.

    Raises ConfigurationError if ``folder`` does not hold this table.
    """
    return effect_from_result(result, loaded_table(folder, result.measured_on))


def loaded_table(
    folder: Path, in_force: str, controllers: Collection[str] | None = None
) -> HeldTable:
    """Return the table in ``folder`` that was ``in_force``.

    With ``controllers``, those it may be for or () for any, it need not be known which was in
    force: it is the only one. Raises ConfigurationError if ``folder`` does not hold this table, or
    others too that it may have been.
    """
    pairs = {(side["controller"], side["axis"]) for side in map(_side, _sides(folder))}
    held = {pair: read_earlier(folder, *pair) for pair in sorted(pairs)}
    word = controllers is not None and not is_table_hash(in_force)
    found = [
        table
        for (name, _), table in held.items()
        if (word or table.in_force == in_force) and (not controllers or name in controllers)
    ]
    if not found or (word and len(found) > 1):
        there = ", ".join(
            f"{table.in_force[:12]} ({name}, {axis})" for (name, axis), table in held.items()
        )
        raise ConfigurationError(
            f"tables in {folder}: {there or 'none'}; {describe(in_force)}: name the folder with "
            f"the files of the table that was in force and its *{PROVENANCE}; of several state "
            "the controller (--to)"
        )
    return found[0]


def _sides(folder: Path) -> list[Path]:
    return sorted(folder.glob(f"*{PROVENANCE}"))


def _side(path: Path) -> dict[str, Any]:
    """Return the content of a side file; BagError if it is not one."""
    try:
        side = load_json(_text(path))
        if side["schema"] != SCHEMA:
            raise ValueError(f"its schema is {side['schema']!r:.20}, expected {SCHEMA}")
        return {**side, "controller": str(side["controller"]), "axis": str(side["axis"])}
    except (KeyError, ValueError, TypeError) as error:
        raise _no_side_file(path, error) from error


def _no_side_file(path: Path, error: Exception) -> BagError:
    why = f"no entry {error}" if isinstance(error, KeyError) else str(error)
    return BagError(f"{path} is not a side file of a table: {why}; restore the file of the export")


def _checked(path: Path, sha256: str) -> str:
    text = _text(path)
    if hashlib.sha256(text.encode()).hexdigest() != sha256:
        raise BagError(
            f"{path} was changed since it was written: its side file states another SHA-256; "
            "export again, or restore the file"
        )
    return text


def _text(path: Path) -> str:
    with read_errors_as(path, BagError):
        return read_text(path)
