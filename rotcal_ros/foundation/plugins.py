"""Plug-ins of installed packages: methods, controllers, instruments, verbs, by entry points.

The built-in ones are found the same way, and so are the packages beside the core; there is no
built-in instrument.
"""

from __future__ import annotations

import difflib
import json
import sys
from collections.abc import Collection
from functools import cache, cached_property
from importlib import import_module
from importlib.metadata import EntryPoint, distribution, entry_points
from pathlib import Path
from traceback import walk_tb
from types import FrameType
from typing import Any, Final, NamedTuple

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.node_names import FURTHER_NODES

METHODS: Final = "rotcal_ros.methods"
METHOD_SETTINGS: Final = "rotcal_ros.method_settings"
"""The settings of a method, if they can be read without loading the method."""
CONTROLLERS: Final = "rotcal_ros.controllers"
STORES: Final = "rotcal_ros.stores"
"""Transport of the group ``bridge`` -> function that makes the store of a controller."""
STORE_SETTINGS: Final = "rotcal_ros.store_settings"
"""Transport -> the class that declares its settings, a group inside ``bridge``."""
INSTRUMENTS: Final = "rotcal_ros.instruments"
SETTINGS: Final = "rotcal_ros.settings"
"""Group of a configuration -> the class that declares its settings."""
DRIVER_CHECKS: Final = "rotcal_ros.driver_checks"
"""Group of a configuration -> what a check of a cell reports about its driver."""
VERBS: Final = "rotcal_ros.verbs"
"""A :class:`Verb` each, which describes a command without loading it."""
GROUP_NODES: Final = "rotcal_ros.group_nodes"
"""Group of a configuration -> the :class:`GroupNode` that is started for it."""
NODES: Final = "rotcal_ros.nodes"
"""Nodes of packages beside the core: the command of one -> its function."""
PLANS: Final = "rotcal_ros.plans"
"""Commands of click below ``rotcal plan``."""
GOALS: Final = "rotcal_ros.goals"
"""The settings of what a plan is designed for, which stand in a file of their own."""
FUNCTIONS: Final = "rotcal_ros.functions"
"""Names that packages beside the core add to ``import rotcal_ros``."""
FIGURES: Final = "rotcal_ros.figures"
"""Figures of a result, which it asks of the packages above it."""
CERTIFICATES: Final = "rotcal_ros.certificates"
"""The writer of certificates for ``rotcal report``."""
HISTORIES: Final = "rotcal_ros.histories"
"""The module that keeps results, and says what has changed since the last one."""
TABLES: Final = "rotcal_ros.tables"
"""What reads tables of another form than ours: a :class:`~.table_reading.FormReader`."""
KINDS: Final = {
    METHODS: "method",
    CONTROLLERS: "controller",
    STORES: "transport",
    INSTRUMENTS: "instrument",
    VERBS: "verb",
    PLANS: "plan",
    TABLES: "reader of tables",
}
INDEX: Final = Path(__file__).with_name("packages.json")
"""Package beside the core -> group -> names that it brings: errors say what to install for them.

``scripts/package_index.py`` makes it; no code looks here for what is installed.
"""
_OWN: Final = "rotcal_ros"
_LONGEST: Final = 80
"""Most characters of an unknown name that are compared with the existing ones."""


class Verb(NamedTuple):
    """A verb that ``rotcal`` lists, with a line of ``help``, following the verb ``after``.

    Its command of click is ``command`` in ``module``, which is loaded only when it is called.
    """

    help: str
    module: str
    after: str = ""


class GroupNode(NamedTuple):
    """A node that is started when a configuration has its group.

    ``roles``: what it plays, the ``table``, the ``probe``. ``instead_of``: groups whose nodes are
    not started then. ``polled``: its table is asked seldom while it has no order.
    """

    name: str
    roles: tuple[str, ...] = ()
    instead_of: tuple[str, ...] = ()
    polled: bool = False


_all = cache(entry_points)
"""All entry points of all packages: reading them takes longer than choosing a group."""


@cache
def _found(group: str) -> dict[str, EntryPoint]:
    return {point.name: point for point in sorted(_all().select(group=group))}


def names(group: str) -> tuple[str, ...]:
    """Return the names that ``group`` offers, in alphabetical order; loads nothing."""
    return tuple(_found(group))


@cache
def load(group: str, name: str, what: str) -> Any:
    """Load the entry point ``name`` of ``group``.

    Raises ConfigurationError, with the nearest name, when there is none, and with the extra that
    the entry point names when something cannot be imported; ``what`` is the kind of plug-in in
    words.
    """
    found = _found(group)
    if name not in found:
        raise ConfigurationError(f"unknown {what} {name!r:.80}{name_hint(name, found, group)}")
    point = found[name]
    try:
        return point.load()
    except Exception as error:  # code of another package may raise anything
        why = str(error) if isinstance(error, ImportError) else f"{type(error).__name__}: {error}"
        if isinstance(error, ImportError) and point.dist is not None and point.extras:
            why += f": pip install '{point.dist.metadata['Name']}[{','.join(point.extras)}]'"
        raise ConfigurationError(
            f"the {what} {name!r} ({_package(point)}) cannot be loaded: {why}"
        ) from error


class _Later:
    """What stands at a ``place``, loaded when it is first called or asked for something."""

    def __init__(self, place: str) -> None:
        self._place = place

    def __call__(self, *given: Any, **named: Any) -> Any:
        return self._found(*given, **named)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._found, name)

    @cached_property
    def _found(self) -> Any:
        module, _, name = self._place.partition(":")
        return getattr(import_module(module), name)


def lazy_load(place: str) -> Any:
    """Return what "module:name" names, loaded when it is used: most of a plug-in seldom is.

    >>> lazy_load("math:floor")(2.5)
    2
    """
    return _Later(place)


def extension(group: str, name: str, what: str) -> Any:
    """Load the entry point ``name`` of ``group``, which ``what`` needs.

    Raises ConfigurationError, with what to install, if it, or a package that it needs, is missing.
    """
    point = _found(group).get(name)
    if point is None:
        raise ConfigurationError(f"{what} needs {name!r}{package_hint(name, group)}")
    try:
        return point.load()
    except ImportError as error:
        owner = point.dist.metadata["Name"] if point.dist else point.module
        wanted = f"'{owner}[{','.join(point.extras)}]'" if point.extras else owner
        raise ConfigurationError(
            f"{what} needs the package {str(error.name).partition('.')[0]}: pip install {wanted}"
        ) from error


def node_module(name: str) -> str:
    """Return the module of a node, which is a command of this package or of one beside it.

    Raises ConfigurationError if the package that provides it is not installed.
    """
    scripts = distribution(_OWN).entry_points.select(group="console_scripts", name=name)
    found: tuple[EntryPoint, ...] = (*scripts, *filter(None, [_found(NODES).get(name)]))
    if found:
        return found[0].module
    raise ConfigurationError(f"no node {name!r}{package_hint(name, NODES)}")


def group_nodes() -> dict[str, GroupNode]:
    """Return group -> node, ours first, then those of installed packages."""
    found = {group: GroupNode(name) for group, name in FURTHER_NODES.items()}
    return found | {g: load(GROUP_NODES, g, "node") for g in names(GROUP_NODES) if g not in found}


def nodes_of_groups(groups: Collection[str]) -> list[str]:
    """Return the nodes that a configuration starts for its groups, beside those of every cell."""
    known = {group: node for group, node in group_nodes().items() if group in groups}
    elsewhere = {group for node in known.values() for group in node.instead_of}
    return [node.name for group, node in known.items() if group not in elsewhere]


def failing_plugin(error: BaseException) -> str | None:
    """Return in words the plug-in of another package in which ``error`` was raised, if any.

    It is the innermost one between the place where the error was caught and the one where it was
    raised, even if a function that the plug-in called raised it. Of several plug-ins in one
    package it is the one whose module and object was at work; all of them if that does not decide.
    """
    frames = reversed(list(walk_tb(error.__traceback__)))
    line_of_code, suspects = "", []
    for frame, line in frames:
        module = str(frame.f_globals.get("__name__", ""))
        if not line_of_code:
            suspects = _foreign(module.partition(".")[0])
            line_of_code = f"{frame.f_code.co_filename}, line {line}" if suspects else ""
        for nearer in (_in_module, _at_work):
            suspects = [s for s in suspects if nearer(s[1], frame)] or suspects
    if not suspects:
        return None
    named = " or ".join(f"{what} {point.name!r}" for what, point in suspects)
    return f"in the {named} ({_package(suspects[0][1])}: {line_of_code})"


def describe_error(error: BaseException) -> str:
    """Return an unexpected exception in words, with the plug-in that it was raised in."""
    plug_in = failing_plugin(error)
    return f"{type(error).__name__}{f' {plug_in}' if plug_in else ''}: {error}"


def _foreign(package: str) -> list[tuple[str, EntryPoint]]:
    """Return the plug-ins that another ``package`` provides, with their kinds in words."""
    return [
        (what, point)
        for group, what in KINDS.items()
        for point in _found(group).values()
        if point.module.partition(".")[0] == package != _OWN
    ]


def _in_module(point: EntryPoint, frame: FrameType) -> bool:
    return bool(frame.f_globals.get("__name__", "") == point.module)


def _at_work(point: EntryPoint, frame: FrameType) -> bool:
    """Return whether ``frame`` belongs to a method of the object that ``point`` names."""
    named = getattr(sys.modules.get(point.module), point.attr, None)
    self = frame.f_locals.get("self")
    return named is not None and (named is self or named is type(self))


def _package(point: EntryPoint) -> str:
    """Return name and version of the package that provides ``point``."""
    if point.dist is None:
        return point.module
    return f"{point.dist.metadata['Name']} {point.dist.version}"


def name_hint(name: str, known: Any, *groups: str) -> str:
    """Return a hint at a missing package, at the name that was meant, or the list of all.

    ``groups``: of which the name may be; where none is given, what a setting may name.
    """
    for group in groups or (CONTROLLERS, STORES):
        if name not in _found(group) and (hint := package_hint(name, group)):
            return hint
    near = difflib.get_close_matches(name[:_LONGEST], list(known), n=1)
    if near:
        return f"; did you mean {near[0]!r}?"
    return f"; known: {', '.join(known) or 'none'}"


def package_hint(name: str, group: str) -> str:
    """Return what to install for a name that a package beside the core brings; "" for others."""
    package = provider(name, group)
    return f"; its package is not installed: pip install {package}" if package else ""


def provider(name: str, group: str) -> str:
    """Return which package beside the core brings a name, installed or not; "" for others."""
    index = json.loads(INDEX.read_text(encoding="utf-8"))
    return next((owner for owner, brought in index.items() if name in brought.get(group, ())), "")
