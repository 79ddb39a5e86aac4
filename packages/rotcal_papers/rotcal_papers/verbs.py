"""``rotcal reproduce``: a paper's tables, figures and claims, computed again."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Final

import click

from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.report.terminal.console import say, tell

PAPERS: Final = ("tracer", "three_rosette", "two_groups", "mirror")
"""The papers, each a module of this name."""


@click.command()
@click.argument("paper", type=click.Choice(PAPERS))
@click.option(
    "-o",
    "--output",
    type=path_type,
    default=Path("out/papers"),
    show_default=True,
    help="Folder for the page and its JSON file; earlier ones there are written anew.",
)
@json_option
def command(paper: str, output: Path, as_json: bool) -> int:
    """Compute a paper's tables, figures and claims again, into one page and one JSON file.

    Beside each claim stands what the paper's own numbers, or a simulation of its experiment, give,
    and what the claim is worth.
    """
    found = import_module(f"rotcal_papers.{paper}").reproduce()
    page, data = found.write(output)
    if as_json:
        print_json(found.to_json().rstrip())
        return 0
    for claim in found.claims:
        tell(f"{claim.finding:16} {claim.where}: {claim.statement}")
    tell("")
    tell(found.summary)
    say(f"page: {page.absolute()}")
    say(f"JSON: {data.absolute()}")
    return 0
