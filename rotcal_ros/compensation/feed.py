"""Feeds a controller: a table that arrives is judged, and applied only after confirmation.

Each change of its files is noted before and after and read back: the old table is kept, and there
are never two halves. A machine that says it is at work is not fed.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Final, cast

import numpy as np

from rotcal_ros.compensation.agreement import NO_MACHINE, MachineIdentity, check_table_for_machines
from rotcal_ros.compensation.bridge_settings import BridgeSettings
from rotcal_ros.compensation.cascaded_tables import Combination, combine_with_table_in_force
from rotcal_ros.compensation.controller import Controller
from rotcal_ros.compensation.controller_store import STATE_FOLDER, ControllerStore, make_store
from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.compensation.export import (
    FIRST_ANGLE_DEG,
    LAST_ANGLE_DEG,
    ExportFiles,
    default_stem,
    format_utc,
    prepare_export,
)
from rotcal_ros.compensation.held_table import (
    HeldTable,
    hash_in_force,
    held_table,
    machine_from_files,
)
from rotcal_ros.compensation.journal import (
    Action,
    Contents,
    Journal,
    JournalEntry,
    contents_hash,
    existing_files,
)
from rotcal_ros.compensation.table import DIRECTIONS, CompensationTable
from rotcal_ros.compensation.writing import PROVENANCE, WRITTEN, without_provenance, write_files
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ControllerError, DataError, RotcalError
from rotcal_ros.foundation.in_force import NONE, UNKNOWN, is_table_hash
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC, DEGREE, NANOSECOND
from rotcal_ros.foundation.untrusted import load_json, read_bytes


@dataclass(frozen=True)
class AppliedChange:
    """What was done: where the controller's files are, the old ones' folder, change in rad.

    ``unfinished`` describes an earlier change that was never finished, if there was one.
    """

    files: tuple[str, ...]
    backup: Path
    largest_change: float
    unfinished: str | None = None


class Feed:
    """The feed of one controller for one axis.

    ``now_ns`` returns the time (ns since 1970). ``store`` replaces that of the settings.
    ``simulated``: the cell is simulated, so that its tables may be too. ``serial`` is the number
    of the item in the cell, empty if it is not known, ``stated`` what its settings say is in
    force.
    """

    def __init__(
        self,
        settings: BridgeSettings,
        axis: str,
        now_ns: Callable[[], int],
        store: ControllerStore | None = None,
        *,
        simulated: bool = False,
        serial: str = "",
        stated: str = UNKNOWN,
    ) -> None:
        self.settings, self.axis = settings, axis
        self._takes_simulated = simulated or settings.accept_simulated
        self._cell, self._stated = MachineIdentity(axis, serial), stated
        self._now_ns = now_ns
        self._controller = make_controller(settings.controller, settings.controller_settings)
        self._store = store or make_store(settings, self._controller)
        self._journal = Journal(Path(settings.controller_folder) / STATE_FOLDER)
        self._exchanging = FileExchange(self._store, self._journal, now_ns)
        self.offer: TableOffer | None = None

    def take(self, table: CompensationTable, stamp_ns: int) -> tuple[Path, ...]:
        """Check ``table`` against the configuration, keep it, and write its files.

        Returns the files: a new folder below the output folder, or the one that holds these very
        files already. Raises RotcalError, and forgets the earlier table, when it cannot be fed to
        this controller. A table that was measured on top of the one in force is added to it, see
        :func:`combine_with_table_in_force`; it has to belong to this cell
        (:func:`check_table_for_machines`).
        """
        self.forget()
        word = cast(Combination, self.settings.combine)
        self._refuse_journal(table, stamp_ns, word)
        now_ns = self._now_ns()
        measured = self._agreeing(table, stamp_ns, now_ns)
        table = combine_with_table_in_force(measured, self._held, word)
        if table.adds_to:
            self._agreeing(measured, stamp_ns, now_ns, machine_from_files(self._present()))
        self.offer = make_offer(table, stamp_ns, self.settings, self.axis, now_ns)
        return self.offer.paths

    def forget(self) -> None:
        """Forget the table that was offered."""
        self.offer = None

    def refuse_simulated(self) -> None:
        """Raise DataError if the offered table is simulated and the cell is real."""
        if self.offer is not None and self.offer.table.simulated and not self._takes_simulated:
            raise DataError(
                "the table is SIMULATED, no instrument measured it, and this is the bridge of a "
                "real cell: feed a measured one, or set bridge.accept_simulated for a trial"
            )

    def in_force(self) -> str:
        """Return which table the controller holds: its hash, "none", or "unknown".

        Without files it is "none" only if the journal or, before the first change, the settings
        say so too; else "unknown". See :meth:`contradiction`.
        """
        if not self.settings.controller_folder or self._journal.unfinished():
            return UNKNOWN
        held = hash_in_force(self._present())
        return held if held != NONE else self._noted()

    def contradiction(self, held: str) -> str | None:
        """Return in words what contradicts that ``held`` is in force, if anything does."""
        if held == UNKNOWN and is_table_hash(noted := self._last_noted()):
            return (
                "the controller shows no table, but according to the journal it was given "
                f"{noted[:12]}: inspect the controller; then restore, which removes the table or "
                "brings it back"
            )
        if self._stated not in (UNKNOWN, held) and held != UNKNOWN:
            return (
                f"cell.table_in_force says {self._stated[:12]}, and the controller holds "
                f"{held[:12]}: correct the setting, or leave it to this bridge"
            )
        return None

    def _noted(self) -> str:
        """Return what is in force where the controller has no file."""
        if not self._journal.entries():
            return NONE if self._stated == NONE else UNKNOWN
        return UNKNOWN if is_table_hash(self._last_noted()) else NONE

    def _last_noted(self) -> str:
        history = self._journal.history()
        return history[-1][1] if history else ""

    def open(self) -> str | None:
        """Take the sole right to feed the controller; return an unfinished change."""
        self._refuse_no_controller()
        self._store.lock()
        return self.unfinished()

    def apply(self, confirmation: str) -> AppliedChange:
        """Give the table to the controller; ``confirmation`` is the hash over files and options.

        Keeps the old table, writes, reads back and compares. If the controller holds anything else
        afterwards, the old table is put back and ControllerError raised.
        """
        offer = self._confirmed(confirmation)
        self.refuse_simulated()
        self._refuse_unfinished()
        self._refuse_stale(offer)
        self._refuse_unused(offer)
        self._refuse_another_base(offer)
        offer.refuse_changed()
        old = self._store.read(offer.files)
        self._agreeing(offer.table, offer.stamp_ns, self._now_ns(), machine_from_files(old))
        rows = offer.export.table.angles
        change = self._change(old, offer.files, rows)
        self._refuse_large(change, self.settings.max_change_arcsec)
        return self._exchange(
            ("applying", "applied"), old, offer.files, change, offer.table.table_hash
        )

    def restore(self, kept_hash: str, max_change_arcsec: float = 0.0) -> AppliedChange:
        """Put back what the controller held when its files had this hash; keep what it holds now.

        ``max_change_arcsec`` replaces the limit of the settings this once; 0: it does not. If the
        present table cannot be read, the change is not known: then only an unfinished change is
        undone, unless a limit was given.
        """
        unfinished = self.open()
        entry = self._to_restore(kept_hash)
        kept = self._journal.backup_before(entry)
        present = self._store.read(kept)
        try:
            change = self._change(present, existing_files(kept))
        except RotcalError as error:
            change = float("nan")
            if not max_change_arcsec and entry != self._journal.unfinished():
                raise ControllerError(
                    f"{error}; to restore nevertheless, give max_change_arcsec, the largest "
                    "change that you accept"
                ) from error
        else:
            self._refuse_large(change, max_change_arcsec or self.settings.max_change_arcsec)
        table_hash = self._journal.table_of(contents_hash(kept)) or ""
        done = self._exchange(("restoring", "restored"), present, kept, change, table_hash)
        return replace(done, unfinished=unfinished)

    def next_restore(self) -> str | None:
        """Return the hash that undoes the last change, if there is one."""
        entry = self._journal.last_undoable()
        return None if entry is None else entry.before_hash

    def unfinished(self) -> str | None:
        """Return in words the change that was never finished, if there is one."""
        entry = self._journal.unfinished()
        if entry is None:
            return None
        kept = self._journal.kept(entry.backup)
        held = self._store.read(kept)
        whole = {entry.before_hash: "the old files", entry.after_hash: "the new files"}
        found = whole.get(contents_hash({name: held.get(name) for name in kept}))
        what = (
            f"{entry.action} table {entry.table_hash[:12]}" if entry.table_hash else entry.action
        )
        return (
            f"{what}, begun at {format_utc(entry.time_ns)}, was never finished: the "
            f"controller holds {found or 'neither all old nor all new files'}; restore "
            f"{entry.before_hash} before the axis moves"
        )

    def close(self) -> None:
        """Let another bridge feed the controller."""
        self._store.close()

    def _confirmed(self, confirmation: str) -> TableOffer:
        """Return the offer with this hash, and hold the lock."""
        offer = self.offer
        if offer is None:
            raise DataError(
                "no table has arrived that could be fed to this controller: calibrate first"
            )
        if confirmation != offer.confirmation:
            raise DataError(
                f"the files here have the hash {offer.confirmation}, the confirmation is for "
                f"{confirmation or 'none'}: look at the files and confirm this hash"
            )
        self._refuse_no_controller()
        self._store.lock()
        return offer

    def _to_restore(self, kept_hash: str) -> JournalEntry:
        entry = self._journal.change_from(kept_hash)
        if entry is not None:
            return entry
        undo = self.next_restore()
        if undo is None:
            raise DataError(
                "no table was applied here, so none can be taken back: apply one first"
            )
        raise DataError(
            f"nothing with the hash {kept_hash or 'none'} was kept; the last change is undone by "
            f"{undo}. {self.unfinished() or ''}".rstrip()
        )

    def _refuse_no_controller(self) -> None:
        if not self.settings.controller_folder:
            raise DataError(
                "no controller is configured (bridge.controller_folder is empty): copy the "
                "written files by hand"
            )

    def _refuse_unfinished(self) -> None:
        if unfinished := self.unfinished():
            raise ControllerError(unfinished)

    def _refuse_stale(self, offer: TableOffer) -> None:
        restored_ns = self._journal.last_restore_ns()
        if offer.stamp_ns <= restored_ns:
            age = (restored_ns - offer.stamp_ns) * NANOSECOND
            raise DataError(
                f"the table is stale: it was made {age:.0f} s before the controller's old table "
                "was restored; measure again with what the controller holds now"
            )

    def _refuse_journal(self, table: CompensationTable, stamp_ns: int, word: Combination) -> None:
        """Refuse a table if the journal contradicts its statement on the table in force.

        A table in force that the journal does not know may have been copied there by hand.
        """
        claim, stated = f"measured with {table.measured_on[:12]!r} in force", table.measured_on
        if stated == UNKNOWN and word == "replace":
            claim, stated = "bridge.combine says 'replace'", NONE
        elif stated == UNKNOWN and word == "add":
            claim, stated = "bridge.combine says 'add'", self.in_force()
        if stated != NONE and stated not in {held for _, held in self._journal.history()}:
            return
        from_ns = table.measured_from_ns or stamp_ns
        then = self._journal.held_while(from_ns, table.measured_until_ns or stamp_ns)
        wrong = [event for event in then if event[1] != stated]
        if not wrong and is_table_hash(stated):  # nor may it have come only then
            wrong = [event for event in then[:1] if event[0] > from_ns]
        if not wrong:
            return
        since_ns, held = wrong[0]
        raise DataError(
            f"{claim}, but according to the journal of this bridge the controller held "
            f"{f'the table {held[:12]}' if is_table_hash(held) else 'no table'} then (since "
            f"{format_utc(since_ns)}): so the statement about the measurement is wrong, and would "
            "spoil the correction. Measure again, and let this bridge announce what is "
            "in force (leave cell.table_in_force out)"
        )

    def _agreeing(
        self,
        table: CompensationTable,
        stamp_ns: int,
        now_ns: int,
        held: MachineIdentity = NO_MACHINE,
    ) -> CompensationTable:
        """Return ``table`` if it belongs to this cell and to the machine of the one in force."""
        machines = {"this cell": self._cell, "the table in force": held}
        return check_table_for_machines(table, machines, self.settings.accepted, now_ns, stamp_ns)

    def _refuse_unused(self, offer: TableOffer) -> None:
        """Refuse a table that the machine's own files would ignore, or read differently."""
        controller = self._controller.for_axis(self.axis)
        files = without_provenance(offer.files)
        if wrong := controller.not_in_use(self.axis, files, Path(self.settings.controller_folder)):
            raise DataError(f"the machine would not use the table: {'; '.join(wrong)}")

    def _refuse_another_base(self, offer: TableOffer) -> None:
        base = offer.table.adds_to
        if base and (found := self.in_force()) != base:
            since = [ns for ns, held in self._journal.history() if held == base]
            when = f", which it was given at {format_utc(since[-1])}" if since else ""
            raise DataError(
                f"the table adds to the table {base[:12]}{when}, and what is in force now is "
                f"{found[:12]}: measure again with what the controller holds now"
            )

    def _present(self) -> dict[str, str]:
        """Return the files that the controller holds, including our side file."""
        names = self._journal.names() or self._usual_names()
        return self._store.read(dict.fromkeys(names, ""))

    def _usual_names(self) -> tuple[str, ...]:
        """Return the names of our files for this controller, before there is a journal."""
        stem, suffixes = (
            default_stem(self.axis, self.settings.controller),
            self._controller.suffixes,
        )
        return tuple(stem + suffix for suffix in (*suffixes, PROVENANCE)) if suffixes else ()

    def _held(self) -> HeldTable | None:
        """Return the table in force, None if there is none."""
        if not self.settings.controller_folder or self.in_force() in (NONE, UNKNOWN):
            return None
        return held_table(self._controller, self._present())

    def _change(self, old: Mapping[str, str], new: Mapping[str, str], *rows: Floats) -> float:
        return largest_change(self._controller.for_axis(self.axis), old, new, *rows)

    def _refuse_large(self, change: float, limit_arcsec: float) -> None:
        if not change <= limit_arcsec * ARCSEC:
            raise DataError(
                f"the table changes the correction by up to {change / ARCSEC:.4g} arcsec, "
                f"max_change_arcsec is {limit_arcsec:.4g}: look at the table, and raise the limit "
                "if it is right. Nothing was changed"
            )

    def _refuse_busy(self) -> None:
        command = self.settings.busy_command or self._controller.busy_command
        timeout_s = self.settings.answer_timeout_s
        if work := self._store.busy() or ask_machine_activity(command, timeout_s):
            raise ControllerError(
                f"the machine is at work: {work}; wait until it stands, then apply again. "
                "Nothing was changed"
            )

    def _exchange(
        self,
        words: tuple[Action, Action],
        held: Mapping[str, str],
        wanted: Contents,
        change: float,
        table_hash: str,
    ) -> AppliedChange:
        self._refuse_busy()
        entry = self._exchanging.make(words, held, wanted, table_hash)
        paths = tuple(map(self._store.address, existing_files(wanted)))
        return AppliedChange(paths, self._journal.folder / entry.backup, change)


GRID_STEP: Final = 0.25 * DEGREE
"""Angles (rad) at which two corrections are compared."""


def largest_change(
    controller: Controller, old: Mapping[str, str], new: Mapping[str, str], *rows: Floats
) -> float:
    """Return the largest difference (rad) between what the controller makes of both.

    Both directions are compared over the whole travel, over the span of both tables, which may lie
    outside it, and at further angles ``rows`` (rad). Raises ControllerError when files cannot be
    read.
    """
    first, last = controller.travel
    count = round((last - first) / GRID_STEP) + 1
    spans = [(first, last), *_spans(old), *_spans(new)]
    grid = np.concatenate([*(np.linspace(*span, count) for span in spans), *rows])
    differences = [
        np.abs(_correction(controller, new, grid, a) - _correction(controller, old, grid, a))
        for a in DIRECTIONS
    ]
    return float(np.max(differences))


def _spans(files: Mapping[str, str]) -> list[tuple[float, float]]:
    """Return first and last angle (rad) of our own tables; of others they are not known."""
    sides = (text for name, text in files.items() if name.endswith(PROVENANCE))
    return [span for text in sides if (span := _span(text)) is not None]


def _span(provenance: str) -> tuple[float, float] | None:
    try:
        side = load_json(provenance)
        return side[FIRST_ANGLE_DEG] * DEGREE, side[LAST_ANGLE_DEG] * DEGREE
    except (ValueError, TypeError, KeyError):
        return None  # written by hand


def _correction(
    controller: Controller, files: Mapping[str, str], grid: Floats, approach: Approach
) -> Floats:
    tables = without_provenance(files)
    if not tables:
        return np.full_like(grid, controller.without_table(approach))
    try:
        rule = controller.read(tables)
    except RotcalError as error:
        raise ControllerError(
            "the table that the controller holds cannot be read, so the change is not known "
            f"({error}): look at the table and move it away by hand; nothing was changed"
        ) from error
    return rule.correction(grid, approach)


def ask_machine_activity(command: Sequence[str], timeout_s: float) -> str | None:
    """Return what the machine is doing in words; None when it rests or cannot be asked.

    ``command`` ends with exit code 0 if the machine rests, else with 1 and a line that says why;
    an empty command: the machine cannot be asked. Raises ControllerError if there is no answer
    within ``timeout_s``, or another exit code: an unknown state is not rest.
    """
    if not command:
        return None
    name = " ".join(command)
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=timeout_s, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ControllerError(
            f"it is not known whether the machine is at work ({name}: {error}): correct "
            "this command (bridge.busy_command). Nothing was changed"
        ) from error
    last = (done.stdout.strip() or done.stderr.strip()).rpartition("\n")[2]
    if done.returncode not in (0, 1):
        raise ControllerError(
            f"it is not known whether the machine is at work ({name} ended with code "
            f"{done.returncode}: {last}): correct this command (bridge.busy_command). "
            "Nothing was changed"
        )
    return (last or f"{name} says so") if done.returncode else None


@dataclass(frozen=True)
class FileExchange:
    """Changes the files in ``store`` and notes it in ``journal``; ``now_ns`` since 1970."""

    store: ControllerStore
    journal: Journal
    now_ns: Callable[[], int]

    def make(
        self, words: tuple[Action, Action], held: Mapping[str, str], wanted: Contents, table: str
    ) -> JournalEntry:
        """Keep what is ``held``, write what is ``wanted``, and note both ends of it.

        ``words`` name begin and end, ``table`` is the hash of the table. Returns what was noted at
        the begin. Raises ControllerError when the old files had to be put back, or could not be.
        """
        before: Contents = {name: held.get(name) for name in wanted}
        now_ns = self.now_ns()
        if now_ns < self.journal.last_ns():
            raise ControllerError(
                "the clock is behind the last change in the journal, so tables measured before "
                "and after it could not be distinguished: set the clock; nothing was changed"
            )
        kept = self.journal.keep(before, now_ns)
        hashes = contents_hash(before), contents_hash(wanted)
        entry = JournalEntry(words[0], now_ns, table, kept, *hashes)
        self.journal.note(entry)
        try:
            self._write(held, wanted)
        except ControllerError as error:
            done = self._put_back(before, entry, error)
            raise ControllerError(f"{error}; {done}") from error
        self._end(entry, words[1], wanted)
        return entry

    def _put_back(self, before: Contents, entry: JournalEntry, error: ControllerError) -> str:
        """Put back what was there before, and return in words what had to be done."""
        try:
            found = self.store.read(before)
            self._write(found, before)
            self._end(entry, "rolled_back", before)
            if found == existing_files(before):
                return "the controller holds what it held before, nothing had to be put back"
            return "the old table was put back"
        except (ControllerError, OSError) as second:
            raise ControllerError(
                f"{error}; putting the old table back failed too ({second}): it is not known "
                f"what the controller holds. The old table is in "
                f"{self.journal.folder / entry.backup}; restore it before the axis moves"
            ) from second

    def _end(self, entry: JournalEntry, action: Action, contents: Contents) -> None:
        """Note how a change ended, and what the controller holds from then on."""
        in_force = hash_in_force(existing_files(contents))
        self.journal.note(replace(entry, action=action, time_ns=self.now_ns(), in_force=in_force))

    def _write(self, held: Mapping[str, str], wanted: Contents) -> None:
        """Write step by step and compare; ControllerError when the result differs."""
        for step in write_steps(held, wanted):
            self.store.write(step)
        found = self.store.read(wanted)
        wrong = sorted(name for name, text in wanted.items() if found.get(name) != text)
        if wrong:
            raise ControllerError(
                f"read back, the controller's {', '.join(wrong)} differ from what was written"
            )


def write_steps(held: Mapping[str, str], wanted: Contents) -> list[dict[str, str | None]]:
    """Return the steps of writing that lead from ``held`` to ``wanted``.

    The first of the ``wanted`` files is the table, the others say how it is read. A table alone is
    replaced in one step. If one of the others changes, the table is removed meanwhile: a crash
    between two steps leaves no table, and never rows that are read by the rule of another table.
    """
    changed = {name: text for name, text in wanted.items() if held.get(name) != text}
    table = next(iter(wanted))
    if not without_provenance({n: "" for n in changed if n != table}):
        return [changed] if changed else []
    others = {name: text for name, text in changed.items() if name != table}
    steps: list[dict[str, str | None]] = [others]
    if table in held:
        steps.insert(0, {table: None})
    if wanted[table] is not None:
        steps.append({table: wanted[table]})
    return steps


MAX_STD_RATIO: Final = 3.0
"""Above this ratio of standard uncertainty to largest correction a table is refused."""
MAX_AHEAD_NS: Final = 1_000_000_000
"""The clock of the solver may be ahead of ours by this much."""


@dataclass(frozen=True)
class TableOffer:
    """A table, made at ``stamp_ns``, and the files that it becomes when it is applied.

    ``paths`` are those for people, empty if none are written. ``files`` are their texts.
    """

    table: CompensationTable
    stamp_ns: int
    export: ExportFiles
    files: Mapping[str, str]
    paths: tuple[Path, ...]

    @property
    def confirmation(self) -> str:
        """The hash over files and options that confirms this offer."""
        return self.export.confirmation

    def refuse_changed(self) -> None:
        """Raise DataError unless the files for people are those that would be applied."""
        for path in self.paths:
            if _text(path) != self.files[path.name]:
                raise DataError(
                    f"{path} was changed since it was written, so the file seen is not the file "
                    "that would be applied: remove the folder and publish the table again"
                )


def make_offer(
    table: CompensationTable, stamp_ns: int, settings: BridgeSettings, axis: str, now_ns: int
) -> TableOffer:
    """Check ``table`` against the configuration, and write its files for people.

    They go into a folder of their own, named after their hash; one that already holds exactly
    these files is used again. Raises RotcalError if the table cannot be fed to this controller, or
    the folder holds anything else.
    """
    _refuse_unbelievable(table, stamp_ns, now_ns)
    reference = settings.reference_deg
    export = prepare_export(
        table,
        settings.controller,
        now=datetime.fromtimestamp(now_ns * NANOSECOND, timezone.utc),
        axis=axis,
        spacing=settings.spacing_deg * DEGREE or None,
        reference_angle=None if reference is None else reference * DEGREE,
        settings=settings.controller_settings,
        # The controller knows its file under one name, whatever is in it.
        stem=default_stem(table.axis, settings.controller),
        accept_unverified=settings.accept_unverified,
    )
    if not settings.output_folder:
        return TableOffer(table, stamp_ns, export, export.files, ())
    folder = Path(settings.output_folder) / f"{table.axis}-{export.confirmation}".lower()
    if not folder.is_dir() or not any(folder.iterdir()):
        return TableOffer(table, stamp_ns, export, export.files, write_files(export.files, folder))
    files = _looked_at(folder, export.files)
    return TableOffer(table, stamp_ns, export, files, tuple(folder / name for name in files))


def _refuse_unbelievable(table: CompensationTable, stamp_ns: int, now_ns: int) -> None:
    ahead_ns = stamp_ns - now_ns
    if ahead_ns > MAX_AHEAD_NS:
        raise DataError(
            f"the table is stamped {ahead_ns * NANOSECOND:.4g} s in the future: set the clocks of "
            "solver and bridge, and solve again"
        )
    columns = np.abs([table.correction_forward, table.correction_reverse])
    largest, std = float(np.max(columns)), table.largest_std
    if std > MAX_STD_RATIO * largest:
        raise DataError(
            f"the table's largest standard uncertainty, {std / ARCSEC:.4g} arcsec, is more than "
            f"{MAX_STD_RATIO:g} times its largest correction, {largest / ARCSEC:.4g} arcsec: "
            "it would gain nothing; measure longer, or feed none"
        )


def _looked_at(folder: Path, files: Mapping[str, str]) -> dict[str, str]:
    """Return the texts in ``folder``; DataError unless only the time of writing may differ."""
    found = {path.name: _text(path) for path in folder.iterdir()}
    texts = {name: text for name, text in found.items() if text is not None}
    wrong = [n for n in found.keys() | files.keys() if not _same(n, texts.get(n), files.get(n))]
    if wrong:
        raise DataError(
            f"{folder} does not hold exactly the files of this table "
            f"({', '.join(sorted(wrong))}): remove the folder and publish the table again"
        )
    return {name: texts[name] for name in files}


def _same(name: str, found: str | None, wanted: str | None) -> bool:
    if found is None or wanted is None or not name.endswith(PROVENANCE):
        return found is not None and found == wanted
    try:
        sides = [load_json(text) for text in (found, wanted)]
        return bool(sides[0] == {**sides[1], WRITTEN: sides[0][WRITTEN]})
    except (ValueError, TypeError, KeyError):
        return False


def _text(path: Path) -> str | None:
    """Return the text of a plain file, None for anything else."""
    if path.is_symlink() or not path.is_file():
        return None
    return read_bytes(path).decode("latin-1")
