"""A snapshot of a cell: what its check has heard, and under which names."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from rotcal_ros.bags import names
from rotcal_ros.bags.topic_roles import TOPIC
from rotcal_ros.capture.instruments.conventions import single_shots
from rotcal_ros.foundation.node_names import FURTHER_NODES, further_nodes
from rotcal_ros.methods import Calibration, Configuration
from rotcal_ros.nodes.check.drivers import TableEars, brought
from rotcal_ros.nodes.check.header_watch import HeaderWatch
from rotcal_ros.nodes.goal.preflight import Values
from rotcal_ros.nodes.instruments.table_feedback import joint_faults
from rotcal_ros.nodes.runtime.cell_graph import CellGraph

SIMULATION: Final = FURTHER_NODES["simulation"]


@dataclass(frozen=True)
class CellSnapshot:
    """What a check has to judge by; ``calibration``: None where no configuration was given.

    ``compared`` are the streams whose clocks could be held against that of the table. ``adapter``
    is there where the configuration has a table adapter: the table is what is behind it.
    """

    graph: CellGraph
    values: Values
    headers: Mapping[str, HeaderWatch]
    configuration: Configuration
    calibration: Calibration | None
    compared: tuple[str, ...]
    adapter: TableEars | None = None

    def name(self, role: str) -> str:
        """Return the absolute name of the topic of a role, as the capture knows it."""
        return self.values.get(TOPIC + role) or self.graph.resolve(role)

    def publishers(self, role: str) -> list[str]:
        """Return the names of the nodes that publish the topic of a role."""
        return self.graph.publishers(self.name(role))

    def unusable(self, role: str) -> str | None:
        """Return in words why the topic of a role is of no use; None: it is of use."""
        if role == names.JOINT_STATES and self.adapter is not None:
            wrong = self.adapter.wrong()
            return None if wrong is None else wrong.found
        silent = role in single_shots(self.configuration.topics)
        delivered = silent or self.values.get(f"valid.{role}", "0") != "0"
        return next(self.graph.without_instrument(self.name(role), delivered), None)

    def joint_faults(self) -> Iterator[str]:
        """Yield what is wrong with the table's joint; an adapter has its own word about that."""
        if self.adapter is None:
            yield from joint_faults(self.values, self.configuration.cell.joint)

    @cached_property
    def nodes(self) -> frozenset[str]:
        """The names of the nodes that are in the cell's namespace."""
        place = self.graph.node.get_namespace().rstrip("/")
        return frozenset(n for n, where in self.graph.nodes() if where.rstrip("/") == place)

    @cached_property
    def brought(self) -> Mapping[str, list[str]]:
        """Role -> nodes of all that drivers will bring which ``rotcal run`` starts."""
        return brought(self)

    @property
    def topics(self) -> tuple[str, ...]:
        """The instrument topics that must be there."""
        always = (names.JOINT_STATES, names.PROBE_POINT)
        return always if self.calibration is None else self.configuration.method.topics

    @property
    def started_by_us(self) -> bool:
        """Whether ``rotcal run`` starts the instruments itself: a node simulates them."""
        simulated = SIMULATION in further_nodes(self.configuration.given)
        return simulated and not self.publishers(names.JOINT_STATES)
