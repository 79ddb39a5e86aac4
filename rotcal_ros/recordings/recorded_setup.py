"""What a bag says of its own measurement: configuration, plan, subject."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path

from rotcal_ros.bags import names
from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.reader import scan_file
from rotcal_ros.bags.reading_limits import DEFAULT_LIMITS, ReadingLimits
from rotcal_ros.bags.storage_scan import Scan
from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.methods.configuration import (
    OFFLINE_GROUPS,
    Configuration,
    parse_configuration,
    read_subject,
)
from rotcal_ros.recordings.topics import Topics

Decoders = dict[ChannelDefinition, Decoder]
Subject = tuple[Identity, bool]
"""What is measured, and whether a simulation does."""


def find_configuration(
    files: tuple[Path, ...], topics: Topics, limits: ReadingLimits = DEFAULT_LIMITS
) -> Configuration:
    """Return the configuration that a bag was recorded with; reads no further than needed."""
    for file in files:
        scan = scan_file(file, limits)
        for text in _configuration_texts(scan, topics):
            source = f"{file.name}: {names.CONFIGURATION}"
            return parse_configuration(text, source, OFFLINE_GROUPS)
    raise BagError(
        f"{files[0].parent if len(files) > 1 else files[0]} holds no configuration: neither the "
        f"attachment {names.CONFIGURATION} nor a message on the topic {names.PLAN}; "
        "give the set-up (--setup)"
    )


def require_one_configuration(scans: Iterable[Scan], planned: Iterable[str], path: Path) -> None:
    """Raise BagError, with the lines, where a bag states two configurations that differ.

    ``planned`` are the texts of its plans. The bag does not tell which of two was used: a set-up
    has to be given.
    """
    texts: dict[str, str] = {}
    for scan in scans:
        for kept in (scan.replaced, scan.attachments):
            if names.CONFIGURATION in kept:
                text = kept[names.CONFIGURATION].data.decode(errors="replace")
                texts.setdefault(text, f"the attachment of {scan.path.name}")
    for text in planned:
        texts.setdefault(text, f"a message on the topic {names.PLAN}")
    if len(texts) > 1:
        (first, place), (second, other), *_ = texts.items()
        raise BagError(
            f"{path} holds {len(texts)} configurations that differ, {place} and {other}: "
            f"{_first_difference(first, second)}; give the one that was used (--setup)"
        )


def _first_difference(first: str, second: str) -> str:
    """Return where two texts begin to differ, in words."""
    pairs = zip_longest(first.splitlines(), second.splitlines(), fillvalue="")
    for line, (ours, theirs) in enumerate(pairs, 1):
        if ours != theirs:
            here, there = ours.strip(), theirs.strip()
            return f"line {line} is {here!r:.80} in one and {there!r:.80} in the other"
    return "in their line endings"


def recorded_configurations(texts: Iterable[str]) -> Iterator[Configuration]:
    """Yield the configurations in a bag that can be read."""
    for text in texts:
        with suppress(ConfigurationError):
            yield parse_configuration(text, names.CONFIGURATION, OFFLINE_GROUPS)


def require_its_method(
    configuration: Configuration, recorded: Iterable[Configuration], path: Path
) -> None:
    """Raise DataError when the method of ``configuration`` is not that of those ``recorded``."""
    for method in (known.method.name for known in recorded):
        if method != configuration.method.name:
            raise DataError(
                f"{path} was recorded with the method {method}, but {configuration.source} sets "
                f"up {configuration.method.name}: give the set-up that belongs to it, or leave it "
                "out to use the one in the bag"
            )


def recorded_subjects(texts: Iterable[str], scans: Iterable[Scan]) -> Iterator[Subject]:
    """Yield what a bag says that it measures: its configurations first, then its recorder.

    Settings that cannot be read do not hide it.
    """
    for text in texts:
        with suppress(ConfigurationError):
            yield read_subject(text, names.CONFIGURATION)
    for note in (scan.metadata.get(names.SUBJECT, {}) for scan in scans):
        yield Identity(item=note.get("item", "")), note.get("simulated") == "true"


def as_recorded(configuration: Configuration, subjects: Sequence[Subject]) -> Configuration:
    """Return the configuration with what no other set-up can change about a recording.

    A simulation stays one; who measured what is taken from the bag unless it is given: what is
    said first counts.
    """
    identity = configuration.identity
    if "identity" not in configuration.given:
        stated = (known for known, _ in subjects if known != Identity())
        identity = next(stated, identity)
    simulated = configuration.simulated or any(simulated for _, simulated in subjects)
    return replace(configuration, simulated=simulated, identity=identity)


def _configuration_texts(scan: Scan, topics: Topics) -> Iterator[str]:
    decoders: Decoders = {}
    for block in scan.blocks():
        if names.CONFIGURATION in scan.attachments:
            break
        for part in topics.split(block, scan, decoders):
            if part.role == names.PLAN:
                with part.taken_as_expected():
                    yield from (message.configuration for _, message in part.messages(block))
    if names.CONFIGURATION in scan.attachments:
        yield scan.attachments[names.CONFIGURATION].data.decode(errors="replace")
