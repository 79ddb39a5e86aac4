"""Yielding small blocks together: a small one costs as much as a large one."""

from __future__ import annotations

from typing import Final

from rotcal_ros.bags.blocks import Block, joined

_JOINED_BYTES: Final = 1 << 20
"""Blocks are joined up to this size."""


class Held:
    """Blocks that wait for more; what is released keeps their order."""

    def __init__(self) -> None:
        self._blocks: list[Block] = []
        self._room = 0  # the first block goes at once: who wants no more need not wait

    def grown(self, block: Block) -> tuple[Block, ...]:
        """Take ``block``; return what has become large enough."""
        if len(block.data) >= _JOINED_BYTES:  # never copied
            return (*self.released(), *((block,) if len(block) else ()))
        self._blocks.append(block)
        self._room -= len(block.data)
        return () if self._room > 0 else self.released()

    def released(self) -> tuple[Block, ...]:
        """Return what is held as one block, if anything is."""
        if not self._blocks:
            return ()
        blocks, self._blocks, self._room = self._blocks, [], _JOINED_BYTES
        return (joined(blocks),)
