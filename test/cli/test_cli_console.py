"""JSON on standard output, everything else on standard error."""

import json

import click
from click.testing import CliRunner

from rotcal_ros.cli.console import json_option, print_json
from rotcal_ros.report.terminal.console import progress, say


@click.command()
@json_option
def verb(as_json):
    say("working")
    with progress("steps") as shown:
        for done in range(3):
            shown(done, 3)
    if as_json:
        print_json({"third": 1 / 3})


def test_json_is_all_that_standard_output_gets():
    result = CliRunner().invoke(verb, ["--json"])
    assert json.loads(result.stdout) == {"third": 1 / 3}
    assert result.stderr == "working\n"


def test_without_json_standard_output_is_free():
    assert CliRunner().invoke(verb, []).stdout == ""
