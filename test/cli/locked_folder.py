"""Run by a test, with the rights of anybody: what is said of a folder that must not be read."""

import os
import sys
from pathlib import Path

import click
from click.testing import CliRunner

from rotcal_ros.cli import main
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.recordings.replay import read_recording

locked = sys.argv[1]
if os.access(locked, os.R_OK):
    raise SystemExit(77)
for arguments in (
    ["bag", "check", locked],
    ["bag", "info", f"{locked}/bag_0.mcap"],
    ["bag", "reindex", f"{locked}/inside"],
    ["solve", locked],
    ["solve", f"{locked}/inside"],
):
    result = CliRunner().invoke(main.rotcal, arguments, prog_name="rotcal")
    click.echo(f"{result.exit_code} {result.stderr.splitlines()[-1]}")
try:
    read_recording(Path(locked))
except BagError as error:
    click.echo(f"{error.exit_code} {error}")
