"""``rotcal replay``: a recorded bag, published again for nodes and viewers."""

from __future__ import annotations

import json
import math
import os
import signal
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import click

from rotcal_ros.bags.unread_data import note_unread
from rotcal_ros.cli.console import (
    INTERRUPTED,
    VERDICT_EXIT_CODES,
    NamedFile,
    path_type,
    print_marks,
)
from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.report.terminal.console import progress, say, tell
from rotcal_ros.sessions.processes import Processes, require_ros

LEAST_RATE, LARGEST_RATE = 0.01, 100.0
PLAYER: Final = "player"
"""The process that replays."""
_ERRORS: Final = {2: ConfigurationError, 3: DataError}
"""The exit code of the process shows the kind of its error."""


def _rate(_context: click.Context, _option: click.Parameter, value: float) -> float:
    """Refuse an invalid pace."""
    if not math.isfinite(value) or not LEAST_RATE <= value <= LARGEST_RATE:
        raise click.BadParameter(
            f"{value:g} is not a valid pace: expected {LEAST_RATE:g} (slow motion) to "
            f"{LARGEST_RATE:g} (fast)"
        )
    return value


@click.command()
@click.argument("bag", type=path_type)
@click.option(
    "--rate", type=float, default=1.0, show_default=True, callback=_rate, metavar="R",
    help="Seconds of the recording that pass in one second.",
)  # fmt: skip
@click.option("--clock", is_flag=True, help="Publish the time of the recording on /clock.")
@click.option(
    "--all", "everything", is_flag=True, help="Also publish what nodes had made of the streams."
)
@click.option("--no-finish", is_flag=True, help="Do not ask a live solver for the result.")
@click.option(
    "--result",
    type=NamedFile(".json"),
    metavar="FILE",
    help="Keep the result of the live solver as JSON.",
)
@click.option(
    "--wait-for", "nodes", multiple=True, metavar="NODE", help="Begin when this node has appeared."
)
@click.option(
    "--watcher", "watchers", multiple=True, metavar="NODE",
    help="A node that listens to orders and moves nothing.",
)  # fmt: skip
def command(
    bag: Path,
    rate: float,
    clock: bool,
    everything: bool,
    no_finish: bool,
    result: Path | None,
    nodes: tuple[str, ...],
    watchers: tuple[str, ...],
) -> int:
    """Publish BAG as it was recorded, so that nodes and viewers work without a machine.

    The plan, the orders and the streams of the instruments are published, with their recorded
    quality of service. What nodes derived from them is not: a live capture and a live solver make
    it again, equal to the last bit. A live solver is asked for its result at the end. Nothing is
    replayed where a machine listens to orders. Ctrl-C ends it.
    """
    require_ros()
    options = [f"--rate={rate!r}", *(["--clock"] if clock else [])]
    options += [*(["--all"] if everything else []), *(["--no-finish"] if no_finish else [])]
    options += [f"--watcher={name}" for name in watchers]
    options += [f"--wait-for={name}" for name in nodes]
    options += [] if result is None else [f"--result={result.absolute()}"]
    outcome = replay(bag.absolute(), options)
    if outcome.get("interrupted"):
        say("interrupted")
        return INTERRUPTED
    if "recorded" in outcome:
        tell(_observations(outcome))
    if "verdict_line" not in outcome:
        tell("replayed")
        return 1 if outcome.get("different") else 0
    print_marks(outcome["marks"], "result of the live solver")
    return 1 if outcome["different"] else VERDICT_EXIT_CODES[outcome["verdict"]]


def replay(bag: Path, options: Sequence[str]) -> dict[str, Any]:
    """Have ``bag`` published with the options of the player and return its outcome.

    ``interrupted`` is true when the user ended it. Raises the error that it ended with.
    """
    command = [sys.executable, "-m", "rotcal_ros.nodes.player.node", str(bag), *options]
    environment = {"PYTHONUNBUFFERED": "1", "ROTCAL_SUPERVISOR": str(os.getpid())}
    previous = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with (
            tempfile.TemporaryDirectory(prefix="rotcal-replay-") as folder,
            Processes(Path(folder), environment) as processes,
        ):
            processes.start(PLAYER, command, piped=True)
            return _followed(processes)
    except KeyboardInterrupt:
        return {"interrupted": True}
    finally:
        signal.signal(signal.SIGTERM, previous)


def _followed(processes: Processes) -> dict[str, Any]:
    """Show what the player reports until it ends."""
    child = processes.children[PLAYER]
    outcome: dict[str, Any] = {}
    assert child.stdout is not None
    with progress("replaying") as shown:
        for line in child.stdout:
            event = json.loads(line)
            match event.pop("event"):
                case "left_out":
                    say(f"left out: {event['topic']}: {event['why']}")
                case "unread":
                    note_unread(event["texts"])
                case "note":
                    say(event["text"])
                case "playing":
                    shown(round(event["done_s"]), max(1, round(event["total_s"])))
                case "result":
                    outcome = event
                case "interrupted":
                    outcome = {"interrupted": True}
    if code := child.wait():
        text = processes.log_tail(PLAYER, 1)
        if not text:
            raise DataError(
                f"the player ended (exit code {code}) without a message: run it again with --debug"
            )
        raise _ERRORS.get(code, BagError)(text)
    return outcome


def _observations(outcome: dict[str, int]) -> str:
    """Return how the live observations compare with the recorded ones."""
    count, different = outcome["observed"], outcome["different"]
    if not outcome["recorded"]:
        return f"{count} accepted observations, none is recorded"
    if not different:
        return f"{count} accepted observations, equal to the recorded ones to the last bit"
    return (
        f"{count} accepted observations, {outcome['recorded']} are recorded; {different} differ, "
        f"first {outcome['first_different']}: were the nodes there from the beginning, and fast "
        "enough for this rate?"
    )
