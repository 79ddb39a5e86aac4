"""``rotcal bag``: describe, check and repair recorded bags."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import click

from rotcal_ros.circumstances import NOTHING_MEASURED
from rotcal_ros.cli.bag_parquet import command as parquet
from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.report.terminal.console import progress, say


@click.group()
def command() -> None:
    """Check, repair and describe recorded bags."""


command.add_command(parquet)


@command.command()
@click.argument("bag", type=path_type)
@json_option
def info(bag: Path, as_json: bool) -> int:
    """Tell what is in BAG: files, topics, attachments, configuration."""
    from rotcal_ros.recordings.summary import describe

    with progress("reading") as shown:
        summary = describe(bag, shown)
    if as_json:
        print_json(summary.to_dict())
    else:
        _print(summary.to_dict())
    return 0


@command.command()
@click.argument("bag", type=path_type)
@json_option
def check(bag: Path, as_json: bool) -> int:
    """Read BAG to its end and say for each file: complete, truncated or damaged.

    The exit code is 0 when all files are complete, 1 otherwise.
    """
    from rotcal_ros.bags.reader import bag_files, check_files

    with progress("checking") as shown:
        verdicts = check_files(bag_files(bag), shown)
    if as_json:
        print_json({"files": [verdict.to_dict() for verdict in verdicts]})
    else:
        for verdict in verdicts:
            click.echo(f"{verdict.path}: {verdict.messages} messages, {verdict.sentence()}")
            for name, topic in verdict.topics.items():
                if topic.lost:
                    click.echo(f"  {name}: {topic.lost} lost, {topic.messages} read")
    return 0 if all(verdict.state == "complete" for verdict in verdicts) else 1


@command.command()
@click.argument("bag", type=path_type)
@json_option
def choices(bag: Path, as_json: bool) -> int:
    """Say why each step of BAG was measured and why the planner stopped.

    The policy is asked again with the recorded observations. The exit code is 0 when it makes the
    same choices, 1 otherwise.
    """
    from rotcal_ros.recordings.replay import read_recording

    with progress("reading") as shown:
        recording = read_recording(bag, "observations", progress=shown)
    differing = recording.choices_that_differ()
    if differing:
        # Nodes that were killed had readings on disk before they could tell what they are.
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
        click.echo(f"run {row['run']} {row['number']:5} {what}: {row['reason']}")
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
@json_option
def repair(bag: Path, output: Path | None, as_json: bool) -> int:
    """Write all that can be saved of BAG into a new, sound bag; BAG itself is not touched."""
    from rotcal_ros.bags.repair import repair as repair_bag

    folder = output or bag.with_name(f"{bag.stem if bag.is_file() else bag.name}_repaired")
    with progress("repairing") as shown:
        outcome = repair_bag(bag, folder, shown)
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
            click.echo(f"{verdict.path}: {verdict.sentence()}")
        saved = sum(verdict.messages for verdict in outcome.after)
        click.echo(f"{saved} messages saved in {folder.absolute()}")
    return 0


def _print(summary: dict[str, Any]) -> None:
    """Print files, facts, attachments, losses and topics."""
    from rotcal_ros.bags.verdict import losses_in_words

    for file in summary["files"]:
        click.echo(f"{file['path']}")
        click.echo(f"  {file['size'] / 1e6:.3f} MB, {file['messages']} messages, ", nl=False)
        click.echo(file["verdict"] if file["offset"] is None else file["sentence"])
    if summary["start_ns"] is not None:
        start = datetime.fromtimestamp(summary["start_ns"] / 1e9, timezone.utc)
        click.echo(f"begin     {start:%Y-%m-%d %H:%M:%S} UTC")
        click.echo(f"duration  {summary['duration_s']:.3f} s")
    if summary["simulated"]:
        click.echo(NOTHING_MEASURED)
    for name in ("method", "item", "plan_id"):
        if summary[name]:
            click.echo(f"{name:9} {summary[name]}")
    if summary["attachments"]:
        click.echo(f"attached  {', '.join(summary['attachments'])}")
    for sentence in losses_in_words(summary["losses_recorded"]):
        say(sentence)
    width = max((len(name) for name in summary["topics"]), default=0)
    for name, topic in summary["topics"].items():
        lost = f", {topic['lost']} lost" if topic["lost"] else ""
        click.echo(f"  {name:{width}}  {topic['messages']:>10}  {topic['type']}{lost}")
