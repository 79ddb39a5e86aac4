"""One YAML file is one calibration: reading it, its groups, and its fingerprint.

The file is an ordinary ROS 2 parameter file (``/**: ros__parameters: ...``), so that the same
file starts the nodes through ROS 2's launch, through ``rotcal run``, and solves a bag offline.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

import yaml

from rotcal_ros.errors import ConfigurationError
from rotcal_ros.settings import load

T = TypeVar("T")

GROUPS: Final = (
    "cell",
    "plan",
    "capture",
    "solver",
    "planner",
    "recorder",
    "bridge",
    "topics",
    "simulation",
)
"""Groups of settings that a configuration may hold, besides ``method``."""


@dataclass(frozen=True)
class Configuration:
    """A checked configuration: the method's name and the raw groups of settings.

    ``text`` is the YAML as given, ``source`` names it in error texts, ``plan_id`` is the
    SHA-256 of the text: two runs with the same plan_id were configured alike.
    """

    method: str
    groups: Mapping[str, Mapping[str, Any]]
    text: str
    source: str

    @property
    def plan_id(self) -> str:
        """SHA-256 of the configuration text, in hexadecimal."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def group(self, name: str, cls: type[T]) -> T:
        """Return group ``name`` as the settings dataclass ``cls``; see settings.load."""
        return load(cls, self.groups.get(name), f"{self.source}: {name}")


def read_configuration(path: Path) -> Configuration:
    """Read a configuration file; raises ConfigurationError when it cannot be used."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"cannot read the configuration {path}: {error}") from error
    return parse_configuration(text, str(path))


def parse_configuration(text: str, source: str = "configuration") -> Configuration:
    """Parse configuration text; raises ConfigurationError with ``source`` in the text."""
    try:
        document = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ConfigurationError(f"{source}: not valid YAML: {error}") from error
    try:
        parameters = document["/**"]["ros__parameters"]
        method = parameters["method"]
    except (KeyError, TypeError):
        raise ConfigurationError(
            f"{source}: expected a ROS 2 parameter file with '/**: ros__parameters: method: ...'"
        ) from None
    if not isinstance(method, str):
        raise ConfigurationError(f"{source}: method must be a name, found {method!r}")
    groups = {name: value for name, value in parameters.items() if name != "method"}
    for name in groups:
        if name not in GROUPS:
            raise ConfigurationError(
                f"{source}: unknown group {name!r}; known: method, {', '.join(GROUPS)}"
            )
    return Configuration(method=method, groups=groups, text=text, source=source)


def dump_configuration(method: str, groups: Mapping[str, Mapping[str, Any]]) -> str:
    """Return configuration text in the canonical order of groups."""
    parameters = {"method": method, **{n: dict(groups[n]) for n in GROUPS if n in groups}}
    text: str = yaml.safe_dump(
        {"/**": {"ros__parameters": parameters}}, sort_keys=False, default_flow_style=None
    )
    return text
