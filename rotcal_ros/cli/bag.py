"""``rotcal bag``: describe, check, repair and convert recorded bags.

``--set reading.NAME=VALUE`` sets limits of reading a bag.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timezone
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotcal_ros.bags.settings import ReadingLimits, changed_limits
from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.foundation.circumstances import NOTHING_MEASURED
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.report.terminal.console import progress, say, tell

if TYPE_CHECKING:
    from rotcal_ros.recordings.missing_data import DropoutWithSteps


limits_option = click.option(
    "--set",
    "limits",
    multiple=True,
    metavar="reading.NAME=VALUE",
    callback=lambda _context, _option, changes: changed_limits(changes),
    help="Change a limit of reading: see `rotcal settings reading`.",
)


@click.group()
def command() -> None:
    """Check, repair and describe recorded bags."""


@command.command()
@click.argument("bag", type=path_type)
@limits_option
@json_option
def info(bag: Path, limits: ReadingLimits, as_json: bool) -> int:
    """Show what is in BAG: files, topics, attachments, configuration."""
    from rotcal_ros.recordings.summary import summarise_bag

    with progress("reading") as shown:
        summary = summarise_bag(bag, shown, limits)
    if as_json:
        print_json(summary.to_dict())
    else:
        _print(summary.to_dict())
        _tell(summary.dropouts)
    return 0


@command.command()
@click.argument("bag", type=path_type)
@limits_option
@json_option
def check(bag: Path, limits: ReadingLimits, as_json: bool) -> int:
    """Read BAG to its end and say for each file: complete, truncated or damaged.

    Then say whether a file of the session is missing, whether all belong together, and where
    metadata.yaml is wrong. The exit code is 0 when all is in order, 1 otherwise.
    """
    from rotcal_ros.bags.reader import bag_files, check_files
    from rotcal_ros.bags.session_identity import require_one_session
    from rotcal_ros.bags.session_verdict import judge_session
    from rotcal_ros.recordings.missing_data import match_recorded_dropouts

    files = bag_files(bag)
    with progress("checking") as shown:
        verdicts = check_files(files, shown, limits)
    session = judge_session(bag, verdicts)
    mixed = ""
    try:
        require_one_session(files, limits)
    except BagError as error:
        mixed = str(error)
    dropouts = match_recorded_dropouts(verdicts, limits)
    if as_json:
        print_json({
            "files": [verdict.to_dict() for verdict in verdicts],
            "dropouts": [dropout.to_dict() for dropout in dropouts],
            "session": {**session.to_dict(), "several_sessions": mixed},
        })  # fmt: skip
    else:
        for verdict in verdicts:
            tell(f"{verdict.path}: {verdict.messages} messages, {verdict.describe()}")
            for name, topic in verdict.topics.items():
                if topic.lost:
                    tell(f"  {name}: {topic.lost} lost, {topic.messages} read")
        _tell(dropouts)
        for sentence in (*filter(None, [mixed]), *session.sentences()):
            tell(sentence)
    whole = all(verdict.state == "complete" for verdict in verdicts)
    return 0 if whole and session.sound and not mixed else 1


@command.command()
@click.argument("bag", type=path_type)
@json_option
def reindex(bag: Path, as_json: bool) -> int:
    """Rebuild metadata.yaml of the folder BAG from its files; the old one is kept."""
    from rotcal_ros.bags.repair import reindex as reindex_bag

    with progress("reading") as shown:
        outcome = reindex_bag(bag, shown)
    if as_json:
        old = None if outcome.old is None else str(outcome.old)
        found = outcome.session.to_dict()
        print_json(
            {"path": str(outcome.path), "old": old, "messages": outcome.messages, "session": found}
        )
    else:
        kept = f"; the old one is {outcome.old.name}" if outcome.old else ""
        tell(f"{outcome.path}: {outcome.messages} messages{kept}")
        for sentence in outcome.session.missing:
            tell(sentence)
    return 1 if outcome.session.missing else 0


@command.command()
@click.argument("bag", type=path_type)
@json_option
def choices(bag: Path, as_json: bool) -> int:
    """Show why each step of BAG was measured and why the planner stopped.

    The policy runs again with the recorded observations. The exit code is 0 if it makes the same
    choices, 1 otherwise.
    """
    from rotcal_ros.recordings.replay import read_recording

    with progress("reading") as shown:
        recording = read_recording(bag, "observations", progress=shown)
    differing = recording.choices_that_differ()
    if differing:
        # Nodes that were killed had readings on disk before they could publish the observation.
        with progress("reading the streams") as shown:
            differing = read_recording(bag, progress=shown).choices_that_differ()
    rows = [
        {
            "run": recorded.run,
            "number": recorded.number,
            "step": recorded.choice.step,
            "reason": recorded.choice.reason,
        }
        for recorded in recording.choices
    ]
    if as_json:
        print_json({"choices": rows, "differences": list(differing)})
        return 1 if differing else 0
    for row in rows:
        what = "stop" if row["step"] is None else f"step {row['step']}"
        tell(f"run {row['run']} {row['number']:5} {what}: {row['reason']}")
    if not rows:
        say(f"{bag}: no choice of a planner was recorded, so there is nothing to repeat")
    for text in differing:
        say(text)
    return 1 if differing else 0


@command.command()
@click.argument("bag", type=path_type)
@click.option(
    "-o",
    "--output",
    type=path_type,
    help="New folder for the sound bag; default: BAG's name with _repaired.",
)
@limits_option
@json_option
def repair(bag: Path, output: Path | None, limits: ReadingLimits, as_json: bool) -> int:
    """Write all that can be saved of BAG into a new, sound bag; BAG itself is not touched."""
    from rotcal_ros.bags.reader import bag_files
    from rotcal_ros.bags.repair import repair as repair_bag
    from rotcal_ros.bags.session_identity import require_one_session

    require_one_session(bag_files(bag), limits)
    if output is None and bag.name in ("", ".."):  # as in: cd BAG; rotcal bag repair .
        bag = bag.resolve()
    folder = output or bag.parent / (f"{bag.stem if bag.is_file() else bag.name}_repaired")
    with progress("repairing") as shown:
        outcome = repair_bag(bag, folder, shown, limits)
    if as_json:
        print_json(
            {
                "folder": str(folder.absolute()),
                "before": [verdict.to_dict() for verdict in outcome.before],
                "after": [verdict.to_dict() for verdict in outcome.after],
            }
        )
    else:
        for verdict in outcome.before:
            tell(f"{verdict.path}: {verdict.describe()}")
        saved = sum(verdict.messages for verdict in outcome.after)
        tell(f"{saved} messages saved in {folder.absolute()}")
    return 0


@command.command()
@click.argument("bag", type=path_type)
@click.option("-o", "--output", type=path_type, required=True, help="New folder for the files.")
@json_option
def parquet(bag: Path, output: Path, as_json: bool) -> int:
    """Write the raw streams of BAG as Parquet: one file per topic, one row per message.

    Columns are the fields of the message; times are int64 nanoseconds. The exit code is 1 when
    messages could not be decoded.
    """
    from rotcal_ros.bags.parquet import write_topics

    with progress("reading") as shown:
        topics = write_topics(bag, output, shown)
    for topic in topics:
        if topic.broken:
            say(
                f"{topic.topic}: {topic.broken} messages cannot be decoded"
                + (topic.reason and f": {topic.reason}")
            )
    if as_json:
        rows = [
            {
                "topic": topic.topic,
                "path": None if topic.path is None else str(topic.path.absolute()),
                "messages": topic.messages,
                "broken": topic.broken,
                "why": topic.reason,
            }
            for topic in topics
        ]
        print_json({"folder": str(output.absolute()), "topics": rows})
    else:
        for topic in topics:
            if topic.path is not None:
                click.echo(f"{topic.path}  {topic.messages} messages of {topic.topic}")
    return int(any(topic.broken for topic in topics))


def _tell(dropouts: Sequence[DropoutWithSteps]) -> None:
    """Say what the recorder missed, and when."""
    from rotcal_ros.recordings.missing_data import describe_dropouts

    for sentence in describe_dropouts(dropouts):
        say(sentence)


def _print(summary: dict[str, Any]) -> None:
    """Print files, facts, attachments, losses and topics."""
    from rotcal_ros.bags.storage_scan import losses_in_words

    for file in summary["files"]:
        tell(f"{file['path']}")
        sentence = file["verdict"] if file["offset"] is None else file["sentence"]
        tell(f"  {file['size'] / 1e6:.3f} MB, {file['messages']} messages, {sentence}")
    if summary["start_ns"] is not None:
        start = datetime.fromtimestamp(summary["start_ns"] / 1e9, timezone.utc)
        tell(f"begin     {start:%Y-%m-%d %H:%M:%S} UTC")
        tell(f"duration  {summary['duration_s']:.3f} s")
    if summary["simulated"]:
        tell(NOTHING_MEASURED)
    for name in ("method", "item", "plan_id"):
        if summary[name]:
            tell(f"{name:9} {summary[name]}")
    if summary["attachments"]:
        tell(f"attached  {', '.join(summary['attachments'])}")
    for sentence in (
        *filter(None, [summary["contradiction"]]),
        *losses_in_words(summary["losses_recorded"]),
        *summary["losses_unread"],
    ):
        say(sentence)
    for sentence in chain.from_iterable(
        summary["session"][kind] for kind in ("missing", "differing", "repaired", "closed")
    ):
        say(sentence)
    width = max((len(name) for name in summary["topics"]), default=0)
    for name, topic in summary["topics"].items():
        lost = f", {topic['lost']} lost" if topic["lost"] else ""
        tell(f"  {name:{width}}  {topic['messages']:>10}  {topic['type']}{lost}")
