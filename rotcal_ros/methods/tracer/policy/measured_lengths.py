"""The lengths that a policy has got so far, and the zero that each was read from."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from functools import cached_property

import numpy as np

from rotcal_ros.foundation.arrays import Ints
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.planning.time_order import time_order


class MeasuredLengths:
    """Accepted observations of single steps, as the solver will take them.

    With a zero per station the last observation of a step counts, with a zero ``per_segment`` the
    last one of each run: a run begins a segment, and so does a beam that was broken.
    """

    def __init__(self, per_segment: bool, observations: Iterable[Observation] = ()) -> None:
        self.per_segment = per_segment
        self._kept: dict[tuple[int, int], Observation] = {}
        self._latest: tuple[int, int] | None = None
        for observation in observations:
            self.add(observation)

    def add(self, observation: Observation) -> None:
        """Take an observation in place of what it repeats."""
        self._kept[self._key(observation)] = observation
        self._latest = self._beam(observation)
        self._forget()

    def drop(self, observation: Observation) -> None:
        """Forget an observation."""
        del self._kept[self._key(observation)]
        self._forget()

    def _forget(self) -> None:
        """Have what follows from the observations worked out anew: they have changed."""
        for name in ("observations", "beams"):
            self.__dict__.pop(name, None)

    @cached_property
    def observations(self) -> tuple[Observation, ...]:
        """All that count, in an order that does not depend on when they came."""
        return tuple(self._kept[key] for key in sorted(self._kept))

    def time_order(self) -> Ints:
        """Return the rank (k,) in time of each of the ``observations``."""
        return time_order(self.observations)

    @property
    def steps(self) -> set[int]:
        """The steps that were measured."""
        return {step for _, step in self._kept}

    def __contains__(self, step: int) -> bool:
        return step in self.steps

    def last_of(self, step: int) -> Observation | None:
        """Return the last observation of a step, None without any."""
        own = [key for key in self._kept if key[1] == step]
        return self._kept[max(own)] if own else None

    def only(self, steps: Collection[int]) -> MeasuredLengths:
        """Return what was measured of ``steps``."""
        return MeasuredLengths(self.per_segment, (o for o in self.observations if o.step in steps))

    @cached_property
    def beams(self) -> tuple[tuple[int, int], ...]:
        """Run and segment of every unbroken beam, the one that is read now among them."""
        every = {self._beam(o) for o in self._kept.values()} | {self._latest or (0, 0)}
        return tuple(sorted(every))

    def segments(self) -> Ints:
        """Return the place among ``beams`` of the one that each observation (k,) was read from."""
        number = {beam: place for place, beam in enumerate(self.beams)}
        return np.array([number[self._beam(o)] for o in self.observations], dtype=np.int64)

    @property
    def segment_now(self) -> int:
        """The place among ``beams`` of the one that further lengths will be read from."""
        return self.beams.index(self._latest or (0, 0))

    def of_one_zero(self, a: Observation, b: Observation) -> bool:
        """Tell whether both count from the same zero, being of one step."""
        return not self.per_segment or self._beam(a) == self._beam(b)

    def _key(self, observation: Observation) -> tuple[int, int]:
        return (observation.run if self.per_segment else 0, observation.step)

    @staticmethod
    def _beam(observation: Observation) -> tuple[int, int]:
        return observation.run, observation.segment
