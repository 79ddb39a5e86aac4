"""The reference of all settings, in words: what the page of settings and ``rotcal settings`` say.

Both are written from the declarations, so that neither can say anything else than is checked.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, replace
from typing import Any, Final

from rotcal_ros.bags.settings import ReadingLimits
from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.settings import Declaration, declarations
from rotcal_ros.methods.configuration import GROUPS, SHARED_GROUPS
from rotcal_ros.methods.method import method_names, own_settings

OWN_GROUPS: Final = tuple(name for name in GROUPS if name not in SHARED_GROUPS)
"""Groups that every method declares for itself."""
KINDS: Final[Mapping[type, str]] = {
    bool: "true or false",
    int: "whole",
    float: "number",
    str: "text",
}
Mark = Callable[[str], str]
"""How a text value is set off from the words around it, ```text``` on a page."""
_UNIT: Final = re.compile(r"(\S+), ")
"""What a description begins with where its setting has a unit."""


@dataclass(frozen=True)
class Section:
    """One group of settings: its name, that of its method ("" if shared), what it declares.

    ``group`` is empty for settings that stand in a file of their own: the goal of a plan. Those of
    a controller are ``named_alone``, without the group's name.
    """

    group: str
    method: str
    cls: type[Any]
    named_alone: bool = False

    @property
    def summary(self) -> str:
        """What the group is for, in one line."""
        return (self.cls.__doc__ or "").strip().splitlines()[0]

    def settings(self) -> Iterator[tuple[str, Declaration]]:
        """Yield (``group.name``, declaration) of every setting."""
        prefix = f"{self.group}." if self.group and not self.named_alone else ""
        for declared in declarations(self.cls):
            yield f"{prefix}{declared.name}", declared

    def rows(self, *, expert: bool) -> tuple[tuple[str, Declaration], ...]:
        """Return the settings for experts, or all others, as somebody reads them.

        What several places have alike is one row: ``table.*.phases_deg``, and its meaning ends
        with the names of the places.
        """
        alike: dict[tuple[str, Declaration], list[str]] = {}
        for name, declared in self.settings():
            if declared.info.expert == expert:
                place, _, last = name.rpartition(".")
                pattern = f"{place.rpartition('.')[0]}.*.{last}"
                alike.setdefault((pattern, replace(declared, name=last)), []).append(name)
        return tuple(_one_row(names, *same) for same, names in alike.items())


def shared_sections() -> tuple[Section, ...]:
    """Return the groups that are the same for all methods."""
    return tuple(Section(name, "", cls) for name, cls in SHARED_GROUPS.items())


def own_sections(name: str) -> tuple[Section, ...]:
    """Return the groups that a method declares for itself.

    Raises ConfigurationError, with the nearest name, when there is no such method.
    """
    classes = own_settings(name)
    return tuple(Section(group, name, classes[group]) for group in OWN_GROUPS)


def method_sections(name: str) -> tuple[Section, ...]:
    """Return all groups of a method: the shared ones, its own, and the simulation last.

    Raises ConfigurationError, with the nearest name, when there is no such method.
    """
    return (*shared_sections(), *own_sections(name))


def goal_sections() -> tuple[Section, ...]:
    """Return the settings of what plans are designed for, which have a file of their own."""
    goals = (plugins.load(plugins.GOALS, name, "goal") for name in plugins.names(plugins.GOALS))
    return tuple(Section("", "", goal) for goal in goals)


def controller_section(name: str) -> Section:
    """Return the settings of a controller: ``--set`` of ``rotcal export``, ``bridge.options``."""
    return Section(name, "", type(make_controller(name)), named_alone=True)


def reading_section() -> Section:
    """Return the limits of the bag reader, which are set on the command line alone."""
    return Section("reading", "", ReadingLimits)


def all_sections() -> tuple[Section, ...]:
    """Return every group: the shared ones, those of each method, what stands elsewhere."""
    own = (section for name in method_names() for section in own_sections(name))
    return (*shared_sections(), *own, *goal_sections(), reading_section())


def first_settings(sections: Iterable[Section]) -> tuple[tuple[str, Declaration], ...]:
    """Return (``group.name``, declaration) of what has to be stated to measure a real table."""
    declared = (pair for section in sections for pair in section.settings())
    return tuple((name, setting) for name, setting in declared if setting.info.first)


def _one_row(names: Sequence[str], pattern: str, declared: Declaration) -> tuple[str, Declaration]:
    """Return a setting with its name, or ``names`` as one ``pattern`` and what ``*`` may be."""
    if len(names) == 1:
        return names[0], declared
    places = ", ".join(name.split(".")[-2] for name in names)
    info = replace(declared.info, description=f"{declared.info.description}; *: {places}")
    return pattern, replace(declared, info=info)


def unit_and_meaning(declared: Declaration) -> tuple[str, str]:
    """Return the unit, empty where there is none, and the sentence without it."""
    text = declared.info.description
    unit = _UNIT.match(text)
    return (unit[1], text[unit.end() :]) if unit else ("", text)


def kind_in_words(declared: Declaration) -> str:
    """Return the kind of a value: ``number``, ``list of 3 number``."""
    kind = KINDS[declared.kind]
    if declared.is_list:
        kind = f"list of {'' if declared.length is None else f'{declared.length} '}{kind}"
    return kind


def default_in_words(declared: Declaration, mark: Mark = str) -> str:
    """Return the default as YAML would have it; ``-`` for a setting that has to be given."""
    if declared.default is MISSING:
        return "-"
    if declared.default is None:
        return "none"
    if isinstance(declared.default, bool):
        return str(declared.default).lower()
    if isinstance(declared.default, tuple):
        return "[" + ", ".join(_value(value, mark) for value in declared.default) + "]"
    return _value(declared.default, mark)


def range_in_words(declared: Declaration, mark: Mark = str) -> str:
    """Return the choices, or the inclusive range, or nothing."""
    info = declared.info
    if info.choices:
        return ", ".join(map(mark, info.named_choices))
    if info.minimum is None and info.maximum is None:
        return ""
    low = "" if info.minimum is None else f"{info.minimum:g}"
    return f"{low} ..." if info.maximum is None else f"{low} ... {info.maximum:g}"


def _value(value: Any, mark: Mark) -> str:
    if isinstance(value, str):
        return mark(value) if value else "empty"
    return f"{value:g}" if isinstance(value, float) else str(value)
