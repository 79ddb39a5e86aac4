"""Finds how far an interrupted session came, and prepares the session that continues it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from rotcal_ros.bags.reader import bag_files
from rotcal_ros.bags.session_identity import require_one_session
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.files import FolderLock, write_atomically
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.session_folder import SessionFolder
from rotcal_ros.foundation.untrusted import read_text
from rotcal_ros.methods import Calibration
from rotcal_ros.methods.continuation import Continuation
from rotcal_ros.planning.choices import AS_LISTED
from rotcal_ros.recordings.replay import read_recording
from rotcal_ros.report.terminal.console import progress, say
from rotcal_ros.sessions.session import Session, checked_calibration, require_space

LOCK_TIMEOUT_S: Final = 40.0
"""Nodes whose ``rotcal run`` was killed close their bag and end within this time."""
_POLL_S: Final = 0.2


def resume_session(source: Path, path: Path, changes: Sequence[str]) -> Session:
    """Return the session that continues the one in the folder ``path``.

    Its raw streams show what is left to measure.

    Raises ConfigurationError when there is no such session, it is finished, or it was configured
    differently; BagError when another process works there.
    """
    folder = SessionFolder(path.absolute())
    calibration = checked_calibration(source, changes)
    _check_folder(folder, calibration)
    _wait_for_lock(folder.path)
    _check_folder(folder, calibration)  # whoever held the lock may have finished it
    if not folder.bag.is_dir():
        session = Session(calibration, folder)
        session.log_folder.mkdir(exist_ok=True)
        return session
    files: tuple[Path, ...] = ()
    with suppress(BagError):
        files = bag_files(folder.bag)
    run = max(1, len(files))  # no earlier run can have this number: each wrote a file at least
    observed = _observed(folder.bag, calibration) if files else ()
    continuation = calibration.continued(run, observed)
    require_space(calibration, folder.path, len(continuation.steps))
    session = Session(calibration, folder, continuation)
    session.log_folder.mkdir(exist_ok=True)
    write_atomically(folder.continuation(continuation.run), continuation.to_json())
    _say_what_is_left(calibration, continuation)
    return session


def _check_folder(folder: SessionFolder, calibration: Calibration) -> None:
    known = folder.configuration
    if not known.is_file():
        raise ConfigurationError(f"{folder.path} holds no session: {known.name} is missing")
    if folder.result.exists():
        raise ConfigurationError(
            f"the calibration in {folder.path} is finished: its {folder.result.name} is there"
        )
    if read_text(known) != calibration.configuration.text:
        raise ConfigurationError(
            f"{calibration.configuration.source} differs from {known}: an interrupted plan is "
            f"continued as it was begun; use 'rotcal run {known} --resume {folder.path}'"
        )


def _wait_for_lock(folder: Path) -> None:
    """Wait until the last node of the interrupted run has ended."""
    deadline = time.monotonic() + LOCK_TIMEOUT_S
    while time.monotonic() < deadline:
        with suppress(BagError):
            return FolderLock(folder).release()
        time.sleep(_POLL_S)
    FolderLock(folder).release()
    return None


def _observed(bag: Path, calibration: Calibration) -> tuple[Observation, ...]:
    """Return what was recorded; nothing when the recorder died before the first message."""
    try:
        with progress("reading what was recorded") as shown:
            recording = read_recording(
                bag, configuration=calibration.configuration, progress=shown
            )
    except BagError as error:
        require_one_session(bag_files(bag))
        say(f"nothing to continue from: {error}")
        return ()
    if recording.session.missing:
        raise BagError(f"{'; '.join(recording.session.missing)}: put it back before you go on")
    for text in recording.warnings():
        say(text)
    return recording.observations


def _say_what_is_left(calibration: Calibration, continuation: Continuation) -> None:
    """Print what is left of the plan; with a goal only the policy knows how many steps."""
    total, missing = len(calibration.plan.steps), len(continuation.steps)
    missing -= len(continuation.again)
    again = f"; {len(continuation.again)} done steps are measured again" * bool(continuation.again)
    left = f"{missing} of {total} steps are left"
    if calibration.configuration.planner.policy != AS_LISTED:
        again = f"{again} if any is chosen" * bool(again)
        done = len({o.step for o in continuation.observations})
        left = f"{done} steps are done, and the policy goes on choosing among the {total} offered"
    say(f"run {continuation.run}: {left}{again}")
