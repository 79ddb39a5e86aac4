"""``rotcal attach``: watch a calibration that runs in another process."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from rotcal_ros.cli.console import INTERRUPTED, json_option, path_type, print_outcome

if TYPE_CHECKING:
    from rotcal_ros.foundation.session_folder import SessionFolder

OUT = Path("out")


@click.command()
@click.argument("folder", type=path_type, metavar="[FOLDER]", required=False)
@click.option("--stop", is_flag=True, help="Cancel the calibration; its bag stays valid.")
@json_option
def command(folder: Path | None, stop: bool, as_json: bool) -> int:
    """Show the calibration that runs in FOLDER, as 'rotcal run' does; default: the one in out/.

    Enter confirms that a person's work is done. The exit code is that of 'rotcal run',
    or 0 once --stop has stopped it. Ctrl-C only leaves: the calibration continues.
    """
    from rotcal_ros.foundation.errors import RotcalError
    from rotcal_ros.report.terminal.console import say
    from rotcal_ros.sessions.attaching import watch_session

    session = _session(folder)
    try:
        ended = watch_session(session, stop=stop)
    except KeyboardInterrupt:
        say("left; the calibration continues")
        say(f"to see it again: rotcal attach {session.path}")
        say(f"to stop it:      rotcal attach {session.path} --stop")
        return INTERRUPTED
    if "error" in ended:
        error = RotcalError(ended["error"])
        error.exit_code = ended["exit_code"]
        raise error
    code = print_outcome(ended["outcome"], as_json=as_json)
    return 0 if stop and code == INTERRUPTED else code


def _session(folder: Path | None) -> SessionFolder:
    """Return the session in a folder; without a folder, the only one that runs below out/."""
    from rotcal_ros.foundation.errors import ConfigurationError
    from rotcal_ros.foundation.session_folder import SessionFolder
    from rotcal_ros.sessions.attaching import running_sessions

    if folder is not None:
        return SessionFolder(folder.absolute())
    found = running_sessions(OUT.absolute())
    if not found:
        raise ConfigurationError(f"no calibration runs below {OUT.absolute()}: name its folder")
    if len(found) > 1:
        names = ", ".join(str(session.path) for session in found)
        raise ConfigurationError(f"several calibrations run, name one of them: {names}")
    return found[0]
