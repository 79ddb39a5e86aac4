"""What is fuzzed: where good input comes from, how it is harmed, and what must hold of reading it.

A property returns, or raises a RotcalError. Everything else is a finding: another exception, a
text of an error with more than one line, a lie about a bag, a changed input, too long, too large.
"""

from __future__ import annotations

import io
import json
import runpy
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Any, Final

import bags_harmed as bags
import bags_read as reading
import controllers_read as controllers
import metadata_read as metadata
import texts_harmed as texts
from properties import require_visible, suppress_rotcal

ROOT: Final = Path(__file__).parents[2]
DATA: Final = ROOT / "examples" / "data"


@dataclass(frozen=True)
class Target:
    """``seeds`` yields good inputs, ``read`` is given the file ``name`` with a harmed one."""

    name: str
    seeds: Callable[[], Iterable[bytes]]
    harm: Callable[[Random, bytes], bytes]
    read: Callable[[Path], None]


def _files(*names: str) -> Callable[[], Iterable[bytes]]:
    return lambda: [(DATA / name).read_bytes() for name in names]


# Configurations


def _configurations() -> Iterable[bytes]:
    names = ("tracer.yaml", "tracer_six.yaml", "ball_plate.yaml", "plane_mirror.yaml")
    yield from ((DATA / name).read_bytes() for name in names)
    yield (ROOT / "config" / "tracer_demo.yaml").read_bytes()


def _read_configuration(path: Path) -> None:
    from rotcal_ros.methods.configuration import node_parameters, read_configuration

    node_parameters(read_configuration(path))


def _read_plan(path: Path) -> None:
    from rotcal_ros.methods.calibration import prepare_to_measure
    from rotcal_ros.methods.configuration import read_configuration

    prepare_to_measure(read_configuration(path))


def _read_recorded_configuration(path: Path) -> None:
    from rotcal_ros.methods.configuration import (
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
    from rotcal_ros.methods.configuration import read_configuration

    read_configuration(path)


def _short_setups() -> Iterable[bytes]:
    yield (
        b"method: ball_plate\ngrid: 6\ndiameter_m: 0.02\ncell_m: 0.05\n"
        b"balls: [0, 5, 30, 35]\ntable_step_deg: 30\n"
    )
    yield (
        b"method: tracer_six\nplaces_m: [[0.1, 0, 0.2], [0, 0.1, 0.2]]\nlength_std_m: 3e-8\n"
        b"plan: {table_positions: 4}\nidentity: {item: a table, measured: 2026-03-31}\n"
    )


def _read_options(path: Path) -> None:
    from rotcal_ros.compensation.controllers import parse_options
    from rotcal_ros.methods.configuration import changed, parse_configuration

    text = path.read_bytes().decode(errors="replace")
    with suppress_rotcal():
        parse_options([text])
    changed(parse_configuration((DATA / "tracer.yaml").read_text()), [text])


# Tables


@cache
def _setup(name: str) -> Any:
    from rotcal_ros.methods.configuration import read_configuration

    return read_configuration(DATA / name)


def _table(setup: str, targets: str = "") -> Callable[[Path], None]:
    def read(path: Path) -> None:
        from rotcal_ros.foundation.tables import is_table
        from rotcal_ros.methods.measurements import read_measurements

        is_table(path)
        beside = DATA / targets if targets else None
        read_measurements(path, _setup(setup), beside).solve()

    return read


def _read_targets(path: Path) -> None:
    from rotcal_ros.methods.tracer.table import read_targets

    read_targets(path)


def _read_reference(path: Path) -> None:
    from rotcal_ros.recordings.result_sources import References, read_curve

    read_curve(path, "ECC", References(1e-6))


def _references() -> Iterable[bytes]:
    rows = (f"{15 * k},{0.5 * (k % 5)},0.1" for k in range(25))
    yield (
        b"angle_deg,deviation_arcsec,u_arcsec\n"
        + "\n".join([*list(rows)[:-1], "360,0.0,0.1"]).encode()
    )


def _read_runs(path: Path) -> None:
    from rotcal_ros.evaluation.iso230 import iso230
    from rotcal_ros.recordings.result_sources import read_repeated_runs

    iso230(read_repeated_runs(path))


# Results and what stands beside them


def _read_result(path: Path) -> None:
    from rotcal_ros.compensation.table import table_from_result
    from rotcal_ros.foundation.curves.measured import measured_curve
    from rotcal_ros.recordings.result_sources import read_source
    from rotcal_ros.report.terminal.tables import print_result

    result = read_source(path).result
    again = json.loads(result.to_json())
    assert again["verdict"] in ("ok", "suspect", "failed")
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        print_result(result)
    require_visible(out.getvalue() + err.getvalue())
    for use in (table_from_result, lambda r: measured_curve(r, "ECC")):
        with suppress_rotcal():
            use(result)


def _read_report(path: Path) -> None:
    from rotcal_ros.recordings.result_sources import read_source
    from rotcal_ros.report.page import report_result

    page = path.with_suffix(".html")
    try:
        report_result(read_source(path), page)
        require_visible(page.read_text(encoding="utf-8"))
    finally:
        page.unlink(missing_ok=True)


def _read_continuation(path: Path) -> None:
    from rotcal_ros.foundation.untrusted import read_text
    from rotcal_ros.methods.continuation import Continuation

    with suppress(UnicodeDecodeError):
        text = read_text(path)
        Continuation.from_json(Continuation.from_json(text).to_json())


def _continuations() -> Iterable[bytes]:
    from rotcal_ros.methods.calibration import prepare
    from rotcal_ros.methods.continuation import continued

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


def _beside() -> Iterator[Target]:
    """Yield the targets of the packages beside the core that are installed."""
    for path in sorted(ROOT.glob("packages/*/test/fuzz_targets.py")):
        with suppress(ModuleNotFoundError):
            yield from runpy.run_path(str(path))["TARGETS"]


TARGETS: Final[Mapping[str, Target]] = {
    target.name.partition("/")[0]: target
    for target in (
        Target("configuration/c.yaml", _configurations, texts.harmed_yaml, _read_configuration),
        Target("plan/c.yaml", _configurations, texts.harmed_yaml, _read_plan),
        Target("recorded/c.yaml", _configurations, texts.harmed_yaml,
               _read_recorded_configuration),
        Target("setup/c.yaml", _short_setups, texts.harmed_yaml, _read_setup),
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
        Target("journal/journal.jsonl", controllers.journals, texts.harmed_json_lines,
               controllers.read_journal),
        Target("sidefile/c_csv.provenance.json", controllers.side_files, texts.harmed_json,
               controllers.read_side_file),
        Target("controller/table.txt", controllers.controller_files, texts.harmed_lines,
               controllers.read_controller_file),
        Target("machine/machine.ini", controllers.machines, texts.harmed_lines,
               controllers.read_machine),
        Target("metadata/metadata.yaml", metadata.descriptions, texts.harmed_yaml,
               metadata.read_description),
        Target("mcap/bag_0.mcap", lambda: bags.mcap_seeds(), bags.harmed_mcap, reading.read_bag),
        Target("mcaprepair/bag_0.mcap", lambda: bags.mcap_seeds(), bags.harmed_mcap,
               reading.repair_bag),
        Target("sqlite/bag_0.db3", lambda: bags.sqlite_seeds(), bags.harmed_sqlite,
               reading.read_bag),
        Target("sqliterepair/bag_0.db3", lambda: bags.sqlite_seeds(), bags.harmed_sqlite,
               reading.repair_bag),
        *_beside(),
    )
}  # fmt: skip
"""All targets by name."""
