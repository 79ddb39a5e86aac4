"""The command ``rotcal``: one verb per file, loaded only when it is called."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Final

import click

from rotcal_ros import __version__
from rotcal_ros.cli.console import INTERRUPTED, error_lines
from rotcal_ros.foundation.errors import ConfigurationError, RotcalError
from rotcal_ros.foundation.escapes import printable
from rotcal_ros.foundation.url_secrets import has_secret, mask_secrets, secret_error_text

if TYPE_CHECKING:
    from rotcal_ros.foundation.plugins import Verb

UNREADABLE: Final = 2
BROKEN_PIPE: Final = 141
"""The exit code that a shell reports for a program ended by SIGPIPE."""

OWN_VERBS: Final[Mapping[str, str]] = {
    "new": "Write a set-up for measurements of your own.",
    "run": "Run the nodes of one cell and calibrate.",
    "attach": "Show a calibration that runs in the background.",
    "cell": "Examine a live cell: what is there, what is missing?",
    "verify": "Measure, compensate, measure again; or judge before and after.",
    "solve": "Solve a recorded bag or a table of numbers, without ROS.",
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
    "settings": "Print the settings to state first for a method, or all settings.",
    "doctor": "Check this machine and say what to do.",
}
"""Verb -> one line of help. The verb lives in ``rotcal_ros/cli/<verb>.py`` as ``command``."""
SECTIONS: Final[Mapping[str, tuple[str, ...]]] = {
    "Most used": ("run", "new", "solve", "report", "export", "check", "plan", "doctor"),
    "Measure": ("attach", "cell", "verify"),
    "Evaluate": ("compare", "combine", "iso230", "uncertainty"),
    "Set-ups and recordings": ("settings", "bag", "replay"),
}
"""Heading of the help -> its verbs; those of other packages stand behind the one they follow."""


@cache
def verbs() -> Mapping[str, Verb]:
    """Return all verbs in the order of use: our own, then those of other packages.

    One that cannot be loaded comes last and says so.
    """
    from rotcal_ros.foundation.plugins import VERBS, Verb, load, names

    found = {name: Verb(text, f"rotcal_ros.cli.{name}") for name, text in OWN_VERBS.items()}
    order = list(found)
    for name in names(VERBS):
        try:
            verb = load(VERBS, name, "verb")
        except ConfigurationError as error:
            verb = Verb(str(error), "")
        if found.setdefault(name, verb) is verb:
            place = order.index(verb.after) + 1 if verb.after in order else len(order)
            order.insert(place, name)
    return {name: found[name] for name in order}


class LazyGroup(click.Group):
    """A group that lists :func:`verbs` and imports a verb's module only when it is called."""

    def parse_args(self, context: click.Context, args: list[str]) -> list[str]:
        """Refuse a secret in a URL, which outputs, names of files and logs would repeat."""
        for number, text in enumerate(args, 1):
            if has_secret(text):
                context.fail(secret_error_text(f"argument {number}"))
        return super().parse_args(context, args)

    def list_commands(self, _context: click.Context) -> list[str]:
        """Return the verbs in the order in which they are used."""
        return list(verbs())

    def get_command(self, _context: click.Context, name: str) -> click.Command | None:
        """Import the module of a verb and return its ``command``; None if unknown."""
        if not _is_known(name):
            return None
        _compute_in_one_thread()
        module = f"rotcal_ros.cli.{name}" if name in OWN_VERBS else verbs()[name].module
        if not module:
            raise ConfigurationError(verbs()[name].help)
        command: click.Command = import_module(module).command
        return command

    def shell_complete(
        self, context: click.Context, incomplete: str
    ) -> list[click.shell_completion.CompletionItem]:
        """Offer the verbs without importing any of them; behind a dash, the options."""
        from click.shell_completion import CompletionItem

        found = [
            CompletionItem(name, help=verb.help)
            for name, verb in verbs().items()
            if name.startswith(incomplete)
        ]
        return found or super().shell_complete(context, incomplete)

    def resolve_command(
        self, context: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the verb; a misspelt one fails with the name that was probably meant."""
        name = args[0]
        if not name.startswith("-") and not _is_known(name):
            from rotcal_ros.foundation.plugins import VERBS, name_hint

            context.fail(f"no verb {name!r}{name_hint(name, verbs(), VERBS)}")
        return super().resolve_command(context, args)

    def format_commands(self, _context: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of verbs, without importing any of them."""
        others = dict(verbs())
        listed = dict[str, list[tuple[str, str]]]()
        for heading, own in SECTIONS.items():
            names = [
                each
                for name in own
                for each in (name, *(n for n, verb in others.items() if verb.after == name))
            ]
            listed[heading] = [(name, others.pop(name).help) for name in names]
        listed["More"] = [(name, verb.help) for name, verb in others.items()]
        for heading, lines in listed.items():
            if lines:
                with formatter.section(heading):
                    formatter.write_dl(lines)

    def invoke(self, context: click.Context) -> None:
        """Run a verb; an error becomes one red line and an exit code, not a traceback.

        A verb may return its exit code. Parts of a bag that it could not read and did not report
        follow in a line each, and turn a good exit code into 1. Wrong usage is left to click. A
        closed standard output (``| head``) ends the verb silently.
        """
        from rotcal_ros.bags.unread_data import collect_unread

        with collect_unread() as missing:
            code = self._code_of(context)
        for text in (text for text, by_verb in missing.items() if not by_verb):
            _complain(f"not read completely: {text}")
        context.exit(code or int(bool(missing)))

    def _code_of(self, context: click.Context) -> int:
        """Run a verb and return its exit code."""
        try:
            code = super().invoke(context)
            sys.stdout.flush()
        except click.ClickException as error:
            vars(error)["message"] = mask_secrets(error.message)
            raise
        except click.exceptions.Exit:
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
    epilog="Exit codes: 0 success, 1 the verdict is bad or a bag was not read completely, 2 wrong "
    "usage or unreadable input, 3 too few or contradictory data, 130 interrupted, 141 the output "
    "was closed.",
)
@click.version_option(__version__, prog_name="rotcal")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def rotcal(debug: bool) -> None:
    """Find and remove the six small errors of a rotary table at every angle."""


def main() -> None:
    """Run ``rotcal`` and exit with its exit code."""
    rotcal(prog_name="rotcal")


def _is_known(name: str) -> bool:
    """Return whether there is a verb; to know our own, extensions are not loaded."""
    return name in OWN_VERBS or name in verbs()


def _compute_in_one_thread() -> None:
    """Let numpy use one thread, unless the user wants more; it reads this once, when loaded.

    The last bit of a matrix product depends on the number of threads, and the live nodes use one:
    only with one does 'rotcal solve' repeat their result to the last bit.
    """
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")


def _explain(error: Exception) -> int:
    """Print one red line for ``error`` and return its exit code."""
    _complain(*error_lines(error))
    return error.exit_code if isinstance(error, RotcalError) else UNREADABLE


def _complain(text: str, *log: str) -> None:
    for line in (f"rotcal: {text}", *log):
        click.secho(printable(line), fg="red", err=True)


if __name__ == "__main__":
    main()
