"""Hearing whether the table rests, whatever message the feedback comes in."""

from __future__ import annotations

from rotcal_ros.bags import names
from rotcal_ros.instrument_plugins.table_rest import TableRest
from rotcal_ros.instruments.interpreter import Interpreter
from rotcal_ros.nodes.cell_node import CellNode
from rotcal_ros.nodes.draining import Batch, sent_ns
from rotcal_ros.nodes.instrument_topics import InstrumentTopics
from rotcal_ros.observations import Command


class TableHearing:
    """Tells ``rest`` the feedback of ``joint``; topic, type and units as for the capture."""

    def __init__(self, node: CellNode, joint: str, rest: TableRest) -> None:
        self._joint, self._rest = joint, rest
        self._topics = InstrumentTopics(node, self._switched)
        self._interpreter = Interpreter(self._topics.settings, joint)
        self._topics.listen(names.JOINT_STATES, node.health.guarded(self.hear))

    def why_not(self, order: Command) -> str:
        """Return why the table does not rest where ``order`` has it; empty: it does."""
        if refused := self._topics.refused.get(names.JOINT_STATES):
            return refused
        why = self._rest.why_not(order)
        joint = self._joint and f", joint {self._joint}"
        return why and f"{why} ({self._topics.name(names.JOINT_STATES)}{joint})"

    def hear(self, type_name: str, batch: Batch) -> None:
        """Take messages of a type."""
        sent = [(message, sent_ns(info)) for message, info in batch]
        for sample in self._interpreter.records(names.JOINT_STATES, type_name, sent):
            self._rest.hear(sample)

    def _switched(self, _role: str) -> None:
        self._interpreter = Interpreter(self._topics.settings, self._joint)
        self._rest.forget()
