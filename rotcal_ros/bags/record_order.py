"""Checking the order of the records of an MCAP file, which readers of streams count on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from rotcal_ros.bags import mcap_records as mcap
from rotcal_ros.bags.framing import Record

_OF_DATA: Final = (mcap.MESSAGE, mcap.CHUNK, mcap.MESSAGE_INDEX, mcap.ATTACHMENT, mcap.METADATA)
_OF_SUMMARY: Final = (
    mcap.CHUNK_INDEX,
    mcap.ATTACHMENT_INDEX,
    mcap.STATISTICS,
    mcap.METADATA_INDEX,
    mcap.SUMMARY_OFFSET,
)


class RecordOrder:
    """Is told of every record in file order, and reports (offset, words) those out of place."""

    def __init__(self, report: Callable[[int, str], None]) -> None:
        self._report = report
        self._last = 0
        self._data_ended = False

    def passed(self, record: Record) -> None:
        """Take note of the next record at the top level."""
        fault = self._fault(record.opcode)
        if fault:
            self._report(record.offset, fault)
        self._last = record.opcode
        self._data_ended |= record.opcode == mcap.DATA_END

    def _fault(self, opcode: int) -> str:
        if (opcode == mcap.HEADER) != (self._last == 0):
            return "a second header" if self._last else "the file does not begin with a header"
        if opcode == mcap.MESSAGE_INDEX and self._last not in (mcap.CHUNK, mcap.MESSAGE_INDEX):
            return "a message index without a chunk before it"
        if opcode == mcap.DATA_END and self._data_ended:
            return "a second end of the data"
        if opcode == mcap.FOOTER and not self._data_ended:
            return "the end of the data is not marked"
        if opcode in _OF_DATA and self._data_ended:
            return f"a record {opcode} of the data stands in the summary"
        if opcode in _OF_SUMMARY and not self._data_ended:
            return f"a record {opcode} of the summary stands among the data"
        return ""
