"""All that a table leaves open, asked at once: answers are tried to see what is asked after them.

A further question counts as open only if it comes whichever way those before it are answered. What
it says may depend on them all the same: then it names the answers that it is shown for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from time import process_time
from typing import Final, TypeAlias, TypeVar

from rotcal_ros.foundation.errors import Question, RotcalError, UndecidedError
from rotcal_ros.foundation.table_columns import AS_IT_STANDS, SheetSettings, option
from rotcal_ros.foundation.table_reading import Reading

T = TypeVar("T")
Announce: TypeAlias = Callable[[Reading], object]
_GROUP: Final = "sheet."
_COLUMNS: Final = "sheet.columns"
_MOST: Final = 80
_MOST_S: Final = 3.0
"""Readings that are tried, and for how long (s, of a processor); the rest is asked later."""


def asking_at_once(
    read: Callable[[SheetSettings, Announce], T], sheet: SheetSettings, announce: Announce
) -> T:
    """Return what ``read`` makes of a table with settings; it gives ``announce`` how.

    Raises what ``read`` raises; a question of the table has all others that are open as ``also``.
    """
    try:
        return read(sheet, announce)
    except RotcalError as error:
        if question := _of_the_table(error):
            trials = _Trials(lambda stated: read(stated, str))
            error.question = replace(question, also=trials.open_after(_Asked(question, sheet)))
        raise


def further_lines(question: Question | None) -> Iterator[str]:
    """Yield in lines what is asked besides a question, and how all is answered at once."""
    if question is None or not question.also:
        return
    for each in question.also:
        yield f"asked as well: {each.found}"
        yield from (f"{option(each.setting, value)}: {words}" for value, words in each.answers)
    yield f"all at once: {' '.join(_at_once((question, *question.also)))}"


def _at_once(questions: Sequence[Question]) -> Iterator[str]:
    """Yield an option for each setting that is asked for, words in the place of its values."""
    heads = [f"{'|'.join(_columns(q))}=HEAD" for q in questions if q.setting == _COLUMNS]
    if heads:
        yield option(_COLUMNS, *heads)
    for setting in dict.fromkeys(question.setting for question in questions):
        if setting != _COLUMNS:
            yield option(setting, setting.removeprefix(_GROUP).upper())


def _columns(question: Question) -> list[str]:
    """Return which columns of ours are asked for."""
    return sorted({value.partition("=")[0] for value, _ in question.answers})


def _of_the_table(error: RotcalError) -> Question | None:
    """Return the question of an error, with what was found, if settings of a table answer it."""
    question = error.question
    if question is None or not question.setting.startswith(_GROUP):
        return None
    return replace(
        question, found=error.found if isinstance(error, UndecidedError) else str(error)
    )


@dataclass(frozen=True)
class _Asked:
    """A question, and the settings that led to it."""

    question: Question
    sheet: SheetSettings

    @property
    def name(self) -> str:
        """The setting without its group."""
        return self.question.setting.removeprefix(_GROUP)

    @property
    def key(self) -> tuple[str, ...]:
        """What tells questions apart: the setting, of columns those that are asked for."""
        setting = self.question.setting
        return setting, *(_columns(self.question) if setting == _COLUMNS else ())

    def answered(self, value: str) -> SheetSettings | None:
        """Return the settings with an answer; None for one that only shows its form."""
        name = self.name
        if name == "columns":
            return replace(self.sheet, columns=(*self.sheet.columns, value))
        try:
            return replace(self.sheet, **{name: type(getattr(AS_IT_STANDS, name))(value)})
        except ValueError:
            return None


class _SpentError(Exception):
    """As many readings were tried as may be."""


class _Trials:
    """Reads a table with answers that are assumed."""

    def __init__(self, read: Callable[[SheetSettings], object]) -> None:
        self._read, self._left, self._until = read, _MOST, process_time() + _MOST_S

    def open_after(self, asked: _Asked) -> tuple[Question, ...]:
        """Return what is asked after a question, however it and what follows is answered."""
        try:
            return tuple(self._open_after(asked))
        except _SpentError:
            return ()

    def _open_after(self, asked: _Asked) -> Iterator[Question]:
        """Yield the questions after first answers that come after each other answer, too."""
        chain, _ = self._chain(asked)
        kept = {each.key: each for each in chain[1:]}
        depends = {key: list[str]() for key in kept}
        for k, before in enumerate(chain[:-1], start=1):
            (first, _), *others = before.question.answers
            for value, _ in others:
                follows, whole = self._after(before, value)
                for key in kept.keys() & {each.key for each in chain[k:]}:
                    if key not in follows and whole:
                        del kept[key]
                    elif key in follows and follows[key] != kept[key].question:
                        depends[key].append(f"{before.name}={first}")
        for key, each in kept.items():
            where = ", ".join(dict.fromkeys(depends[key]))
            found = f"{each.question.found} (if {where})" if where else each.question.found
            yield replace(each.question, found=found)

    def _after(self, asked: _Asked, value: str) -> tuple[dict[tuple[str, ...], Question], bool]:
        """Return the questions after an answer, and whether nothing stands against the rest."""
        sheet = asked.answered(value)
        if sheet is None:
            return {}, False
        question, whole = self._first(sheet)
        if question is None:
            return {}, whole
        chain, whole = self._chain(_Asked(question, sheet))
        return {each.key: each.question for each in chain}, whole

    def _chain(self, asked: _Asked) -> tuple[list[_Asked], bool]:
        """Return a question, those that first answers lead to, and whether it is read then."""
        chain = [asked]
        while True:
            sheet = chain[-1].answered(chain[-1].question.answers[0][0])
            if sheet is None:
                return chain, False
            question, whole = self._first(sheet)
            if question is None:
                return chain, whole
            follows = _Asked(question, sheet)
            if follows.key in {each.key for each in chain}:  # the answer does not settle it
                return chain, False
            chain.append(follows)

    def _first(self, sheet: SheetSettings) -> tuple[Question | None, bool]:
        """Return what is asked with settings, if anything, and whether the table is read."""
        if not self._left or process_time() > self._until:
            raise _SpentError
        self._left -= 1
        try:
            self._read(sheet)
        except RotcalError as error:
            return _of_the_table(error), False
        return None, True
