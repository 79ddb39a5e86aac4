"""A session: the checked configuration of one calibration, its folder, and room on the disk.

An interrupted one is continued by another, from what its bag holds.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import Final

from rotcal_ros.bags import names
from rotcal_ros.bags.reader import bag_files
from rotcal_ros.bags.session_identity import require_one_session
from rotcal_ros.bags.unread_data import collect_unread
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.files import make_folder, write_atomically
from rotcal_ros.foundation.folder_lock import FolderLock
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.session_folder import SessionFolder, resume_command
from rotcal_ros.foundation.settings import declarations
from rotcal_ros.foundation.untrusted import read_text
from rotcal_ros.methods import (
    Calibration,
    Configuration,
    changed,
    prepare_to_measure,
    read_configuration,
)
from rotcal_ros.methods.continuation import Continuation
from rotcal_ros.planning.choices import AS_LISTED
from rotcal_ros.recordings.replay import read_recording
from rotcal_ros.report.terminal.console import progress, say


@dataclass(frozen=True)
class Session:
    """A calibration and its folder; ``continuation`` is what an interrupted run has left.

    ``shown_by`` names nodes for people that are started too (VIEWERS of node_names).
    """

    calibration: Calibration
    folder: SessionFolder
    continuation: Continuation | None = None
    shown_by: tuple[str, ...] = ()

    @property
    def configuration(self) -> Configuration:
        """The configuration with all changes, as it is in the folder."""
        return self.calibration.configuration

    @property
    def run(self) -> int:
        """Number of the run, from 0."""
        return self.continuation.run if self.continuation else 0

    @property
    def log_folder(self) -> Path:
        """Where the output of the nodes goes."""
        return self.folder.log(self.run)

    @property
    def finished(self) -> bool:
        """Whether there is no step left to measure."""
        return self.continuation is not None and not self.continuation.steps

    @property
    def run_log(self) -> Path:
        """What 'rotcal run' itself prints once it has no terminal."""
        return self.log_folder / "run.log"

    @property
    def attach_command(self) -> str:
        """The command line that shows this session while it runs."""
        return f"rotcal attach {self.folder.path}"

    @property
    def resume_command(self) -> str:
        """The command line that continues this session."""
        return resume_command(self.folder.path)


def prepare_session(
    source: Path, folder: Path, changes: Sequence[str], *, keep_previous: bool = False
) -> Session:
    """Check the whole configuration, then make the folder; nothing is ever overwritten.

    ``changes`` are ``group.name=value`` with the value in YAML. With ``keep_previous`` an existing
    folder is moved aside to the first free ``<folder>-<number>``. A folder that a run left before
    anything was recorded is used again. Raises ConfigurationError if the disk has no room for
    the bag.
    """
    calibration = checked_calibration(source, changes)
    folder = folder.absolute()
    require_disk_space(calibration, folder)
    if folder.exists() and not _taken_again(SessionFolder(folder)):
        if not keep_previous:
            raise ConfigurationError(
                f"{folder} exists already and nothing is overwritten; choose another --output, "
                "--keep-previous to move it aside, or --resume to continue what is in it"
            )
        folder.rename(free_folder_name(folder))
    session = Session(calibration, SessionFolder(folder))
    make_folder(session.log_folder)
    write_atomically(session.folder.configuration, calibration.configuration.text)
    return session


def require_unchanged(session: Session) -> None:
    """Raise ConfigurationError if another run went on in the folder since it was read.

    The caller holds the lock of the folder.
    """
    files: tuple[Path, ...] = ()
    with suppress(BagError):
        files = bag_files(session.folder.bag)
    as_found = len(files) <= session.run if session.continuation else not files
    if session.folder.result.exists() or not as_found:
        raise ConfigurationError(
            f"another run went on in {session.folder.path} meanwhile, so this one has measured "
            "nothing; look at the outcome of that run, and continue it if it was interrupted: "
            f"{session.resume_command}"
        )


def _taken_again(folder: SessionFolder) -> bool:
    """Return whether nothing was measured in ``folder``; the logs of its run are then removed.

    The folder stays as it is if it holds anything that a run does not leave before its first
    message. Raises BagError when a run is still at work there.
    """
    path = folder.path
    beginnings = (folder.configuration, folder.parameters, folder.log(), folder.bag)
    if not path.is_dir() or not set(path.iterdir()) <= set(beginnings):
        return False
    if folder.bag.exists() and (not folder.bag.is_dir() or any(folder.bag.iterdir())):
        return False
    FolderLock(path).release()
    if folder.bag.exists():
        folder.bag.rmdir()
    if folder.log().is_dir():
        shutil.rmtree(folder.log())
    return True


def checked_calibration(source: Path, changes: Sequence[str]) -> Calibration:
    """Read a configuration with ``changes``; check all of its groups and its plan."""
    return prepare_to_measure(changed(read_configuration(source), changes))


def free_folder_name(folder: Path) -> Path:
    """Return ``<folder>-<number>`` with the first number that is not taken."""
    number = 1
    while (candidate := folder.with_name(f"{folder.name}-{number}")).exists():
        number += 1
    return candidate


BYTES_PER_MESSAGE: Final = 100.0
"""Bytes of a reading in a bag, with its index; compression leaves about half of them."""
TABLE_HZ: Final = 100.0
TRACER_HZ: Final = 1000.0
"""Messages per second of real instruments, which no setting states."""


def require_disk_space(calibration: Calibration, folder: Path, steps: int | None = None) -> None:
    """Raise ConfigurationError if the disk of ``folder`` has no room for the bag.

    ``steps`` are left to measure, default: the whole plan. The recorder's settings say how much of
    the disk has to stay free.
    """
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    free = shutil.disk_usage(existing).free
    reserve = calibration.configuration.recorder.writer.min_free_bytes
    bag = expected_bytes(calibration, steps)
    if free < bag + reserve:
        raise ConfigurationError(
            f"the disk of {folder} has {free / 1e6:,.0f} MB free, {(bag + reserve) / 1e6:,.0f} MB "
            f"are needed: {bag / 1e6:,.0f} MB for the bag by steps and rates, and "
            f"{reserve / 1e6:,.0f} MB that must stay free (recorder.writer.min_free_bytes): make "
            "room, or choose another --output"
        )


def expected_bytes(calibration: Calibration, steps: int | None = None) -> float:
    """Return how large the bag of ``steps`` (None: of the whole plan) may become, in bytes.

    0 for a policy that chooses: how few of the steps it will take is not known.
    """
    configuration, plan = calibration.configuration, calibration.plan
    if configuration.planner.policy != AS_LISTED or not plan.steps:
        return 0.0
    angles = [step.table_angle for step in plan.steps]
    turns = sum(a != b for a, b in pairwise(angles))
    share = 1.0 if steps is None else steps / len(plan.steps)
    seconds = len(angles) * configuration.planner.step_s + turns * configuration.planner.turn_s
    return share * seconds * _messages_per_second(calibration) * BYTES_PER_MESSAGE


def _messages_per_second(calibration: Calibration) -> float:
    """Return how many readings a second the cell is expected to publish."""
    configuration = calibration.configuration
    if configuration.simulated:
        rates = [
            declared.name
            for declared in declarations(type(configuration.simulation))
            if declared.name.endswith("rate_hz")
        ]
        return float(sum(attrgetter(name)(configuration.simulation) for name in rates))
    traced = names.TRACER_LENGTH in calibration.topics
    return TABLE_HZ + (TRACER_HZ if traced else 0.0)


LOCK_TIMEOUT_S: Final = 40.0
"""Nodes whose ``rotcal run`` was killed close their bag and end within this time."""
_POLL_S: Final = 0.2


def resume_session(source: Path | None, path: Path, changes: Sequence[str]) -> Session:
    """Return the session that continues the one in the folder ``path``.

    Its raw streams say what is left to measure. Without a ``source`` its own configuration is
    used.

    Raises ConfigurationError when there is no such session, it is finished, or it was configured
    differently; BagError when another process works there.
    """
    folder = SessionFolder(path.absolute())
    if source is None:
        _require_begun(folder)
    calibration = checked_calibration(source or folder.configuration, changes)
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
    require_disk_space(calibration, folder.path, len(continuation.steps))
    session = Session(calibration, folder, continuation)
    session.log_folder.mkdir(exist_ok=True)
    write_atomically(folder.continuation(continuation.run), continuation.to_json())
    say(calibration.describe_remaining(continuation))
    return session


def _require_begun(folder: SessionFolder) -> None:
    if not (known := folder.configuration).is_file():
        raise ConfigurationError(f"{folder.path} holds no session: {known.name} is missing")


def _check_folder(folder: SessionFolder, calibration: Calibration) -> None:
    _require_begun(folder)
    known = folder.configuration
    if folder.result.exists():
        raise ConfigurationError(
            f"the calibration in {folder.path} is finished: its {folder.result.name} is there"
        )
    if read_text(known) != calibration.configuration.text:
        raise ConfigurationError(
            f"{calibration.configuration.source} differs from {known}: an interrupted plan is "
            f"continued as it was begun; use: {resume_command(folder.path)}"
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
    """Return what was recorded; nothing when the recorder died before the first message.

    What an interrupted file lacks is said here, and measured again. It does not count against the
    verb: the recorder closes that file, and the report reads the whole bag once more.
    """
    try:
        with collect_unread(), progress("reading what is there") as shown:
            recording = read_recording(
                bag, configuration=calibration.configuration, progress=shown
            )
    except BagError as error:
        require_one_session(bag_files(bag))
        say(f"nothing to resume from: {error}")
        return ()
    if recording.session.missing:
        raise BagError(f"{'; '.join(recording.session.missing)}: put it back before you go on")
    for text in recording.warnings():
        say(text)
    return recording.observations
