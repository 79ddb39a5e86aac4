"""``rotcal web``: a page of this machine on which a table of numbers is solved."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Timer

import click

from rotcal_ros.report.terminal.console import say, tell
from rotcal_ros.sessions.processes import page_can_be_served

OPENED_AFTER_S = 0.5


@click.command()
@click.option(
    "--port",
    type=click.IntRange(0, 65_535),
    default=0,
    show_default=True,
    help="Port of the page; 0: any free one.",
)
@click.option("--no-browser", is_flag=True, help="Print the address and open nothing.")
def command(port: int, no_browser: bool) -> int:
    """Open a page on which a table of numbers is solved; Ctrl-C ends it.

    Drop the table, see how it is understood, correct that, solve, and take report, certificate and
    files of a controller along. Only this machine reaches the page, by the address that is printed
    and that works once. What was dropped is gone when the page ends.
    """
    if not page_can_be_served():
        return 2
    from rotcal_tables.web import serve

    def opened(address: str) -> None:
        tell(address)
        say("open this address in a browser, once; Ctrl-C ends the page")
        if not no_browser:
            Timer(OPENED_AFTER_S, webbrowser.open, (address,)).start()

    with TemporaryDirectory(prefix="rotcal-web-") as folder:
        serve(Path(folder), port, opened)
    return 0
