"""``rotcal run``: all nodes of one cell in one command, from the first step to the verdict."""

from __future__ import annotations

import signal
import time
from collections.abc import Mapping
from pathlib import Path
from queue import Empty
from types import FrameType
from typing import TYPE_CHECKING, Any, Final, NoReturn

import click

from rotcal_ros.cli.console import VERDICT_EXIT_CODES, json_option, print_json, progress_bar, say
from rotcal_ros.cli.main import INTERRUPTED
from rotcal_ros.cli.person import Person
from rotcal_ros.errors import ConfigurationError, DataError
from rotcal_ros.planning.plan import PAUSED
from rotcal_ros.sessions.resume import resume_session
from rotcal_ros.sessions.session import BAG, Session, prepare_session, require_ros
from rotcal_ros.units import ARCSEC

if TYPE_CHECKING:
    pass

SILENCE_TIMEOUT_S: Final = 60.0
"""The client tells something every second; after this silence it hangs."""
CANCEL_TIMEOUT_S: Final = 25.0
_POLL_S: Final = 0.2
_USAGE_ERRORS: Final = (601, 602)
"""Error codes of the action that the user cures before the next start: bad configuration,
topic missing."""

path_type = click.Path(path_type=Path)


@click.command(short_help="Run the nodes of one cell and calibrate.")
@click.argument("configuration", type=path_type, metavar="CONFIG")
@click.option(
    "-o", "--output", "--out", type=path_type, help="New folder for everything; default: out/NAME."
)
@click.option(
    "--set", "changes", multiple=True, metavar="GROUP.NAME=VALUE", help="Change a setting."
)
@click.option(
    "--resume",
    type=path_type,
    metavar="FOLDER",
    help="Continue the interrupted calibration in FOLDER at its first missing step.",
)
@click.option("--keep-previous", is_flag=True, help="Move an existing output folder aside.")
@click.option("--no-report", is_flag=True, help="Write no report.")
@click.option("--no-export", is_flag=True, help="Write no controller files.")
@click.option(
    "-y", "--yes", is_flag=True, help="Take every work asked of a person as done at once."
)
@json_option
def command(
    configuration: Path,
    output: Path | None,
    changes: tuple[str, ...],
    resume: Path | None,
    keep_previous: bool,
    no_report: bool,
    no_export: bool,
    yes: bool,
    as_json: bool,
) -> int:
    """Start the nodes of the cell that CONFIG describes, calibrate, end them.

    With a group 'simulation' in CONFIG the cell is simulated, otherwise its instruments must be
    running. Where the plan needs a person, the instruction is shown: a simulated person does it
    at once, a real one presses Enter when done (or calls the service 'resume' of the cell).
    Ctrl-C cancels: the bag stays valid, and --resume continues it.
    """
    require_ros()
    started = time.monotonic()
    if resume is not None:
        if output is not None or keep_previous:
            raise click.UsageError("--resume continues in its own FOLDER, without --output")
        session = resume_session(configuration, resume, changes)
    else:
        folder = output or Path("out") / configuration.stem
        session = prepare_session(configuration, folder, changes, keep_previous=keep_previous)
    outcome = calibrate(session, Person(session, yes))
    if outcome.get("interrupted"):
        return INTERRUPTED
    from rotcal_ros.sessions.products import write_products

    files = write_products(session, report=not no_report, export=not no_export)
    outcome |= {"seconds": round(time.monotonic() - started, 1), "files": files}
    if as_json:
        print_json(outcome)
    else:
        _conclude(outcome, files)
    return VERDICT_EXIT_CODES[outcome["verdict"]]


def _interrupt(_number: int, _frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


def calibrate(session: Session, person: Person) -> dict[str, Any]:
    """Run the nodes of a session to the end and return the outcome of the goal.

    Its ``interrupted`` is true when the user ended it. Raises RotcalError when it failed.
    """
    previous = signal.signal(signal.SIGTERM, _interrupt)
    try:
        outcome = _run(session, person) if session.something_left else _solve_bag(session)
    finally:
        signal.signal(signal.SIGTERM, previous)
    if outcome.get("interrupted"):
        say(f"interrupted; the bag is closed: {outcome.get('bag_folder') or 'none was begun'}")
        say(f"to go on: rotcal run {session.configuration_file} --resume {session.folder}")
    elif outcome["error_code"]:
        _fail(session, outcome)
    return outcome


def _run(session: Session, person: Person) -> dict[str, Any]:
    """Run the nodes until the client tells the result."""
    with session.start() as running:
        try:
            return _follow(running, SILENCE_TIMEOUT_S, person)
        except KeyboardInterrupt:
            say("canceling: the bag is being closed")
            running.cancel()
            outcome = _last_words(running)
            return {**outcome, "interrupted": True}


def _solve_bag(session: Session) -> dict[str, Any]:
    """Solve the bag of a session that was interrupted behind its last step."""
    from rotcal_ros.files import write_atomically
    from rotcal_ros.recordings.replay import read_recording

    recording = read_recording(session.folder / BAG)
    result = recording.solve()
    write_atomically(session.folder / "result.json", result.to_json())
    accepted = {o.step for o in recording.observations if o.accepted}
    return {
        "error_code": 0,
        "verdict": result.verdict,
        "n_used": len(accepted),
        "n_rejected": sum(not o.accepted for o in recording.observations),
        "skipped_steps": sorted({o.step for o in recording.observations} - accepted),
    }


def _last_words(running: Any) -> dict[str, Any]:
    """Return the result of a canceled goal, empty when none comes."""
    deadline = time.monotonic() + CANCEL_TIMEOUT_S
    while time.monotonic() < deadline:
        try:
            event = running.events.get(timeout=_POLL_S)
        except Empty:
            continue
        if event["event"] in ("result", "end"):
            return dict(event)
    return {}


def _follow(running: Any, silence_timeout_s: float, person: Person) -> dict[str, Any]:
    """Show the progress and ask the person; return the result event."""
    with progress_bar() as bar:
        display = _Display(bar)
        heard, begun = time.monotonic(), False
        while True:
            if person.is_done():
                running.resume()
            try:
                event = running.events.get(timeout=_POLL_S)
            except Empty:
                _check(running, begun, time.monotonic() - heard, silence_timeout_s)
                continue
            heard = time.monotonic()
            if event["event"] in ("result", "refused", "end"):
                return _ending(running, event, begun)
            begun = begun or event["event"] == "started"
            display.tell(person.hear(event))
            if event["event"] == "feedback":
                display.show(event)


def _ending(running: Any, event: Mapping[str, Any], begun: bool) -> dict[str, Any]:
    """Return a result event; raise the error that any other ending is."""
    if event["event"] == "refused":
        raise ConfigurationError(f"the goal was refused: {event['reason']}")
    if event["event"] == "end":
        _check(running, begun, 0.0, SILENCE_TIMEOUT_S)
        tail = running.log_tail("client")
        if not begun:  # the nodes fail for the same reason, but may take longer to say so
            raise ConfigurationError(f"node client ended at its start:\n{tail}")
        raise DataError(f"the client ended without a result\n{tail}")
    return dict(event)


class _Display:
    """A progress bar; where there is no terminal, a line for every tenth of the steps."""

    def __init__(self, bar: Any) -> None:
        self._bar = bar
        self._task = bar.add_task("starting the nodes", total=None)
        self._decile = 0

    def tell(self, text: str) -> None:
        """Print a line, if there is any, above the bar."""
        if text:
            self._bar.console.print(text, markup=False, highlight=False, soft_wrap=True)

    def show(self, event: Mapping[str, Any]) -> None:
        """Show a feedback."""
        step, total, text = event["step"], event["total"], describe(event)
        self._bar.update(self._task, completed=step, total=total, description=text)
        if self._bar.disable and step * 10 // total > self._decile:
            self._decile = step * 10 // total
            say(f"{step} of {total} steps, {text}")


def describe(feedback: Mapping[str, Any]) -> str:
    """Return what a feedback says in words: activity, standard deviation, time left."""
    activity = str(feedback["activity"])
    words = ["waiting for a person" if activity.startswith(PAUSED) else activity]
    if feedback["current_std_rad"] is not None:
        words.append(f"std {feedback['current_std_rad'] / ARCSEC:.2f} arcsec")
    if feedback["time_left_s"] is not None:
        words.append(f"{feedback['time_left_s']:.0f} s left")
    return ", ".join(words)


def _check(running: Any, begun: bool, silence_s: float, silence_timeout_s: float) -> None:
    """Raise when a node could not start, or the client hangs."""
    ended = running.ended()
    if ended and not begun:
        name, code = next(iter(ended.items()))
        raise ConfigurationError(
            f"node {name} ended at its start (exit code {code}):\n{running.log_tail(name)}"
        )
    if silence_s > silence_timeout_s:
        raise DataError(f"the client has said nothing for {silence_s:.0f} s: it hangs")


def _fail(session: Session, outcome: Mapping[str, Any]) -> NoReturn:
    """Raise the error that ended the calibration, with what is left to use."""
    text = str(outcome["error_msg"])
    if outcome.get("bag_folder"):
        text += f"; everything up to there is in {outcome['bag_folder']}"
        text += f"; go on with: rotcal run {session.configuration_file} --resume {session.folder}"
    text += f"; logs: {session.log_folder}"
    raise (ConfigurationError if outcome["error_code"] in _USAGE_ERRORS else DataError)(text)


def _conclude(outcome: Mapping[str, Any], files: Mapping[str, str]) -> None:
    """Print the verdict in one line and where everything is."""
    skipped = len(outcome["skipped_steps"])
    click.secho(
        f"verdict {outcome['verdict']}: {outcome['n_used']} steps used, {skipped} skipped, "
        f"{outcome['n_rejected']} attempts rejected, {outcome['seconds']:.0f} s",
        fg="green" if outcome["verdict"] == "ok" else "red",
    )
    for name, path in files.items():
        click.echo(f"{name + ':':<14}{path}")
