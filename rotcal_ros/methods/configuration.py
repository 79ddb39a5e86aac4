"""One YAML file is one calibration: read once, checked whole, every group a typed object.

The same file starts the nodes through ROS 2's launch, through ``rotcal run``, and solves a bag or
a plain table offline. It may be an ordinary ROS 2 parameter file (``/**: ros__parameters: ...``),
or have ``method`` and the groups at the top. There, in short, settings of the plan and of the
solver may stand without their group.

Long lists of a plan may stand in files of their own, which the configuration names: as it is read,
its text takes their contents in place of the names (:func:`configuration_text`). What is
recorded has to be whole: its hash, the session's folder, the goal of a run and the bag hold that
text.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from textwrap import fill
from typing import Any, Final

import yaml

from rotcal_ros.bags.settings import RecorderSettings, TopicSettings
from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.compensation.bridge_settings import BridgeSettings
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.settings import declarations, load, to_mapping
from rotcal_ros.foundation.table_columns import SheetSettings
from rotcal_ros.foundation.untrusted import (
    load_yaml,
    read_errors_as,
    read_text,
    require_no_secret,
    yaml_line_of,
    yaml_nodes,
)
from rotcal_ros.methods.air_settings import AirSettings
from rotcal_ros.methods.method import Method, find_method, method_names
from rotcal_ros.planning.choices import AS_LISTED
from rotcal_ros.planning.settings import (
    CellSettings,
    HealthSettings,
    PlannerSettings,
    SafetySettings,
    TableAdapterSettings,
)

PACKAGE_GROUPS: Final[Mapping[str, type[Any]]] = {
    name: plugins.load(plugins.SETTINGS, name, "group") for name in plugins.names(plugins.SETTINGS)
}
"""Groups that packages beside the core declare, by their entry points."""
SHARED_GROUPS: Final[Mapping[str, type[Any]]] = {
    "cell": CellSettings,
    "capture": CaptureSettings,
    "air": AirSettings,
    "planner": PlannerSettings,
    "safety": SafetySettings,
    "health": HealthSettings,
    "recorder": RecorderSettings,
    "bridge": BridgeSettings,
    **PACKAGE_GROUPS,
    "topics": TopicSettings,
    "identity": Identity,
    "sheet": SheetSettings,
    "table_adapter": TableAdapterSettings,
}
"""Groups of settings that are the same for all methods."""
_ORDER: Final = (
    "identity", "sheet", "cell", "plan", "capture", "air", "solver", "planner", "safety", "health",
    "recorder", "bridge", "instrument", "table_adapter", "topics", "page", "simulation",
)  # fmt: skip
"""How a configuration is written, with the groups of packages that may be installed."""
_KNOWN: Final = {*SHARED_GROUPS, "plan", "solver", "simulation"}
GROUPS: Final = (*(name for name in _ORDER if name in _KNOWN), *sorted(_KNOWN.difference(_ORDER)))
"""All groups, in the order in which a configuration is written; those of others come last."""
ALL_NODES: Final = "/**"
PARAMETERS: Final = "ros__parameters"
USE_SIM_TIME: Final = "use_sim_time"
"""Parameter of ROS's own beside the groups: all nodes follow ``/clock``."""
SIMULATION: Final = "simulation"
"""A configuration with this group is that of a simulated cell."""
OFFLINE_GROUPS: Final = ("identity", "cell", "plan", "capture", "air", "solver", "topics")
"""Groups that a recording is solved with; the others have done their work."""


def settings_classes(method: Method) -> dict[str, type[Any]]:
    """Return the registry of settings: group -> settings class, for one method."""
    classes = {**SHARED_GROUPS, **method.own_settings}
    return {name: classes[name] for name in GROUPS}


@dataclass(frozen=True)
class Configuration:
    """A checked configuration: one typed object for every group of settings.

    The classes of ``plan``, ``solver`` and ``simulation`` are those of the method. ``given`` holds
    the names of the groups that the text has, and of their settings as ``group.setting``; all
    others are at their defaults. ``simulated``: the cell is a simulated one, the text has a group
    ``simulation``. ``use_sim_time``: its nodes follow ``/clock``. ``text`` is the YAML as given,
    ``source`` names it in error texts. ``of_packages``: the groups of packages beside the core.

    >>> import rotcal_ros as rc
    >>> configuration = rc.read_configuration("examples/data/ball_plate.yaml")
    >>> configuration.method.name, configuration.simulated, configuration.cell.axis
    ('ball_plate', True, 'C')
    """

    method: Method
    cell: CellSettings
    plan: Any
    capture: CaptureSettings
    air: AirSettings
    solver: Any
    planner: PlannerSettings
    safety: SafetySettings
    health: HealthSettings
    recorder: RecorderSettings
    bridge: BridgeSettings
    topics: TopicSettings
    identity: Identity
    sheet: SheetSettings
    table_adapter: TableAdapterSettings
    simulation: Any
    simulated: bool
    given: frozenset[str]
    text: str
    source: str
    use_sim_time: bool = False
    of_packages: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def group(self, name: str) -> Any:
        """Return the settings of a group, of the core or of a package."""
        return self.of_packages[name] if name in self.of_packages else getattr(self, name)

    def __repr__(self) -> str:
        cell = "simulated cell" if self.simulated else "cell"
        named = f" {self.identity.title}" if self.identity.title else ""
        return f"<Configuration: {self.method.name}, {cell}{named}, from {self.source}>"

    @property
    def plan_id(self) -> str:
        """SHA-256 of the text, in hexadecimal: equal for two runs that were configured alike."""
        return hashlib.sha256(self.text.encode()).hexdigest()


def read_configuration(path: Path) -> Configuration:
    """Read a configuration file; raises ConfigurationError when it cannot be used."""
    return parse_configuration(configuration_text(path), str(path))


def configuration_text(path: Path) -> str:
    """Return the text of a configuration file, with the content of the files that it names.

    Raises ConfigurationError when one of them cannot be read, or a URL carries a secret: the text
    is kept as it is, comments included.
    """
    with read_errors_as(path, ConfigurationError, "the configuration "):
        text = read_text(path)
    for number, line in enumerate(text.splitlines(), start=1):
        require_no_secret(line, f"{path}, line {number}")
    return _with_contents(text, str(path), path.parent)


def parse_configuration(
    text: str, source: str = "configuration", groups: Collection[str] = GROUPS
) -> Configuration:
    """Return the configuration that ``text`` states.

    Only ``groups`` are looked at, the others keep their defaults. Raises ConfigurationError, with
    ``source``, the place and the nearest name, for whatever is misspelt or impossible.
    """
    name, values = raw_groups(text, source)
    try:
        method = find_method(name)
    except ConfigurationError as error:
        raise ConfigurationError(f"{source}: {error}") from error
    use_sim_time = values.pop(USE_SIM_TIME, False)
    if not isinstance(use_sim_time, bool):
        raise ConfigurationError(
            f"{source}: {USE_SIM_TIME} is true or false, found {use_sim_time!r:.80}"
        )
    for group, value in values.items():
        if group not in GROUPS:
            known = ("method", *GROUPS, *short_names(method))
            hint = _without_its_group(method, str(group))
            hint = hint or plugins.name_hint(str(group), known, plugins.SETTINGS)
            what = "group" if isinstance(value, Mapping) else "setting"
            raise ConfigurationError(f"{source}: unknown {what} {group!r:.80}{hint}")
    given = frozenset(values) & frozenset(groups)
    loaded: dict[str, Any] = {
        group: load(cls, values[group] if group in given else None, f"{source}: {group}")
        for group, cls in settings_classes(method).items()
    }
    of_packages = {group: loaded.pop(group) for group in PACKAGE_GROUPS}
    settings = (f"{group}.{setting}" for group in given for setting in values[group] or ())
    return Configuration(
        method=method,
        **loaded,
        simulated=SIMULATION in values,
        given=given.union(settings),
        text=text,
        source=source,
        use_sim_time=use_sim_time,
        of_packages=of_packages,
    )


def read_subject(text: str, source: str = "configuration") -> tuple[Identity, bool]:
    """Return what a configuration measures and whether a simulation does, and nothing else.

    Raises ConfigurationError where even that cannot be read.
    """
    _, values = raw_groups(text, source)
    identity = load(Identity, values.get("identity"), f"{source}: identity")
    return identity, SIMULATION in values


def read_topics(text: str) -> TopicSettings:
    """Return what a configuration says of its topics, whatever else of it can be read."""
    with suppress(ConfigurationError):
        return load(TopicSettings, raw_groups(text, "configuration")[1].get("topics"), "topics")
    return TopicSettings()


@lru_cache(maxsize=4)  # every solution asks it of the same text
def read_policy(text: str) -> str:
    """Return the policy that a configuration states, whatever else of it can be read today."""
    with suppress(ConfigurationError):
        planner = raw_groups(text, "configuration")[1].get("planner")
        if isinstance(planner, Mapping):
            return str(planner.get("policy", AS_LISTED))
    return AS_LISTED


def changed(
    configuration: Configuration, changes: Sequence[str], groups: Collection[str] = GROUPS
) -> Configuration:
    """Return the configuration with ``group.name=value`` changes.

    A value is YAML; of a setting that is a text it is that text, in quotes or not. Only
    ``groups`` are looked at. Without any changes the text stays as it is. Raises
    ConfigurationError for what cannot be set.
    """
    if not changes:
        return configuration
    name, given = raw_groups(configuration.text, configuration.source)
    parameters: dict[str, Any] = {"method": name, **given}
    columns: list[Any] = []
    for change in changes:
        setting, value = parsed_change(str(parameters["method"]), change)
        place, last = _place(parameters, setting, f"--set {change}")
        if setting == "sheet.columns" and isinstance(value, list):
            value = columns = [*columns, *value]  # several options add up
        place[last] = value
    text = dump_configuration(str(parameters.pop("method")), parameters)
    source = f"{configuration.source} with --set"
    text = _with_contents(text, source, Path(configuration.source).parent)
    return parse_configuration(text, source, groups)


def replaced(configuration: Configuration, group: str, values: Mapping[str, Any]) -> str:
    """Return the text of a configuration whose ``group`` has only these ``values``."""
    name, groups = raw_groups(configuration.text, configuration.source)
    return dump_configuration(name, {**groups, group: values})


def _without_its_group(method: Method, name: str) -> str:
    """Return a hint where ``name`` is no group but a setting, or a group, inside of one."""
    found = [
        f"{group}.{name}"
        for group, cls in settings_classes(method).items()
        if any(declared.name.partition(".")[0] == name for declared in declarations(cls))
    ]
    return f"; it belongs to a group: {' or '.join(found)}" if found else ""


def node_parameters(configuration: Configuration) -> str:
    """Return what the configuration states as a parameter file that ROS reads.

    ROS takes one type in a list, and no group that is empty: here every number of a float setting
    has its point, and what is not given, or None, is left out.
    """
    parameters: dict[str, Any] = {"method": configuration.method.name}
    if configuration.use_sim_time:
        parameters[USE_SIM_TIME] = True
    for group in GROUPS:
        values = to_mapping(configuration.group(group))
        given = {n: v for n, v in values.items() if f"{group}.{n}" in configuration.given}
        parameters[group] = _without_none(given)
    document = {ALL_NODES: {PARAMETERS: {n: v for n, v in parameters.items() if v != {}}}}
    return str(yaml.dump(document, Dumper=_Quoting, sort_keys=False, default_flow_style=None))


class _Quoting(yaml.SafeDumper):  # type: ignore[misc]
    """Quotes texts that ROS would take for true, or for a number, as y and 1e3."""


_TAKEN_FOR_MORE: Final = re.compile("[yYnN]|[-+.0-9].*")


def _text_for_ros(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    style = '"' if _TAKEN_FOR_MORE.fullmatch(text) else None
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Quoting.add_representer(str, _text_for_ros)


def _without_none(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested groups without what is None and without groups that are empty."""
    kept = {n: _without_none(v) if isinstance(v, Mapping) else v for n, v in values.items()}
    return {name: value for name, value in kept.items() if value is not None and value != {}}


def dump_configuration(method: str, groups: Mapping[str, Mapping[str, Any]]) -> str:
    """Return configuration text in the canonical order of groups; unknown ones come last."""
    names = [*(name for name in GROUPS if name in groups), *(groups.keys() - set(GROUPS))]
    parameters = {"method": method, **{name: groups[name] for name in names}}
    text: str = yaml.safe_dump(
        {ALL_NODES: {PARAMETERS: parameters}}, sort_keys=False, default_flow_style=None
    )
    return text


def _with_contents(text: str, source: str, folder: Path) -> str:
    """Return configuration text with the lists in place of the names of files in ``folder``.

    The files are not needed again. All else of the text stays, comments as well.
    Raises ConfigurationError, with ``source`` and the setting, for a file that cannot be read and
    for a list that is given twice.
    """
    method, plan = _plan(text)
    given = {key.value: (key, value) for key, value in plan if isinstance(key, yaml.ScalarNode)}
    known = find_method(method).plan_files if given and method in method_names() else {}
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
        listed, indent = ", ".join(map(repr, numbers)), " " * (key.start_mark.column + 2)
        listed = fill(f"{file.setting}: [{listed}]", 98, subsequent_indent=indent,
                      break_on_hyphens=False)  # fmt: skip
        text = text[: key.start_mark.index] + listed + text[value.end_mark.index :]
    return text


def _plan(text: str) -> tuple[str, list[tuple[yaml.Node, yaml.Node]]]:
    """Return the method and the entries that may be of the group ``plan``; none without either."""
    try:
        load_yaml(text, "")  # only what is within bounds is gone through node by node
        node = yaml_nodes(text)
    except (ConfigurationError, yaml.YAMLError):
        return "", []
    short = list(node.value) if _entry(node, "method") else []
    for name in () if short else (ALL_NODES, PARAMETERS):
        node = _entry(node, name)
    method, plan = _entry(node, "method"), _entry(node, "plan")
    if not isinstance(method, yaml.ScalarNode):
        return "", []
    return str(method.value), short + (plan.value if isinstance(plan, yaml.MappingNode) else [])


def _entry(node: yaml.Node | None, name: str) -> yaml.Node | None:
    if not isinstance(node, yaml.MappingNode):
        return None
    return next((value for key, value in node.value if key.value == name), None)


def raw_groups(text: str, source: str) -> tuple[str, dict[str, Any]]:
    """Return the name of the method, and the groups that a configuration states, unchecked.

    Raises ConfigurationError for a text that has neither ROS's form nor ``method`` at the top.
    """
    document = load_yaml(text, source)
    at_the_top = isinstance(document, Mapping) and "method" in document
    try:
        if at_the_top and ALL_NODES not in document:
            values = dict(document)
        else:
            _require_alone(text, source, document, ALL_NODES)
            _require_alone(text, source, document[ALL_NODES], PARAMETERS)
            values = dict(document[ALL_NODES][PARAMETERS])
        method = values.pop("method")
    except (KeyError, TypeError, ValueError):
        raise ConfigurationError(
            f"{source}: expected 'method: NAME' at the top, or a ROS 2 parameter file with "
            f"'{ALL_NODES}: {PARAMETERS}: method: ...'; `rotcal new` writes one"
        ) from None
    if not isinstance(method, str):
        raise ConfigurationError(
            f"{source}: method must be a name, found {method!r:.80}: name "
            "one method, as 'method: ball_plate'"
        )
    return method, _in_groups(method, values, source) if at_the_top else values


def _in_groups(method: str, entries: dict[str, Any], source: str) -> dict[str, Any]:
    """Return the groups of a configuration; what it states in short goes where it belongs.

    What cannot be known stays. Raises ConfigurationError for what is stated twice.
    """
    short = {n: v for n, v in entries.items() if n not in (*_KNOWN, *_ORDER, USE_SIM_TIME)}
    if not short or method not in method_names():
        return entries
    found = find_method(method)
    groups = {name: value for name, value in entries.items() if name not in short}
    names = short_names(found)
    for name, value in found.short_setup(short).items():
        full = names.get(name, str(name))
        group, last = _place(groups, full, source)
        if last in group and name in short:
            raise ConfigurationError(
                f"{source}: {name} is given at the top, and in a group as {full}: keep one of them"
            )
        group.setdefault(last, value)
    return groups


def short_names(method: Method) -> dict[str, str]:
    """Return the full names of the settings of plan and solver by their last word, if unique."""
    full = [
        f"{group}.{declared.name}"
        for group in ("plan", "solver")
        for declared in declarations(method.own_settings[group])
    ]
    last = [name.rpartition(".")[2] for name in full]
    return {short: name for short, name in zip(last, full, strict=True) if last.count(short) == 1}


def _require_alone(text: str, source: str, group: Any, name: str) -> None:
    """Raise ConfigurationError where something that is not read stands beside ``name``."""
    if not (isinstance(group, Mapping) and name in group):
        return
    for other in group:
        if other != name:
            above = () if name == ALL_NODES else (ALL_NODES,)
            line = yaml_line_of(text, *above, str(other))
            raise ConfigurationError(
                f"{source}: {f'line {line}: ' if line else ''}{other!r:.80} stands beside "
                f"{name!r}, where it is not read: take it out, or put it where it belongs, in a "
                f"group below '{ALL_NODES}: {PARAMETERS}:'"
            )


def parsed_change(method: str, change: str) -> tuple[str, Any]:
    """Return name and value, unchecked, of a ``group.name=value`` for a configuration of a method.

    Raises ConfigurationError where it is none.
    """
    name, equals, text = change.partition("=")
    if not equals or not name or name.endswith("."):
        raise ConfigurationError(f"--set {change}: expected GROUP.NAME=VALUE")
    quoted = len(text) > 1 and text[0] in "'\"" and text[0] == text[-1]
    group, _, last = name.partition(".")
    cls = settings_classes(find_method(method)).get(group)
    texts = [d.name for d in declarations(cls) if d.kind is str and not d.is_list] if cls else []
    plain = not quoted and last in texts
    return name, text if plain else load_yaml(text, f"--set {change}")


def _place(parameters: dict[str, Any], name: str, where: str) -> tuple[dict[str, Any], str]:
    """Return the group in ``parameters`` that the dotted ``name`` is for, and its last word."""
    *groups, last = name.split(".")
    place = parameters
    for group in groups:
        if place.get(group) is None:
            place[group] = {}
        place = place[group]
        if not isinstance(place, dict):
            raise ConfigurationError(
                f"{where}: {group} is a value, not a group: leave out what follows it"
            )
    return place, last
