"""Carry out ``rotcal`` commands in this process: from JSON on standard input to JSON on output.

The tests start it with an arithmetic of its own, which has to be chosen before numpy is loaded.
"""

import json
import sys

from click.testing import CliRunner

from rotcal_ros.cli.main import rotcal

outcomes = {}
for name, words in json.load(sys.stdin).items():
    run = CliRunner().invoke(rotcal, words)
    outcomes[name] = {"code": run.exit_code, "out": run.stdout, "error": run.stderr}
json.dump(outcomes, sys.stdout)
