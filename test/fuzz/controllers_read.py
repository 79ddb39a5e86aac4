"""Fuzzed by themselves: what lies in the folder of a controller, and beside its tables."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Final

from properties import suppress_rotcal

DATA: Final = Path(__file__).parents[2] / "examples" / "data"


def journals() -> Iterable[bytes]:
    actions = ("applying", "applied", "restoring", "restored", "applying", "rolled_back")
    entries = (
        {"action": action, "time_ns": 10**18 + k, "table_hash": "a" * 64, "backup": "before-1",
         "before_hash": "b" * 64, "after_hash": "c" * 64, "in_force": "none"}
        for k, action in enumerate(actions)
    )  # fmt: skip
    yield "".join(json.dumps(entry) + "\n" for entry in entries).encode()


def read_journal(path: Path) -> None:
    from rotcal_ros.compensation.journal import CONTENTS, Journal

    kept = path.parent / "before-1"
    kept.mkdir(exist_ok=True)
    (kept / CONTENTS).write_text('{"C.comp": null}')
    journal = Journal(path.parent)
    for read in (journal.entries, journal.last_undoable, journal.unfinished, journal.history,
                 journal.names, journal.last_ns):  # fmt: skip
        with suppress_rotcal():
            read()
    with suppress_rotcal():
        journal.kept(".")


@cache
def _exports() -> Mapping[str, Mapping[str, str]]:
    """Return the files of every controller that takes the example's table."""
    from datetime import datetime, timezone

    from rotcal_ros.compensation.controllers import controller_names
    from rotcal_ros.compensation.export import prepare_export
    from rotcal_ros.compensation.table import table_from_result
    from rotcal_ros.recordings.result_sources import read_source

    table = table_from_result(read_source(DATA / "result_tracer.json").result)
    found = {}
    for name in controller_names():
        with suppress_rotcal():
            found[name] = prepare_export(
                table, name, now=datetime(2026, 1, 1, tzinfo=timezone.utc), accept_unverified=True
            ).files
    return found


@cache
def _volumetric() -> Mapping[str, Mapping[str, str]]:
    """Return the volumetric files of every controller that has a form for them."""
    from datetime import datetime, timezone

    from rotcal_ros.compensation.controllers import controller_names, make_controller
    from rotcal_ros.compensation.volumetric import prepare_volumetric
    from rotcal_ros.recordings.result_sources import read_source

    result = read_source(DATA / "result_ball_plate.json").result
    now, found = datetime(2026, 1, 1, tzinfo=timezone.utc), {}
    for name in controller_names():
        with suppress_rotcal():
            found[name], _ = prepare_volumetric(
                result, name, make_controller(name), now=now, accept_unverified=True
            )
    return found


def controller_files() -> Iterable[bytes]:
    for files in (*_exports().values(), *_volumetric().values()):
        for name, text in files.items():
            if not name.endswith(".provenance.json"):
                yield text.encode("latin-1")


def read_controller_file(path: Path) -> None:
    """Give the file to every controller in the place of its own."""
    from rotcal_ros.compensation.controllers import make_controller
    from rotcal_ros.compensation.writing import without_provenance

    text = path.read_bytes().decode("latin-1")
    for name, files in _exports().items():
        own = without_provenance(files)
        for file in own:
            with suppress_rotcal():
                make_controller(name).read({**own, file: text})
    for name, files in _volumetric().items():
        own = without_provenance(files)
        with suppress_rotcal():
            make_controller(name).read_components({n: text for n in own if n.endswith(".csv")})


def side_files() -> Iterable[bytes]:
    for files in _exports().values():
        yield from (t.encode() for n, t in files.items() if n.endswith(".provenance.json"))


def read_side_file(path: Path) -> None:
    from rotcal_ros.compensation.controllers import make_controller
    from rotcal_ros.compensation.earlier_export import read_earlier
    from rotcal_ros.compensation.feed import _span
    from rotcal_ros.compensation.held_table import held_table

    text = path.read_bytes().decode(errors="replace")
    _span(text)
    for name, files in _exports().items():
        with suppress_rotcal():
            side = next(n for n in files if n.endswith(".provenance.json"))
            held_table(make_controller(name), {**files, side: text})
    read_earlier(path.parent, "csv", "C")


def machines() -> Iterable[bytes]:
    yield (
        b"[KINS]\nJOINTS = 4\nKINEMATICS = trivkins coordinates=XYZC\n[TRAJ]\nANGULAR_UNITS = "
        b"degree\nLINEAR_UNITS = mm\n[AXIS_C]\nMIN_LIMIT = -999\nMAX_LIMIT = 999\n[JOINT_3]\n"
        b"TYPE = ANGULAR\nMAX_VELOCITY = 30\nMAX_ACCELERATION = 300\nMIN_LIMIT = -999\n"
        b"MAX_LIMIT = 999\nCOMP_FILE = c.comp\nCOMP_FILE_TYPE = 1\n"
    )


def read_machine(path: Path) -> None:
    from rotcal_ros.compensation.linuxcnc import find_loaded_tables
    from rotcal_ros.compensation.linuxcnc_machine import IniFile, Joint

    with suppress_rotcal():
        list(find_loaded_tables(path))
    Joint.of_axis(IniFile.read(path), "C", -1)
