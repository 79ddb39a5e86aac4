"""Random numbers by index: number 17 of a stream is the same however many were asked for."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum, unique

import numpy as np

from rotcal_ros.foundation.arrays import Floats

_BLOCK = 512


@unique
class NoiseSource(IntEnum):
    """What a stream of random numbers is for; methods of other packages count from 1000."""

    TRACER = 0
    SPIKE = 1
    SPIKE_SIGN = 2
    DROPOUT = 3
    NON_FINITE = 4
    FEEDBACK = 5
    ARRIVAL = 6
    TARGET = 7
    PROBE_REPEAT = 8
    FOLLOWING = 9
    TEMPERATURE = 10
    BREAK = 11
    BREAK_SHIFT = 12
    SLIP = 13
    ARRIVAL_MOTION = 14
    PRESSURE = 15
    DRIFTING = 16
    JITTER = 17
    MOUNTING = 20
    MOUNTED_ZERO = 21
    TRACKER = 30
    STAND = 31
    NEST = 32
    REFLECTOR = 33
    MACHINE = 40
    TOUCH = 41
    BALL = 42
    DIRT = 43
    REFERENCE_MARK = 50
    REFERENCE_SETTING = 51
    REFERENCE_READING = 52


class IndexedNoise:
    """One reproducible stream of independent random numbers with random access.

    The numbers come in blocks from a counter-based generator (Philox) whose key is the seed
    and whose counter starts at (block, source).
    """

    def __init__(self, seed: int, source: int) -> None:
        self._seed, self._source = seed, source
        self._blocks: dict[tuple[str, int], Floats] = {}

    def normal(self, first: int, count: int) -> Floats:
        """Return the standard normal numbers ``first`` to ``first + count - 1``."""
        return self._slice("normal", first, count)

    def uniform(self, first: int, count: int) -> Floats:
        """Return the numbers ``first`` to ``first + count - 1``, uniform in [0, 1)."""
        return self._slice("uniform", first, count)

    def _slice(self, kind: str, first: int, count: int) -> Floats:
        begin, end = first // _BLOCK, (first + max(count, 1) - 1) // _BLOCK
        blocks = [self._block(kind, number) for number in range(begin, end + 1)]
        offset = first - begin * _BLOCK
        whole = blocks[0] if len(blocks) == 1 else np.concatenate(blocks)
        return whole[offset : offset + count]

    def _block(self, kind: str, number: int) -> Floats:
        known = self._blocks.get((kind, number))
        if known is not None:
            return known
        philox = np.random.Philox(key=[self._seed, 0], counter=[0, number, self._source, 0])
        generator = np.random.Generator(philox)
        draw: Callable[[int], Floats] = (
            generator.standard_normal if kind == "normal" else generator.random
        )
        if len(self._blocks) >= 4:
            self._blocks.pop(next(iter(self._blocks)))
        self._blocks[kind, number] = block = draw(_BLOCK)
        block.setflags(write=False)
        return block
