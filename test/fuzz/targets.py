"""What is fuzzed: where good input comes from, how it is harmed, and what must hold of reading it.

A property returns, or raises a RotcalError. Everything else is a finding: another exception, a
text of an error with more than one line, a lie about a bag, a changed input, too long, too large.
"""

from __future__ import annotations

import io
import json
import sqlite3
from collections.abc import Callable, Iterable, Mapping
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Any, Final

import bags_harmed as bags
import texts_harmed as texts

ROOT: Final = Path(__file__).parents[2]
DATA: Final = ROOT / "examples" / "data"


@dataclass(frozen=True)
class Target:
    """``seeds`` yields good inputs, ``read`` is given the file ``name`` with a harmed one."""

    name: str
    seeds: Callable[[], Iterable[bytes]]
    harm: Callable[[Random, bytes], bytes]
    read: Callable[[Path], None]


class LieError(AssertionError):
    """Something was called sound that an independent reader reads otherwise."""


def _files(*names: str) -> Callable[[], Iterable[bytes]]:
    return lambda: [(DATA / name).read_bytes() for name in names]


# Configurations


def _configurations() -> Iterable[bytes]:
    names = ("tracer.yaml", "tracer_six.yaml", "ball_plate.yaml", "plane_mirror.yaml")
    yield from ((DATA / name).read_bytes() for name in names)
    yield (ROOT / "config" / "tracer_demo.yaml").read_bytes()


def _read_configuration(path: Path) -> None:
    from rotcal_ros.catalogue.configuration import node_parameters, read_configuration

    node_parameters(read_configuration(path))


def _read_plan(path: Path) -> None:
    from rotcal_ros.catalogue.calibration import prepare_to_measure
    from rotcal_ros.catalogue.configuration import read_configuration

    prepare_to_measure(read_configuration(path))


def _read_recorded_configuration(path: Path) -> None:
    from rotcal_ros.catalogue.configuration import (
        OFFLINE_GROUPS,
        parse_configuration,
        read_policy,
        read_subject,
    )

    text = path.read_bytes().decode(errors="replace")
    read_policy(text)
    subject, _ = read_subject(text)
    subject.to_dict()
    parse_configuration(text, "bag", OFFLINE_GROUPS)


def _read_setup(path: Path) -> None:
    from rotcal_ros.catalogue.setup_file import read_setup

    read_setup(path)


def _short_setups() -> Iterable[bytes]:
    yield (
        b"method: ball_plate\ngrid: 6\ndiameter_m: 0.02\ncell_m: 0.05\n"
        b"balls: [0, 5, 30, 35]\ntable_step_deg: 30\n"
    )


def _read_goal(path: Path) -> None:
    from rotcal_ros.cli.goal_settings import goal_settings

    goal_settings(None, path, ["need_arcsec=1.0"])


def _read_options(path: Path) -> None:
    from rotcal_ros.catalogue.configuration import changed, parse_configuration
    from rotcal_ros.compensation.options import parse_options

    text = path.read_bytes().decode(errors="replace")
    with suppress_rotcal():
        parse_options([text])
    changed(parse_configuration((DATA / "tracer.yaml").read_text()), [text])


# Tables


@cache
def _setup(name: str) -> Any:
    from rotcal_ros.catalogue.configuration import read_configuration

    return read_configuration(DATA / name)


def _table(setup: str, targets: str = "") -> Callable[[Path], None]:
    def read(path: Path) -> None:
        from rotcal_ros.catalogue.measurements import read_measurements
        from rotcal_ros.tables import is_table

        is_table(path)
        beside = DATA / targets if targets else None
        read_measurements(path, _setup(setup), beside).solve()

    return read


def _read_targets(path: Path) -> None:
    from rotcal_ros.catalogue.tracer.table import read_targets

    read_targets(path)


def _read_reference(path: Path) -> None:
    from rotcal_ros.recordings.sources import read_curve

    read_curve(path, "ECC", None, 1e-6)


def _references() -> Iterable[bytes]:
    rows = (f"{15 * k},{0.5 * (k % 5)},0.1" for k in range(25))
    yield (
        b"angle_deg,deviation_arcsec,u_arcsec\n"
        + "\n".join([*list(rows)[:-1], "360,0.0,0.1"]).encode()
    )


def _read_runs(path: Path) -> None:
    from rotcal_ros.evaluation.iso230 import iso230
    from rotcal_ros.recordings.sources import read_repeated_runs

    iso230(read_repeated_runs(path))


# Results and what stands beside them


def _read_result(path: Path) -> None:
    from rotcal_ros.compensation.table import table_from_result
    from rotcal_ros.curves.measured import measured_curve
    from rotcal_ros.recordings.sources import read_source
    from rotcal_ros.report.terminal.tables import print_result

    result = read_source(path).result
    again = json.loads(result.to_json())
    assert again["verdict"] in ("ok", "suspect", "failed")
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        print_result(result)
    _require_visible(out.getvalue() + err.getvalue())
    for use in (table_from_result, lambda r: measured_curve(r, "ECC")):
        with suppress_rotcal():
            use(result)


def _read_report(path: Path) -> None:
    from rotcal_ros.recordings.sources import read_source
    from rotcal_ros.report.recorded import write_result

    page = path.with_suffix(".html")
    try:
        write_result(read_source(path), page)
        _require_visible(page.read_text(encoding="utf-8"))
    finally:
        page.unlink(missing_ok=True)


def _read_continuation(path: Path) -> None:
    from rotcal_ros.catalogue.continuation import Continuation
    from rotcal_ros.untrusted import read_text

    with suppress(UnicodeDecodeError):
        text = read_text(path)
        Continuation.from_json(Continuation.from_json(text).to_json())


def _continuations() -> Iterable[bytes]:
    from rotcal_ros.catalogue.calibration import prepare
    from rotcal_ros.catalogue.continuation import continued

    calibration = prepare(_setup("tracer.yaml"))
    first = calibration.nominal_observations()[:3]
    left = continued(calibration.plan, "0" * 64, 1, first, max_attempts=3, join_steps=1)
    yield left.to_json().encode()


def _read_request(path: Path) -> None:
    from rotcal_ros.sessions.verification import _read_request as read

    read(path.parent)


def _requests() -> Iterable[bytes]:
    yield json.dumps(
        {"check": ["plan.table_positions=5"], "spacing_deg": 10.0, "controllers": ["fanuc"],
         "accept_unverified": True, "again": False}
    ).encode()  # fmt: skip


# Controllers


def _journals() -> Iterable[bytes]:
    actions = ("applying", "applied", "restoring", "restored", "applying", "rolled_back")
    entries = (
        {"action": action, "time_ns": 10**18 + k, "table_hash": "a" * 64, "backup": "before-1",
         "before_hash": "b" * 64, "after_hash": "c" * 64, "in_force": "none"}
        for k, action in enumerate(actions)
    )  # fmt: skip
    yield "".join(json.dumps(entry) + "\n" for entry in entries).encode()


def _read_journal(path: Path) -> None:
    from rotcal_ros.compensation.journal import CONTENTS, Journal

    kept = path.parent / "before-1"
    kept.mkdir(exist_ok=True)
    (kept / CONTENTS).write_text('{"C.comp": null}')
    journal = Journal(path.parent)
    for read in (journal.entries, journal.to_undo, journal.unfinished, journal.history,
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
    from rotcal_ros.recordings.sources import read_source

    table = table_from_result(read_source(DATA / "result_tracer.json").result)
    found = {}
    for name in controller_names():
        with suppress_rotcal():
            found[name] = prepare_export(
                table, name, now=datetime(2026, 1, 1, tzinfo=timezone.utc), accept_unverified=True
            ).files
    return found


def _controller_files() -> Iterable[bytes]:
    for files in _exports().values():
        for name, text in files.items():
            if not name.endswith(".provenance.json"):
                yield text.encode("latin-1")


def _read_controller_file(path: Path) -> None:
    """Give the file to every controller in the place of its own."""
    from rotcal_ros.compensation.controllers import make_controller
    from rotcal_ros.compensation.writing import of_the_controller

    text = path.read_bytes().decode("latin-1")
    for name, files in _exports().items():
        own = of_the_controller(files)
        for file in own:
            with suppress_rotcal():
                make_controller(name).read({**own, file: text})


def _side_files() -> Iterable[bytes]:
    for files in _exports().values():
        yield from (t.encode() for n, t in files.items() if n.endswith(".provenance.json"))


def _read_side_file(path: Path) -> None:
    from rotcal_ros.compensation.change import _span
    from rotcal_ros.compensation.controllers import make_controller
    from rotcal_ros.compensation.earlier import read_earlier
    from rotcal_ros.compensation.held import held_table

    text = path.read_bytes().decode(errors="replace")
    _span(text)
    for name, files in _exports().items():
        with suppress_rotcal():
            side = next(n for n in files if n.endswith(".provenance.json"))
            held_table(make_controller(name), {**files, side: text})
    read_earlier(path.parent, "csv", "C")


def _machines() -> Iterable[bytes]:
    yield (
        b"[KINS]\nJOINTS = 4\nKINEMATICS = trivkins coordinates=XYZC\n[TRAJ]\nANGULAR_UNITS = "
        b"degree\nLINEAR_UNITS = mm\n[AXIS_C]\nMIN_LIMIT = -999\nMAX_LIMIT = 999\n[JOINT_3]\n"
        b"TYPE = ANGULAR\nMAX_VELOCITY = 30\nMAX_ACCELERATION = 300\nMIN_LIMIT = -999\n"
        b"MAX_LIMIT = 999\nCOMP_FILE = c.comp\nCOMP_FILE_TYPE = 1\n"
    )


def _read_machine(path: Path) -> None:
    from rotcal_ros.compensation.linuxcnc_hookup import hook_up
    from rotcal_ros.compensation.linuxcnc_ini import Ini
    from rotcal_ros.compensation.linuxcnc_machine import Joint

    with suppress_rotcal():
        list(hook_up(path))
    Joint.of_axis(Ini.read(path), "C", -1)


# Bags


def _read_bag(path: Path) -> None:
    from rotcal_ros.bags.reader import bag_files, check_files
    from rotcal_ros.recordings.replay import read_recording
    from rotcal_ros.recordings.summary import describe

    with suppress_rotcal():
        json.dumps(describe(path).to_dict())
    with suppress_rotcal():
        read_recording(path)
    (verdict,) = check_files(bag_files(path))
    verdict.sentence()
    if verdict.state == "complete":
        _compare(path, {n: t.messages for n, t in verdict.topics.items() if t.messages})


def _compare(path: Path, counts: Mapping[str, int]) -> None:
    """Raise LieError unless an independent reader finds the same messages in a sound file."""
    try:
        found = _by_mcap(path) if path.suffix == ".mcap" else _by_sqlite(path)
    except Exception as error:
        raise LieError(f"called complete, but read elsewhere: {error!r}") from error
    if found != counts:
        raise LieError(f"called complete with {dict(counts)}, elsewhere {found}")


def _by_mcap(path: Path) -> dict[str, int]:
    from mcap.reader import NonSeekingReader

    found: dict[str, int] = {}
    with path.open("rb") as file:
        reader = NonSeekingReader(file, validate_crcs=True)
        for _, channel, _ in reader.iter_messages(log_time_order=False):
            found[channel.topic] = found.get(channel.topic, 0) + 1
    return found


def _by_sqlite(path: Path) -> dict[str, int]:
    connection = sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True)
    try:
        (sound,) = connection.execute("PRAGMA integrity_check").fetchone()
        if sound != "ok":
            raise LieError(f"integrity_check: {sound:.80}")
        rows = connection.execute(
            "SELECT name, count(*) FROM messages JOIN topics ON topic_id = topics.id GROUP BY name"
        )
        return dict(rows.fetchall())
    finally:
        connection.close()


def _repair_bag(path: Path) -> None:
    import shutil

    from rotcal_ros.bags.repair import repair

    folder = path.parent / "repaired"
    try:
        outcome = repair(path, folder)
        assert all(verdict.state == "complete" for verdict in outcome.after)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


# All


class suppress_rotcal(suppress):  # noqa: N801  reads like contextlib's
    """Let an expected error pass, if it is one line."""

    def __init__(self) -> None:
        from rotcal_ros.errors import RotcalError

        super().__init__(RotcalError)

    def __exit__(self, kind: Any, error: Any, trace: Any) -> bool:
        if super().__exit__(kind, error, trace):
            require_one_line(error)
            return True
        return False


def require_one_line(error: BaseException) -> None:
    """Raise AssertionError where a RotcalError says more than a line, or nothing."""
    text = str(error)
    if not text or "\n" in text or len(text) > 2000 or "Error(" in text:
        raise AssertionError(f"no sentence for a person: {text[:300]!r}")


def _require_visible(text: str) -> None:
    from rotcal_ros.escapes import printable_lines

    unseen = sorted(set(text) - set(printable_lines(text)))
    assert not unseen, f"shown as they are: {unseen!r}"


TARGETS: Final[Mapping[str, Target]] = {
    target.name.partition("/")[0]: target
    for target in (
        Target("configuration/c.yaml", _configurations, texts.harmed_yaml, _read_configuration),
        Target("plan/c.yaml", _configurations, texts.harmed_yaml, _read_plan),
        Target("recorded/c.yaml", _configurations, texts.harmed_yaml,
               _read_recorded_configuration),
        Target("setup/c.yaml", _short_setups, texts.harmed_yaml, _read_setup),
        Target("goal/g.yaml", lambda: [b"need_arcsec: 1.2\nlargest_arcsec: 2.5\nkeep_out_m: []\n"],
               texts.harmed_yaml, _read_goal),
        Target("options/o.txt", lambda: [b"solver.zero=auto", b"plan.box_points=[2, 2, 2]"],
               texts.harmed_yaml, _read_options),
        Target("lengths/lengths.csv", _files("lengths.csv"), texts.harmed_csv,
               _table("tracer.yaml", "targets.csv")),
        Target("balls/balls.csv", _files("balls.csv"), texts.harmed_csv,
               _table("ball_plate.yaml")),
        Target("tracker/tracker.csv", _files("tracker.csv"), texts.harmed_csv,
               _table("plane_mirror.yaml")),
        Target("targets/targets.csv", _files("targets.csv"), texts.harmed_csv, _read_targets),
        Target("reference/r.csv", _references, texts.harmed_csv, _read_reference),
        Target("runs/runs.csv", _files("runs.csv"), texts.harmed_csv, _read_runs),
        Target("result/result.json", _files("result_tracer.json", "result_ball_plate.json"),
               texts.harmed_json, _read_result),
        Target("report/result.json", _files("result_tracer.json", "result_ball_plate.json"),
               texts.harmed_json, _read_report),
        Target("continuation/continuation.json", _continuations, texts.harmed_json,
               _read_continuation),
        Target("request/verify.json", _requests, texts.harmed_json, _read_request),
        Target("journal/journal.jsonl", _journals, texts.harmed_json_lines, _read_journal),
        Target("sidefile/c_csv.provenance.json", _side_files, texts.harmed_json, _read_side_file),
        Target("controller/table.txt", _controller_files, texts.harmed_lines,
               _read_controller_file),
        Target("machine/machine.ini", _machines, texts.harmed_lines, _read_machine),
        Target("mcap/bag_0.mcap", lambda: bags.mcap_seeds(), bags.harmed_mcap, _read_bag),
        Target("mcaprepair/bag_0.mcap", lambda: bags.mcap_seeds(), bags.harmed_mcap, _repair_bag),
        Target("sqlite/bag_0.db3", lambda: bags.sqlite_seeds(), bags.harmed_sqlite, _read_bag),
        Target("sqliterepair/bag_0.db3", lambda: bags.sqlite_seeds(), bags.harmed_sqlite,
               _repair_bag),
    )
}  # fmt: skip
"""All targets by name."""
