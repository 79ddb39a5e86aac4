"""Changing the files of a controller: noted before and after, read back, never two halves."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from rotcal_ros.compensation.controller_store import ControllerStore
from rotcal_ros.compensation.held import in_force_of
from rotcal_ros.compensation.journal import (
    Action,
    Contents,
    Entry,
    Journal,
    contents_hash,
    texts_of,
)
from rotcal_ros.compensation.writing import of_the_controller
from rotcal_ros.errors import ControllerError


@dataclass(frozen=True)
class Exchange:
    """Changes the files in ``store`` and notes it in ``journal``; ``now_ns`` since 1970."""

    store: ControllerStore
    journal: Journal
    now_ns: Callable[[], int]

    def make(
        self, words: tuple[Action, Action], held: Mapping[str, str], wanted: Contents, table: str
    ) -> Entry:
        """Keep what is ``held``, write what is ``wanted``, and note both ends of it.

        ``words`` name begin and end, ``table`` is the hash of the table. Returns what was noted at
        the begin. Raises ControllerError when the old files had to be put back, or could not be.
        """
        before: Contents = {name: held.get(name) for name in wanted}
        now_ns = self.now_ns()
        if now_ns < self.journal.last_ns():
            raise ControllerError(
                "the clock is behind the last change in the journal, so that nobody could tell "
                "which table was measured before it: set the clock; nothing was changed"
            )
        kept = self.journal.keep(before, now_ns)
        hashes = contents_hash(before), contents_hash(wanted)
        entry = Entry(words[0], now_ns, table, kept, *hashes)
        self.journal.note(entry)
        try:
            self._write(held, wanted)
        except ControllerError as error:
            done = self._put_back(before, entry, error)
            raise ControllerError(f"{error}; {done}") from error
        self._end(entry, words[1], wanted)
        return entry

    def _put_back(self, before: Contents, entry: Entry, error: ControllerError) -> str:
        """Bring back what was there before, and return in words what had to be done."""
        try:
            found = self.store.read(before)
            self._write(found, before)
            self._end(entry, "rolled_back", before)
            if found == texts_of(before):
                return "the controller holds what it held before, nothing had to be put back"
            return "the old table was put back"
        except (ControllerError, OSError) as second:
            raise ControllerError(
                f"{error}; putting the old table back failed too ({second}): it is not known "
                f"what the controller holds. The old table is in "
                f"{self.journal.folder / entry.backup}; restore it before the axis moves"
            ) from second

    def _end(self, entry: Entry, action: Action, contents: Contents) -> None:
        """Note how a change ended, and what the controller holds since."""
        in_force = in_force_of(texts_of(contents))
        self.journal.note(replace(entry, action=action, time_ns=self.now_ns(), in_force=in_force))

    def _write(self, held: Mapping[str, str], wanted: Contents) -> None:
        """Write step by step and compare; ControllerError when anything else is there then."""
        for step in write_steps(held, wanted):
            self.store.write(step)
        found = self.store.read(wanted)
        wrong = sorted(name for name, text in wanted.items() if found.get(name) != text)
        if wrong:
            raise ControllerError(
                f"read back, the controller's {', '.join(wrong)} differ from what was written"
            )


def write_steps(held: Mapping[str, str], wanted: Contents) -> list[dict[str, str | None]]:
    """Return what has to be written, one after the other, to get from ``held`` to ``wanted``.

    The first of the ``wanted`` files is the table, those after it say how it is read. A table
    alone is replaced in one step. When one of the others changes, the table is away meanwhile: a
    crash between two steps leaves no table, never rows that are read by another's rule.
    """
    changed = {name: text for name, text in wanted.items() if held.get(name) != text}
    table = next(iter(wanted))
    if not of_the_controller({n: "" for n in changed if n != table}):
        return [changed] if changed else []
    others = {name: text for name, text in changed.items() if name != table}
    steps: list[dict[str, str | None]] = [others]
    if table in held:
        steps.insert(0, {table: None})
    if wanted[table] is not None:
        steps.append({table: wanted[table]})
    return steps
