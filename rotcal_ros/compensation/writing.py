"""Writes all files or none, complete on disk before they get their names, never over old ones."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from rotcal_ros.foundation import disk
from rotcal_ros.foundation.circumstances import SIMULATED
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.files import make_folder, scratch_folder, sync_folder, write_durably

PROVENANCE: Final = ".provenance.json"
"""The ending of the side file, which is for people and not for the controller."""
SCHEMA: Final = 1
"""Version of the entries in a side file."""
WRITTEN: Final = "written"


def side_file_facts(
    files: Mapping[str, str], now: datetime, sources: Mapping[str, str] | None
) -> dict[str, Any]:
    """Return what every side file says: when ``files`` were written, and of what, with hashes."""
    return {
        "schema": SCHEMA,
        WRITTEN: now.isoformat(timespec="seconds"),
        "sources_sha256": dict(sources or {}),
        "files_sha256": {
            file: hashlib.sha256(text.encode()).hexdigest() for file, text in files.items()
        },
    }


def add_side_file(files: Mapping[str, str], name: str, side: Mapping[str, Any]) -> dict[str, str]:
    """Return ``files`` and their ``side`` file."""
    text = json.dumps(side, indent=1, allow_nan=False) + "\n"
    return {**files, f"{name}{PROVENANCE}": text}


def write_files(files: Mapping[str, str], folder: Path) -> tuple[Path, ...]:
    """Write all of ``files`` into ``folder`` or none, and return their paths.

    Every file is complete on disk before it gets its name, and no existing file is touched:
    BagError when a name is taken, leaves the folder, or the disk refuses.
    """
    for name in files:
        check_file_name(name)
    try:
        if not folder.is_dir():
            make_folder(folder)
    except OSError as error:
        raise BagError(
            f"cannot make the folder {folder}: {error.strerror}; choose another"
        ) from error
    done: list[Path] = []
    try:
        with scratch_folder(folder) as scratch:
            for name, text in files.items():
                write_durably(scratch / name, text, "latin-1")
                (scratch / name).chmod(0o644)
            for name in files:
                disk.link(scratch / name, folder / name)
                done.append(folder / name)
        sync_folder(folder)
    except OSError as error:
        for path in list(done):
            with suppress(OSError):
                disk.remove(path)
                done.remove(path)
        if isinstance(error, FileExistsError):
            raise BagError(
                f"{error.filename2 or error.filename} exists already and nothing is ever "
                "overwritten: choose another folder or name; nothing was written"
            ) from error
        left = (
            f"{', '.join(map(str, done))} must be removed by hand" if done else "nothing is left"
        )
        raise BagError(
            f"cannot write into {folder}: {error.strerror}; {left}; make room, or choose another "
            "folder"
        ) from error
    return tuple(done)


def choose_stem(asked: str | None, usual: str, *, simulated: bool) -> str:
    """Return the name that was ``asked`` for, else the ``usual`` one, which names a simulation."""
    return check_stem(asked or (f"{usual}_{SIMULATED}" if simulated else usual).lower())


def check_stem(stem: str) -> str:
    """Return ``stem`` if it is a plain file name, else raise ConfigurationError."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}", stem):
        raise ConfigurationError(
            f"file name {stem!r}: expected letters, digits, '_' and '-' only, without folder or "
            "extension; files do not leave the output folder"
        )
    return stem


def check_file_name(name: str) -> str:
    """Return ``name`` when it stays in its folder, else raise ConfigurationError."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}", name):
        raise ConfigurationError(
            f"file name {name!r} leaves the output folder or is not a file name"
        )
    return name


def without_provenance(files: Mapping[str, str]) -> dict[str, str]:
    """Return the files that a controller reads, without the provenance."""
    return {name: text for name, text in files.items() if not name.endswith(PROVENANCE)}
