"""What is in a bag, found without decoding its messages."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rotcal_ros.bags import names
from rotcal_ros.bags.reader import Progress, bag_files, read_blocks
from rotcal_ros.bags.session_verdict import SessionVerdict, judge_session
from rotcal_ros.bags.settings import DEFAULT_LIMITS, ReadingLimits
from rotcal_ros.bags.storage_scan import FileVerdict, Scan, session_losses, unread_losses
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.methods.configuration import Configuration, parse_configuration
from rotcal_ros.recordings.missing_data import DropoutWithSteps, match_recorded_dropouts
from rotcal_ros.recordings.recorded_setup import require_one_configuration


@dataclass(frozen=True)
class BagSummary:
    """The files of a bag, the names of what is attached, its configuration if there is one.

    ``session`` is the verdict on all files together, ``dropouts`` say what is missing, and from
    when to when. ``contradiction`` says where two configurations differ; then there is none that
    counts.
    """

    files: tuple[FileVerdict, ...]
    attachments: tuple[str, ...]
    configuration: Configuration | None
    session: SessionVerdict
    dropouts: tuple[DropoutWithSteps, ...] = ()
    contradiction: str = ""

    @property
    def start_ns(self) -> int | None:
        """Log time of the first message."""
        return min((f.start_ns for f in self.files if f.start_ns is not None), default=None)

    @property
    def end_ns(self) -> int | None:
        """Log time of the last message."""
        return max((f.end_ns for f in self.files if f.end_ns is not None), default=None)

    def to_dict(self) -> dict[str, Any]:
        """Return the machine-readable form."""
        start, end = self.start_ns, self.end_ns
        topics: dict[str, dict[str, Any]] = {}
        for file in self.files:
            for name, topic in file.topics.items():
                entry = topics.setdefault(
                    name, {"type": topic.type_name, "messages": 0, "lost": 0}
                )
                entry["messages"] += topic.messages
                entry["lost"] += topic.lost
        return {
            "files": [file.to_dict() for file in self.files],
            "start_ns": start,
            "end_ns": end,
            "duration_s": 0.0 if start is None or end is None else (end - start) / 1e9,
            "topics": topics,
            "attachments": list(self.attachments),
            "method": self.configuration.method.name if self.configuration else None,
            "simulated": self.configuration.simulated if self.configuration else None,
            "item": self.configuration.identity.title if self.configuration else None,
            "plan_id": self.configuration.plan_id if self.configuration else None,
            "contradiction": self.contradiction,
            "losses_recorded": session_losses(self.files),
            "losses_unread": list(unread_losses(self.files)),
            "dropouts": [dropout.to_dict() for dropout in self.dropouts],
            "session": self.session.to_dict(),
        }


def summarise_bag(
    path: Path, progress: Progress | None = None, limits: ReadingLimits = DEFAULT_LIMITS
) -> BagSummary:
    """Read a bag to its end and return its summary; raises BagError when it cannot be read."""
    verdicts: list[FileVerdict] = []
    attachments: dict[str, bytes] = {}
    scans: list[Scan] = []
    for scan, block in read_blocks(bag_files(path), progress, limits):
        if block is None:
            scans.append(scan)
            verdicts.append(scan.verdict())
            attachments |= {name: a.data for name, a in scan.attachments.items()}
    contradiction = ""
    try:
        require_one_configuration(scans, (), path)
    except BagError as error:
        contradiction = str(error)
    return BagSummary(
        files=tuple(verdicts),
        attachments=tuple(attachments),
        configuration=None if contradiction else _configuration(attachments),
        contradiction=contradiction,
        session=judge_session(path, verdicts),
        dropouts=match_recorded_dropouts(verdicts, limits),
    )


def _configuration(attachments: dict[str, bytes]) -> Configuration | None:
    text = attachments.get(names.CONFIGURATION, b"").decode(errors="replace")
    try:
        return parse_configuration(text, names.CONFIGURATION)
    except ConfigurationError:
        return None
