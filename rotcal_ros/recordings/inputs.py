"""The input of a verb: a bag or a plain table, its set-up and changes, read in one place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from rotcal_ros.bags.reader import Progress, bag_files
from rotcal_ros.bags.settings import ReadingLimits, changed_limits, is_limit
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.tables import is_table
from rotcal_ros.methods.configuration import (
    OFFLINE_GROUPS,
    Configuration,
    changed,
    read_configuration,
)
from rotcal_ros.methods.method import Measurements
from rotcal_ros.recordings.recorded_setup import find_configuration
from rotcal_ros.recordings.replay import Recording, Source, read_recording
from rotcal_ros.recordings.topics import Topics, read_single_cell

if TYPE_CHECKING:
    from rotcal_ros.foundation.table_reading import Reading


@dataclass(frozen=True)
class MeasurementInput:
    """A bag or a table at ``path`` and what belongs to it.

    ``setup`` is the file of its configuration, which for a bag replaces the one in it; ``targets``
    that of a tracer's targets; ``changes`` are ``group.name=value``, for a bag
    ``reading.name=value`` too. ``taken_from`` and ``namespace`` say what part of a bag is solved.
    ``announce`` is given how a table was understood.
    """

    path: Path
    setup: Path | None = None
    targets: Path | None = None
    changes: tuple[str, ...] = ()
    taken_from: Source = "streams"
    namespace: str = ""
    announce: Callable[[Reading], object] = field(default=str, compare=False)

    @property
    def is_bare_path(self) -> bool:
        """Whether there is a path and nothing else."""
        return self == MeasurementInput(self.path)

    def read(self, progress: Progress | None = None) -> Recording | Measurements:
        """Return what was measured, ready to be solved.

        Raises BagError for a path that is neither a bag nor a table, ConfigurationError for a
        table that needs a set-up and has none, and for impossible changes, DataError for
        contradictory content.
        """
        of_reading = tuple(change for change in self.changes if is_limit(change))
        if is_table(self.path):
            if of_reading:
                raise ConfigurationError(
                    f"--set {of_reading[0]}: {self.path} is not a bag; leave it out"
                )
            from rotcal_ros.methods.fitting import setup_of_its_own
            from rotcal_ros.methods.measurements import read_measurements

            stated = (
                setup_of_its_own(self.path, self.changes)
                if self.setup is None
                else changed(read_configuration(self.setup), self.changes)
            )
            return read_measurements(self.path, stated, self.targets, self.announce)
        if self.targets is not None:
            raise ConfigurationError(
                f"{self.path} is not a table: only a table takes --targets; leave it out"
            )
        limits = changed_limits(of_reading)
        changes = tuple(change for change in self.changes if change not in of_reading)
        configuration = self._configuration(changes, limits)
        return read_recording(
            self.path,
            self.taken_from,
            configuration=configuration,
            topics=Topics(self.namespace, self._asked_names(configuration, changes)),
            progress=progress,
            limits=limits,
        )

    def _asked_names(
        self, configuration: Configuration | None, changes: tuple[str, ...]
    ) -> dict[str, str]:
        """Return the names of topics that are given here instead of in the bag."""
        known = {} if configuration is None else configuration.topics.renamed()
        changed_ones = {change.partition("=")[0] for change in changes}
        return {r: n for r, n in known.items() if self.setup or f"topics.{r}" in changed_ones}

    def _configuration(
        self, changes: tuple[str, ...], limits: ReadingLimits
    ) -> Configuration | None:
        """Return the configuration for a bag; None: the one in it, as it is."""
        if self.setup is not None:
            return changed(read_configuration(self.setup), changes)
        if not changes:
            return None
        files = bag_files(self.path)

        def found(topics: Topics) -> Configuration:
            return find_configuration(files, topics, limits)

        recorded = read_single_cell(found, Topics(self.namespace), files, limits)
        return changed(recorded, changes, OFFLINE_GROUPS)
