"""``rotcal report``: the self-contained HTML page of a recording."""

from __future__ import annotations

import json
from pathlib import Path

import click

from rotcal_ros.cli.console import VERDICT_EXIT_CODES
from rotcal_ros.errors import BagError
from rotcal_ros.report.terminal.console import say


@click.command()
@click.argument("bag", type=click.Path(exists=True, path_type=Path))
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="The page to write; report.html beside the bag unless given. Never overwrites.",
)
@click.option(
    "--truth",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="truth.json of a simulation, drawn beside the result.",
)
def command(bag: Path, output: Path | None, truth: Path | None) -> int:
    """Solve BAG again and write the report: figures, tables, warnings, verdict, fingerprints."""
    # Figures take a second to load; a wrong option should not wait for them.
    from rotcal_ros.recordings.replay import read_recording
    from rotcal_ros.report.recorded import write_recorded

    output = output or (bag if bag.is_dir() else bag.parent) / "report.html"
    if output.exists():
        raise BagError(f"{output} exists and is not overwritten; name another file with -o")
    injected = None if truth is None else json.loads(truth.read_text(encoding="utf-8"))
    result = write_recorded(read_recording(bag), output, injected)
    say(f"report: {output.absolute()}")
    return VERDICT_EXIT_CODES[result.verdict]
