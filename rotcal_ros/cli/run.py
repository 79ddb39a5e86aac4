"""``rotcal run``: all nodes of one cell in one command, from the first step to the verdict."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path

import click

from rotcal_ros.cli.console import json_option, path_type, print_outcome
from rotcal_ros.cli.options import complete_configurations, language_option, set_option
from rotcal_ros.foundation.language import use_language
from rotcal_ros.report.terminal.console import tell


@click.command()
@click.argument(
    "configuration", type=path_type, metavar="[CONFIG]", required=False,
    shell_complete=complete_configurations,
)  # fmt: skip
@click.option(
    "-o", "--output", "--out", type=path_type, help="New folder for everything; default: out/NAME."
)
@set_option
@click.option(
    "--resume",
    type=path_type,
    metavar="FOLDER",
    help="Continue the interrupted calibration in FOLDER from its first missing step; CONFIG may "
    "be left out.",
)
@click.option("--keep-previous", is_flag=True, help="Move an existing output folder aside.")
@language_option
@click.option(
    "--history",
    metavar="FILE|URL",
    help="Add the result to this history of all tables, like history.database.",
)
@click.option("--no-report", is_flag=True, help="Write no report.")
@click.option("--no-export", is_flag=True, help="Write no controller files.")
@click.option("-y", "--yes", is_flag=True, help="Take work of a person as done when asked for.")
@click.option(
    "--page/--no-page", default=True, help="Serve the operator's page (default), or not."
)
@click.option("--scene", is_flag=True, help="Also publish markers for RViz and Foxglove.")
@click.option("--detach", is_flag=True, help="Go on in the background; see 'rotcal attach'.")
@json_option
def command(
    configuration: Path | None,
    output: Path | None,
    changes: tuple[str, ...],
    resume: Path | None,
    keep_previous: bool,
    language: str,
    history: str | None,
    no_report: bool,
    no_export: bool,
    yes: bool,
    page: bool,
    scene: bool,
    detach: bool,
    as_json: bool,
) -> int:
    """Start the nodes of the cell that CONFIG describes, calibrate it, and end the nodes.

    With a group 'simulation' in CONFIG the cell is simulated, otherwise its instruments must be
    running. When the plan needs a person, the instruction is shown: a simulated person does it at
    once, a real one then presses Enter or the button on the operator's page, whose address is
    printed, or calls the service 'resume' of the cell. Ctrl-C cancels: the bag stays valid, and
    --resume continues it. A lost terminal does not end the calibration: 'rotcal attach' shows it
    again.
    """
    from rotcal_ros.sessions.attaching import Viewers
    from rotcal_ros.sessions.lasting_output import go_to_background, lasting_output
    from rotcal_ros.sessions.processes import page_can_be_served, require_ros
    from rotcal_ros.sessions.products import session_goal_standing, write_products
    from rotcal_ros.sessions.running import calibrate
    from rotcal_ros.sessions.session import prepare_session, resume_session

    if configuration is None and resume is None:
        raise click.UsageError("give a CONFIG, or --resume FOLDER")
    if detach and as_json:
        raise click.UsageError(
            "--json prints the outcome, for which --detach does not wait: leave one out"
        )
    require_ros()
    if history is not None:
        changes = (*changes, f"history.database={json.dumps(history)}")
    started = time.monotonic()
    if resume is None:
        assert configuration is not None
        folder = output or Path("out") / configuration.stem
        session = prepare_session(configuration, folder, changes, keep_previous=keep_previous)
    elif output is None and not keep_previous:
        session = resume_session(configuration, resume, changes)
    else:
        raise click.UsageError(
            "--resume continues in its own FOLDER: leave out --output and --keep-previous"
        )
    page = page and page_can_be_served()
    session = replace(session, shown_by=("page",) * page + ("scene",) * scene)
    viewers = Viewers(session, at_once=yes)
    if detach and not go_to_background(session.run_log):
        tell(f"runs in the background; to see it: {session.attach_command}")
        return 0
    with lasting_output(session.run_log), viewers:
        outcome = calibrate(session, viewers, at_once=yes)
        if not outcome.get("interrupted"):
            with use_language(language):
                files = write_products(
                    session, report=not no_report, export=not no_export, tell=viewers.say
                )
            seconds = round(time.monotonic() - started, 1)
            standing = session_goal_standing(session.folder)
            goal_line = "" if standing is None else standing.describe()
            outcome |= {"seconds": seconds, "files": files, "goal_line": goal_line}
        viewers.end(outcome)
        return print_outcome(outcome, as_json=as_json)
