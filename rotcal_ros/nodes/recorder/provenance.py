"""The provenance of a calibration, for its bag: versions of packages, parameters of all nodes."""

from __future__ import annotations

import json
import platform
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Final

from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.utilities import get_rmw_implementation_identifier

from rotcal_ros import __version__
from rotcal_ros.bags import names
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.middleware import distribution, rclpy_version
from rotcal_ros.methods.configuration import read_subject
from rotcal_ros.nodes.recorder.recording import BagRecording
from rotcal_ros.nodes.runtime.cell_node import CellNode, until

TIMEOUT_S: Final = 3.0
"""How long one question waits for its answer."""
ASKING_S: Final = 60.0
"""How long nodes are asked that do not answer."""
_PACKAGES = ("numpy", "scipy", "mcap", "rclpy", "ros-rclpy", "rotcal_msgs")


def keep_provenance(recording: BagRecording, configuration_text: str) -> None:
    """Put the configuration, what it measures and the versions into a bag."""
    recording.attach(names.CONFIGURATION, "application/yaml", configuration_text.encode())
    recording.note(names.SUBJECT, subject(configuration_text))
    recording.attach(names.VERSIONS, "application/json", versions_json().encode())


def subject(configuration_text: str) -> dict[str, str]:
    """Return what a configuration measures, for a bag's metadata; empty when it says nothing.

    The method is not loaded: that takes longer than a recorder may be silent.
    """
    with suppress(ConfigurationError):
        identity, simulated = read_subject(configuration_text)
        return {"item": identity.title, "simulated": str(simulated).lower()}
    return {}


def versions_json() -> str:
    """Return the versions of packages, Python, operating system and middleware as JSON."""
    installed = {package: _version(package) for package in _PACKAGES}
    versions = {
        "rotcal_ros": __version__,
        "python": platform.python_version(),
        **{package: found for package, found in installed.items() if found},
        "system": platform.platform(),
        "ros_distro": distribution(rclpy_version()) or "",
        "rmw": get_rmw_implementation_identifier(),
    }
    return json.dumps(versions, indent=1)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


class NodeParameters:
    """The parameters of all nodes, as JSON in a bag: node name -> parameter -> value.

    All are asked at once while the calibration begins, again and again where they are slow. A node
    that has not answered after ASKING_S, or when the bag was closed, is null.
    """

    def __init__(self, recording: BagRecording, node: CellNode) -> None:
        self._recording, self._node = recording, node
        self._found: dict[str, Any] = {}
        self._attached = False

    async def ask(self) -> None:
        """Ask all nodes that beat or are in the cell's namespace."""
        node, namespace = self._node, self._node.get_namespace()
        listed = {n for n, space in node.get_node_names_and_namespaces() if space == namespace}
        others = sorted((listed | node.health.present()) - {node.get_name()})
        own = node.get_parameters_by_prefix("")
        self._found = dict.fromkeys(others)
        self._found[node.get_name()] = {key: _plain(mine.value) for key, mine in own.items()}
        for name in others:
            node.begin(self._ask, name, f"{namespace.rstrip('/')}/{name}")
        await until(lambda: None not in self._found.values(), ASKING_S)
        self.attach()

    async def _ask(self, name: str, remote: str) -> None:
        """Ask one node until it has answered; a silent one does not hold up the others."""
        while self._found[name] is None and not self._attached:
            self._found[name] = await _parameters_of(self._node, remote)

    def attach(self) -> None:
        """Put the answers so far into the bag, once."""
        if not self._attached:
            text = json.dumps(self._found, indent=1, sort_keys=True)
            self._recording.attach(names.PARAMETERS, "application/json", text.encode())
        self._attached = True


async def _parameters_of(node: Node, remote: str) -> dict[str, Any] | None:
    lister = node.create_client(ListParameters, f"{remote}/list_parameters")
    getter = node.create_client(GetParameters, f"{remote}/get_parameters")
    try:
        listed = await _ask(lister, ListParameters.Request())
        if listed is None:
            return None
        wanted = sorted(listed.result.names)
        answer = await _ask(getter, GetParameters.Request(names=wanted))
        values = [] if answer is None else list(answer.values)
        if len(values) == len(wanted):
            return dict(zip(wanted, map(_value, values), strict=True))
        found: dict[str, Any] = {}
        # Asked for several, a node answers with none if one of them has no value.
        for name in wanted:
            answer = await _ask(getter, GetParameters.Request(names=[name]))
            if answer is not None and answer.values:
                found[name] = _value(answer.values[0])
        return found
    finally:
        node.destroy_client(lister)
        node.destroy_client(getter)


async def _ask(client: Client, request: Any) -> Any | None:
    if not await until(client.service_is_ready, TIMEOUT_S):
        return None
    future = client.call_async(request)
    return future.result() if await until(future.done, TIMEOUT_S) else None


def _value(parameter: ParameterValue) -> Any:
    return _plain(parameter_value_to_python(parameter))


def _plain(value: Any) -> Any:
    return value if value is None or isinstance(value, bool | int | float | str) else list(value)
