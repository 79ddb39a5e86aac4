"""Make the golden bags again, by the present code: ``python test/golden/record.py FOLDER``.

What each holds stands in README.md. Configurations are those in the bags that are here;
new sessions go below FOLDER, from where bag and result.json are copied by hand once they are good.
"""

import os
import signal
import subprocess
import sys
from pathlib import Path

from test_golden import ARITHMETIC, METHODS

from rotcal_ros.bags import names
from rotcal_ros.bags.reader import read_blocks

GOLDEN = Path(__file__).parent
BROKEN_OFF = {"tracer": "24 of 60 steps"}
"""After this line of its output a run is ended by Ctrl-C, and continued."""


def configuration_of(bag: Path) -> bytes:
    """Return the configuration in a bag, which is read to its end for that."""
    scans = [scan for scan, _ in read_blocks([bag / "bag_0.mcap"])]
    return scans[-1].attachments[names.CONFIGURATION].data


def rotcal(*words: str | Path, until: str = "") -> None:
    """Carry out a command; with ``until`` it is interrupted when a line begins with that."""
    command = [sys.executable, "-m", "rotcal_ros.cli.main", *map(str, words)]
    with subprocess.Popen(
        command, env={**os.environ, **ARITHMETIC, "PYTHONUNBUFFERED": "1"},
        stderr=subprocess.STDOUT, stdout=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        for line in process.stdout:
            sys.stdout.write(line)
            if until and line.startswith(until):
                process.send_signal(signal.SIGINT)
    sys.stdout.write(f"{words} ends with {process.returncode}\n")


def record(method: str, folder: Path) -> None:
    """Record one session below ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    file, session = folder / f"{method}.yaml", folder / method
    file.write_bytes(configuration_of(GOLDEN / method / "bag"))
    quiet = ("--no-report", "--no-export", "--no-page")
    rotcal("run", file, "--output", session, *quiet, until=BROKEN_OFF.get(method, ""))
    if method in BROKEN_OFF:
        rotcal("run", file, "--resume", session, *quiet)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a job ignores it
    for name in sys.argv[2:] or METHODS:
        record(name, Path(sys.argv[1]))
