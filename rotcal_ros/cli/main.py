"""The command ``rotcal``: one verb per file, loaded only when it is called."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from importlib import import_module
from typing import Final

import click

from rotcal_ros import __version__
from rotcal_ros.cli.console import INTERRUPTED
from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.escapes import printable

UNREADABLE: Final = 2
BROKEN_PIPE: Final = 141
"""The exit code that a shell reports for a program ended by SIGPIPE."""

OF_PIP_ALONE: Final = ("mcap", "rosbags", "threadpoolctl")
"""What no package of a distribution can depend on: package.xml leaves it to the user."""

VERBS: Final[Mapping[str, str]] = {
    "run": "Run the nodes of one cell and calibrate.",
    "attach": "Show a calibration that runs in the background.",
    "cell": "Look at a live cell: what is there, what is missing?",
    "verify": "Measure the simulated cell, compensate it, and measure again.",
    "solve": "Solve a recorded bag or a plain table, without ROS.",
    "reprocess": "Solve many bags with one configuration, on all cores or a cluster.",
    "export": "Write the correction table of a calibration for a controller.",
    "plan": "Plan what to measure, in what order, and what it could hide.",
    "report": "Write the self-contained HTML report of a calibration.",
    "compare": "Compare results of one table, and references: do they agree?",
    "check": "Check quickly: is an earlier result still valid?",
    "combine": "Combine results of one table: the best estimate of all.",
    "iso230": "Evaluate repeated bidirectional runs after ISO 230-2.",
    "uncertainty": "Propagate the noise by Monte Carlo (JCGM 101).",
    "bag": "Check, repair and describe recorded bags.",
    "replay": "Publish a recorded bag again, for nodes and viewers.",
    "dme": "Serve the simulated cell to clients of I++ DME.",
    "settings": "Print what can be set, with units, ranges and defaults.",
    "doctor": "Check this machine and say what to do.",
}
"""Verb -> one line of help. The verb lives in ``rotcal_ros/cli/<verb>.py`` as ``command``."""


class LazyGroup(click.Group):
    """A group that lists :data:`VERBS` and imports a verb's module only when it is called."""

    def list_commands(self, _context: click.Context) -> list[str]:
        """Return the verbs in the order in which they are used."""
        return list(VERBS)

    def get_command(self, _context: click.Context, name: str) -> click.Command | None:
        """Import ``rotcal_ros.cli.<name>`` and return its ``command``; None if unknown."""
        if name not in VERBS:
            return None
        _compute_in_one_thread()
        command: click.Command = import_module(f"rotcal_ros.cli.{name}").command
        return command

    def shell_complete(
        self, context: click.Context, incomplete: str
    ) -> list[click.shell_completion.CompletionItem]:
        """Offer the verbs without importing any of them; behind a dash, the options."""
        from click.shell_completion import CompletionItem

        verbs = [
            CompletionItem(name, help=text)
            for name, text in VERBS.items()
            if name.startswith(incomplete)
        ]
        return verbs or super().shell_complete(context, incomplete)

    def resolve_command(
        self, context: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the verb; a misspelt one fails with the name that was probably meant."""
        name = args[0]
        if name not in VERBS and not name.startswith("-"):
            from rotcal_ros.foundation.plugins import nearest

            context.fail(f"no verb {name!r}{nearest(name, VERBS)}")
        return super().resolve_command(context, args)

    def format_commands(self, _context: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of verbs from :data:`VERBS`, without importing any of them."""
        with formatter.section("Verbs"):
            formatter.write_dl(list(VERBS.items()))

    def invoke(self, context: click.Context) -> None:
        """Run a verb; an error becomes one red line and an exit code, not a traceback.

        A verb may return its exit code. What it could not read of a bag and did not print is
        reported after it, in a line each, and turns a good exit code into 1. Wrong usage is left
        to click. The reader of standard output may have read enough (``| head``): that ends the
        verb silently.
        """
        from rotcal_ros.bags.unread_data import unread

        with unread() as missing:
            code = self._code_of(context)
        for text in (text for text, by_verb in missing.items() if not by_verb):
            _complain(f"not all was read: {text}")
        context.exit(code or int(bool(missing)))

    def _code_of(self, context: click.Context) -> int:
        """Run a verb and return its exit code."""
        try:
            code = super().invoke(context)
            sys.stdout.flush()
        except (click.ClickException, click.exceptions.Exit):
            raise
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            code = BROKEN_PIPE
        except (KeyboardInterrupt, click.Abort):
            _complain("interrupted")
            code = INTERRUPTED
        except Exception as error:
            if context.params["debug"]:
                raise
            code = _explain(error)
        return code if isinstance(code, int) else 0


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"]},
    subcommand_metavar="VERB ...",
    epilog="Exit codes: 0 good, 1 the verdict is bad or not all of a bag was read, 2 wrong usage "
    "or unreadable input, 3 not enough or contradictory data, 130 interrupted, 141 the reader of "
    "the output left.",
)
@click.version_option(__version__, prog_name="rotcal")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def rotcal(debug: bool) -> None:
    """Find and remove the six small errors of a rotary table at every angle."""


def main() -> None:
    """Run ``rotcal`` and exit with its exit code."""
    rotcal(prog_name="rotcal")


def _compute_in_one_thread() -> None:
    """Let numpy, which reads this once when it is loaded, use one thread; the user may want more.

    The last bit of a matrix product depends on the number of threads that share it, and the live
    nodes use one: only with one does 'rotcal solve' repeat their result to the last bit.
    """
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")


def _explain(error: Exception) -> int:
    """Print one red line for ``error`` and return its exit code."""
    if isinstance(error, RotcalError):
        _complain(str(error), *error.log.splitlines())
        return error.exit_code
    if isinstance(error, ModuleNotFoundError) and error.name in OF_PIP_ALONE:
        _complain(f"{error.name} is missing: pip install {' '.join(OF_PIP_ALONE)}")
        return UNREADABLE
    from rotcal_ros.foundation.plugins import culprit, in_words

    if isinstance(error, OSError) and error.strerror and not culprit(error):
        _complain(f"{error.strerror}: {error.filename}" if error.filename else error.strerror)
    else:
        _complain(f"unexpected {in_words(error)} ('rotcal --debug ...' shows where)")
    return UNREADABLE


def _complain(text: str, *log: str) -> None:
    for line in (f"rotcal: {text}", *log):
        click.secho(printable(line), fg="red", err=True)


if __name__ == "__main__":
    main()
