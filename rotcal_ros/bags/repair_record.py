"""What a repaired bag says of the one that it was made from."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from typing import Final

from rotcal_ros.bags import names
from rotcal_ros.bags.reader import sha256_of
from rotcal_ros.bags.verdict import FileVerdict

Notes = Mapping[str, Mapping[str, str]]
_DATE: Final = "date"
_MISSING: Final = "missing"
_EARLIER: Final = "earlier"
_DETAILS: Final = (" sha256", " lost", " damages")
"""What follows the name of a file in the keys about it."""


def repair_record(before: Sequence[FileVerdict], missing: Sequence[str]) -> dict[str, str]:
    """Return the metadata record for the bag that is made from the files ``before``.

    By file name the verdict, and behind it the hash, the messages known to be lost by topic and
    the bytes at which it is damaged; ``missing`` are sentences about files that were not there.
    A record of an earlier repair is kept inside.
    """
    record = {_DATE: f"{datetime.now(timezone.utc):%Y-%m-%dT%H:%M:%SZ}"}
    for verdict in before:
        hashed, lost, damages = (f"{verdict.path.name}{what}" for what in _DETAILS)
        record[verdict.path.name] = verdict.sentence()
        record[hashed] = sha256_of(verdict.path)
        record[lost] = json.dumps({n: t.lost for n, t in verdict.topics.items() if t.lost})
        record[damages] = json.dumps([[d.offset, d.what] for d in verdict.damages])
        if earlier := verdict.notes.get(names.REPAIR):
            record[_EARLIER] = json.dumps(dict(earlier))
    if missing:
        record[_MISSING] = json.dumps(list(missing))
    return record


def repairs_in_words(notes: Notes) -> tuple[str, ...]:
    """Return a sentence for each damaged file that a repaired one was made from."""
    record = notes.get(names.REPAIR, {})
    date = record.get(_DATE, "")
    return tuple(
        f"repaired {f'on {date} ' if date else ''}from {name}: {sentence}"
        for name, sentence in record.items()
        if name not in (_DATE, _MISSING, _EARLIER)
        and not name.endswith(_DETAILS)
        and sentence != "complete"
    )


def missing_before_repair(notes: Notes) -> tuple[str, ...]:
    """Return what was missing already when a repaired file was made."""
    try:
        sentences = json.loads(notes.get(names.REPAIR, {}).get(_MISSING, "[]"))
        return tuple(str(sentence) for sentence in sentences)
    except (ValueError, TypeError, RecursionError):
        return ()
