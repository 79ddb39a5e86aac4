"""``rotcal bag parquet``: the raw streams of a bag for other programs."""

from __future__ import annotations

from pathlib import Path

import click

from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.report.terminal.console import progress, say


@click.command("parquet")
@click.argument("bag", type=path_type)
@click.option("-o", "--output", type=path_type, required=True, help="New folder for the files.")
@json_option
def command(bag: Path, output: Path, as_json: bool) -> int:
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
                + (topic.why and f": {topic.why}")
            )
    if as_json:
        rows = [
            {
                "topic": topic.topic,
                "path": None if topic.path is None else str(topic.path.absolute()),
                "messages": topic.messages,
                "broken": topic.broken,
                "why": topic.why,
            }
            for topic in topics
        ]
        print_json({"folder": str(output.absolute()), "topics": rows})
    else:
        for topic in topics:
            if topic.path is not None:
                click.echo(f"{topic.path}  {topic.messages} messages of {topic.topic}")
    return int(any(topic.broken for topic in topics))
