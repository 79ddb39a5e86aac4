"""JSON on standard output, everything else on standard error."""

import json

import click
import pytest
from click.testing import CliRunner

from rotcal_ros.cli.console import json_option, print_json, print_verdict
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


@pytest.mark.parametrize(
    ("line", "colour"),
    [("ok", 32), ("ok (SIMULATED)", 32), ("suspect", 31), ("failed, x", 31)],
)
def test_an_ok_is_green_and_nothing_else_is(line, colour):
    @click.command()
    def shown():
        print_verdict(line, "12 steps")

    output = CliRunner().invoke(shown, color=True).stdout
    assert output == f"\x1b[{colour}mverdict {line}: 12 steps\x1b[0m\n"
