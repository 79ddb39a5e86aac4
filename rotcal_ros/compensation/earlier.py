"""An earlier export in a folder: what it holds, and whether it is whole."""

from __future__ import annotations

import hashlib
from pathlib import Path

from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.compensation.held import HeldTable, held_table
from rotcal_ros.compensation.writing import PROVENANCE, check_file_name
from rotcal_ros.errors import BagError, ConfigurationError
from rotcal_ros.untrusted import load_json, read_text, why


def read_earlier(folder: Path, controller_name: str, axis: str) -> HeldTable:
    """Return the table for this controller and axis that ``folder`` holds, by its own rule.

    Raises ConfigurationError unless there is exactly one, BagError when its files are damaged.
    """
    found = {}
    for path in sorted(folder.glob(f"*{PROVENANCE}")):
        text = _text(path)
        try:
            side = load_json(text)
            if (side["controller"], side["axis"]) == (controller_name, axis):
                found[path.name] = (text, dict(side["settings"]), dict(side["files_sha256"]))
        except KeyError as error:
            raise BagError(f"{path} is no side file of a table: no entry {error}") from error
        except (ValueError, TypeError) as error:
            raise BagError(f"{path} is no side file of a table: {error}") from error
    if len(found) != 1:
        raise ConfigurationError(
            f"{folder} holds {len(found)} tables of axis {axis} for {controller_name}, expected "
            f"one: name the folder with the files of the table in force and its *{PROVENANCE}"
        )
    (name, (text, settings, hashes)), *_ = found.items()
    files = {n: _checked(folder / check_file_name(n), h) for n, h in hashes.items()}
    return held_table(make_controller(controller_name, settings), {**files, name: text})


def _checked(path: Path, sha256: str) -> str:
    text = _text(path)
    if hashlib.sha256(text.encode()).hexdigest() != sha256:
        raise BagError(
            f"{path} was changed since it was written: its side file states another SHA-256"
        )
    return text


def _text(path: Path) -> str:
    try:
        return read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        raise BagError(f"cannot read {path}: {why(error)}") from error
