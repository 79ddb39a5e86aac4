"""What a method provides, so that nodes, replay and report need not know which one it is."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeAlias

from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import ConfigurationError

if TYPE_CHECKING:
    import numpy as np

    from rotcal_ros.adjust.model import CurveModel
    from rotcal_ros.capture.attempt import CaptureRules
    from rotcal_ros.capture.unordered import UnorderedStreams
    from rotcal_ros.foundation.arrays import Floats
    from rotcal_ros.foundation.observations import Observation
    from rotcal_ros.foundation.results import Result
    from rotcal_ros.foundation.table_reading import Reading
    from rotcal_ros.foundation.tables import Header, Table
    from rotcal_ros.methods.configuration import Configuration
    from rotcal_ros.methods.continuation import Continuation
    from rotcal_ros.methods.disturbance import Disturbances
    from rotcal_ros.methods.figures import Figure
    from rotcal_ros.methods.measurements import PlannedMeasurements
    from rotcal_ros.methods.result_tables import ResultTable
    from rotcal_ros.methods.simulation.cell import SimulatedCell
    from rotcal_ros.methods.simulation.instrument import MakeInstrument
    from rotcal_ros.methods.simulation.settings import SimulationSettings
    from rotcal_ros.planning.choices import StepPolicy
    from rotcal_ros.planning.plan import Plan, PlanComparison, Point, Step

Trials: TypeAlias = "Callable[[np.random.Generator, int], Floats]"
"""``trials(rng, count)`` draws measurements, solves them and returns (count, outputs)."""
Curves: TypeAlias = "Mapping[str, Floats]"
Observed: TypeAlias = "Sequence[Observation]"
Adaptive: TypeAlias = "Callable[[Continuation], StepPolicy]"
"""Makes a policy that chooses what a continuation leaves."""
See: TypeAlias = "Callable[[Step], tuple[float, ...]]"
"""What an instrument without error sees at a step."""


@dataclass(frozen=True)
class PlanFile:
    """A file whose content is the list ``setting`` of the group ``plan``; ``read`` reads it."""

    setting: str
    read: Callable[[Path], Sequence[float] | Sequence[int]]


@dataclass(frozen=True, slots=True)
class Stations:
    """Nominal places (m) of an instrument, by the number of the station; empty: not known.

    ``carried``: it rides on the table, and the places are those at angle 0 in the table frame.
    Otherwise it stands still, in the machine frame.
    """

    places: tuple[Point, ...] = ()
    carried: bool = False


class Measurements(Protocol):
    """What was measured, ready to be solved; ``sha256`` maps file names to hashes."""

    @property
    def configuration(self) -> Configuration:
        """What it is solved with."""

    @property
    def sha256(self) -> Mapping[str, str]:
        """Hashes of the files by their names."""

    def solve(self) -> Result:
        """Return the result."""

    def model_of_curves(self) -> CurveModel | None:
        """Return it as a model, to be solved with others; None: the result stands for it."""

    def trials(self) -> Trials:
        """Prepare Monte Carlo trials about it; ConfigurationError where there are none."""


@dataclass(frozen=True)
class TableReader:
    """Reads plain tables with one of ``headers``, the present one first.

    ``read`` takes the configuration, the table and that of targets, if any, and returns what was
    measured; DataError names file and row of what cannot be. ``columns`` are those of numbers from
    0, each with the field of a :class:`~.planning.plan.Step` that it holds. ``targets`` is the
    header of a table of targets; empty where there is none. ``runs`` is the setting of the plan
    that counts how often it goes through the table angles; empty: once only. A plan that does so
    again, or in both directions, has the settings ``again`` too. Tables with one of the headers
    ``with_angles`` state the table angles themselves. ``require`` raises a question where a table
    that was read leaves something open. Tables that state everything ``needs_setup`` not.
    """

    headers: tuple[Header, ...]
    read: Callable[[Configuration, Table, Table | None], Measurements]
    columns: Mapping[str, str]
    targets: Header = ()
    runs: str = ""
    again: Mapping[str, str] = field(default_factory=dict)
    with_angles: tuple[Header, ...] = ()
    require: Callable[[Reading], object] = bool
    needs_setup: bool = True


DEFAULT: Final = "tracer_multistation"
"""The method of a node or a simulation for which none was chosen."""


def counted_from_the_first(_angles: Floats, deviations: Curves) -> dict[str, Floats]:
    """Return the deviations (n,) by component, ECC counted from its first value."""
    return {
        name: values - values[0] if name == "ECC" else values
        for name, values in deviations.items()
    }


def zero_at_the_first(_result: Result) -> tuple[str, ...]:
    """Return what the curves count from, for a method that counts from its first angle."""
    return ("ECC counts from the first angle and is 0 there by definition.",)


@dataclass(frozen=True)
class Method:
    """What a method provides. Everything lies in one package, named by an entry point.

    ``name`` is that of configurations and results, ``title`` is for people, ``page`` the name of
    its page in the documentation. ``plan_settings``, ``solver_settings`` and
    ``simulation_settings`` are its own groups ``plan``, ``solver`` and ``simulation``.
    ``by_light``: its lengths are measured by light, which the air bends and slows.

    ``plan`` builds the plan from a configuration and refuses settings that cannot work;
    ``capture`` says how the streams become observations of its steps; ``solve`` turns a
    configuration, its plan and accepted observations into a result. ``simulated_instrument`` makes
    the instrument of a simulated cell, ``nominal`` computes what one without error would see,
    ``stations`` where the instruments stand.

    ``gauge`` takes from true deviations (n,) at angles (n,) what the method cannot see, so that
    they can be compared with a result. A method whose values are relative to a zero that an
    interruption changes ``joins_runs``: it gets the accepted observations of all runs of a
    plan, not only the last one of each step.

    ``adaptive`` prepares the policy that measures until a goal is reached; ConfigurationError or
    PlanError where it cannot be. ``compare`` says what is known in advance of steps of the plan
    in their order, some of which gave no length, and of the plan that the method is known by.

    ``check_plan`` raises PlanError for a plan whose data could never be solved, before anything is
    measured. ``plan_files`` are files that stand for lists of the group ``plan``, by the settings
    that name them.

    ``model_of_curves`` returns accepted observations as the model of a solution with other
    instruments; without it, or for None, the result stands for them.

    ``of_turns`` takes a configuration, lengths and angles of a table that turned without orders,
    and the name of their source, and returns what was measured; without it they are not read.

    ``trials`` prepares Monte Carlo trials about accepted observations: their outputs are the
    deviations of the result, component by component in the order of ``COMPONENTS``. ``check``
    says in words what the observations so far show about a person's work (see
    :class:`~rotcal_ros.planning.plan.Pause`), or raises DataError. ``table`` reads plain tables,
    ``short_setup`` turns the entries of a short set-up into settings of plan and solver, by the
    last word of their names. ``figures`` draws what the method alone can show, ``tables`` lists
    it, ``zero`` says in words what the curves count from and how a whole turn closes.
    ``disturbances`` measure a plan with its noise and with what may spoil it. ``set_by_hand``:
    what may be numbered wrong is what a person sets, which no feedback of the table shows.
    ``one_more`` returns the configuration whose plan has what helps most added, and what that is.
    """

    name: str
    title: str
    page: str
    plan_settings: type[Any]
    solver_settings: type[Any]
    plan: Callable[[Configuration], Plan]
    capture: CaptureRules
    solve: Callable[[Configuration, Plan, Observed], Result]
    simulation_settings: type[SimulationSettings]
    simulated_instrument: MakeInstrument
    by_light: bool = False
    nominal: Callable[[Configuration, Plan], See] | None = None
    stations: Callable[[Configuration], Stations] | None = None
    gauge: Callable[[Floats, Curves], dict[str, Floats]] = counted_from_the_first
    joins_runs: bool = False
    model_of_curves: Callable[[Configuration, Plan, Observed], CurveModel | None] | None = None
    trials: Callable[[Configuration, Plan, Observed], Trials] | None = None
    check: Callable[[Configuration, Plan, Observed], tuple[str, ...]] | None = None
    adaptive: Callable[[Configuration, Plan], Adaptive] | None = None
    compare: (
        Callable[[Configuration, Plan, Sequence[int], Collection[int]], PlanComparison] | None
    ) = None
    check_plan: Callable[[Configuration, Plan], None] | None = None
    plan_files: Mapping[str, PlanFile] = field(default_factory=dict)
    table: TableReader | None = None
    of_turns: Callable[[Configuration, UnorderedStreams, str], PlannedMeasurements] | None = None
    short_setup: Callable[[Mapping[str, Any]], Mapping[str, Any]] = dict
    figures: Callable[[Result, Mapping[str, Any] | None], Sequence[Figure]] = (
        lambda _result, _truth: ()
    )
    tables: Callable[[Result], Sequence[ResultTable]] = lambda _result: ()
    zero: Callable[[Result], Sequence[str]] = zero_at_the_first
    disturbances: Disturbances | None = None
    set_by_hand: bool = False
    one_more: Callable[[Configuration], tuple[str, Configuration] | None] | None = None

    @property
    def own_settings(self) -> Mapping[str, type[Any]]:
        """Its own groups of settings."""
        return {
            "plan": self.plan_settings,
            "solver": self.solver_settings,
            "simulation": self.simulation_settings,
        }

    def simulated_cell(self, settings: SimulationSettings, start_ns: int = 0) -> SimulatedCell:
        """Return a simulated cell with its instrument, whose time begins at ``start_ns``."""
        from rotcal_ros.methods.simulation.cell import SimulatedCell

        return SimulatedCell(settings, self.simulated_instrument, start_ns)

    def __reduce__(self) -> tuple[Callable[[str], Method], tuple[str]]:
        """Travel to other processes by name."""
        return find_method, (self.name,)


def method_names() -> tuple[str, ...]:
    """Return the names of all methods that are installed.

    >>> import rotcal_ros as rc
    >>> "ball_plate" in rc.method_names()
    True
    """
    return plugins.names(plugins.METHODS)


def find_method(name: str) -> Method:
    """Return the method ``name``; ConfigurationError, with the nearest name, if there is none."""
    method: Method = plugins.load(plugins.METHODS, name, "method")
    return method


def usable_methods() -> Iterator[Method]:
    """Yield all methods that are installed, but for those of other packages that do not load.

    Who asks for one of these by its name is told why.
    """
    for name in method_names():
        with suppress(ConfigurationError):
            yield find_method(name)


def own_settings(name: str) -> Mapping[str, type[Any]]:
    """Return the groups of settings of the method ``name``, which is loaded only if need be.

    Raises ConfigurationError, with the nearest name, when there is no such method.
    """
    if name not in plugins.names(plugins.METHOD_SETTINGS):
        return find_method(name).own_settings
    settings: Mapping[str, type[Any]] = plugins.load(plugins.METHOD_SETTINGS, name, "method")
    return settings
