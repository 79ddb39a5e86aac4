"""Tables beside a configuration, that stand for long lists of its group ``plan``.

What is recorded has to be whole: a configuration is read with the content of its files in the
place of their names, as text. Its hash, the session's folder, the goal of a run and the bag hold
that text; nobody needs the files again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill

import yaml

from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.untrusted import load_yaml

Numbers = Sequence[float] | Sequence[int]


@dataclass(frozen=True)
class PlanFile:
    """A file whose content is the list ``setting`` of the group ``plan``; ``read`` reads it."""

    setting: str
    read: Callable[[Path], Numbers]


def with_contents(
    text: str, source: str, folder: Path, files: Callable[[str], Mapping[str, PlanFile]]
) -> str:
    """Return configuration text with the lists in the place of the names of files in ``folder``.

    ``files`` returns the files that a method knows, by the settings that name them. All else of
    the text stays, comments as well. Raises ConfigurationError, with ``source`` and the setting,
    for a file that cannot be read and for a list that is given twice.
    """
    method, plan = _plan(text)
    given = {key.value: (key, value) for key, value in plan if isinstance(key, yaml.ScalarNode)}
    known = files(method) if given else {}
    found = [
        (*given[name], file)
        for name, file in known.items()
        if name in given and given[name][1].value not in ("", [])
    ]
    for key, value, file in sorted(found, key=lambda item: -item[0].start_mark.index):
        place = f"{source}: plan.{key.value}"
        if file.setting in given:
            raise ConfigurationError(
                f"{place}: plan.{file.setting} is given as well: keep one of them"
            )
        if not isinstance(value, yaml.ScalarNode):
            raise ConfigurationError(f"{place}: expected the name of a file")
        try:
            numbers = file.read(folder / value.value)
        except (BagError, DataError) as error:
            raise ConfigurationError(f"{place}: {error}") from error
        listed = _in_yaml(file.setting, numbers, key.start_mark.column + 2)
        text = text[: key.start_mark.index] + listed + text[value.end_mark.index :]
    return text


def _in_yaml(name: str, numbers: Numbers, indent: int) -> str:
    """Return ``name: [...]`` in lines of readable length."""
    text = f"{name}: [{', '.join(map(repr, numbers))}]"
    return fill(text, 98, subsequent_indent=" " * indent, break_on_hyphens=False)


def _plan(text: str) -> tuple[str, list[tuple[yaml.Node, yaml.Node]]]:
    """Return the method and the entries of the group ``plan``; none where they cannot be found."""
    try:
        load_yaml(text, "")  # only what is within bounds is gone through node by node
        node = yaml.compose(text, Loader=yaml.SafeLoader)
    except (ConfigurationError, yaml.YAMLError):
        return "", []
    for name in ("/**", "ros__parameters"):
        node = _entry(node, name)
    method, plan = _entry(node, "method"), _entry(node, "plan")
    if not (isinstance(method, yaml.ScalarNode) and isinstance(plan, yaml.MappingNode)):
        return "", []
    return str(method.value), list(plan.value)


def _entry(node: yaml.Node | None, name: str) -> yaml.Node | None:
    if not isinstance(node, yaml.MappingNode):
        return None
    return next((value for key, value in node.value if key.value == name), None)
