"""Is it true, and how sure is it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

from rotcal_ros.api.reading import Frame, Name
from rotcal_ros.evaluation.combination import CombinationInput
from rotcal_ros.evaluation.compare import Comparison
from rotcal_ros.evaluation.compare import compare as compare_curves
from rotcal_ros.evaluation.component_groups import Enlargement
from rotcal_ros.evaluation.iso230 import BidirectionalRuns, Iso230, require_runs
from rotcal_ros.evaluation.iso230 import iso230 as evaluate_runs
from rotcal_ros.evaluation.joint import JointInput
from rotcal_ros.evaluation.joint import combine as combine_measured
from rotcal_ros.evaluation.joint import solve_together as solve_instruments
from rotcal_ros.evaluation.monte_carlo import PropagatedResult, propagate_measurement
from rotcal_ros.evaluation.quick_check import QuickCheck, quick_check
from rotcal_ros.evaluation.reference import read_deviations
from rotcal_ros.foundation.components import unit_of
from rotcal_ros.foundation.curves.measured import MeasuredCurve, measured_curve
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.tables import Table, as_path_or_table
from rotcal_ros.methods.calibration import prepare_whole
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.measurements import PlannedMeasurements
from rotcal_ros.methods.method import Measurements
from rotcal_ros.planning.check_rule import RISK, CheckRule
from rotcal_ros.recordings.inputs import MeasurementInput
from rotcal_ros.recordings.replay import Recording
from rotcal_ros.recordings.result_sources import (
    ResultSource,
    joint_input,
    read_curve,
    read_instrument,
    read_measured,
    read_repeated_runs,
)

Curve: TypeAlias = "Result | MeasuredCurve | Name | Frame"
"""``Frame``: deviations over angles, as those of ``to_dataframe()``."""


def compare(
    first: Curve, second: Curve, component: str = "ECC", *, align_order: int = 0
) -> Comparison:
    """Compare two independent measurements of one table within their stated uncertainties.

    Each is a result, its file, a bag, or a reference table: a file or a DataFrame. The offset that
    no method can know is removed, and ``align_order`` harmonics. ``difference`` (n,) = first -
    second, m or rad; ``normalised_error`` is E_n with k = 2; ``agree`` is the verdict. Raises
    DataError for an absent component and for too few common angles.

    >>> import rotcal_ros as rc
    >>> folder = "examples/data"
    >>> compared = rc.compare(f"{folder}/result_tracer.json", f"{folder}/result_ball_plate.json")
    >>> compared.agree, compared.dof
    (True, 11)
    """
    return compare_curves(_curve(first, component), _curve(second, component), align_order)


def check(
    earlier: Curve,
    new: Curve,
    component: str = "ECC",
    *,
    within: float,
    ageing_std: float = 0.0,
    miss: float = RISK,
    false_alarm: float = RISK,
    align_order: int = 0,
) -> QuickCheck:
    """Judge from a new measurement whether an earlier curve is still within a limit of the table.

    Each is a result, its file, a bag, or a reference table or DataFrame.
    ``within`` and ``ageing_std``, the usual change since then of each angle (k = 1), in rad or m.
    ``verdict`` is "still valid", "changed" or "undecided"; ``miss`` and ``false_alarm`` are the
    risks that the first two are wrong, see docs/quick_check.md. Raises DataError for a result
    that failed or a new one without uncertainty, ConfigurationError for impossible risks.

    >>> import rotcal_ros as rc
    >>> folder = "examples/data"
    >>> curves = (f"{folder}/result_ball_plate.json", f"{folder}/result_tracer.json")
    >>> rc.check(*curves, within=3 * rc.ARCSEC).verdict
    'still valid'
    >>> rc.check(*curves, within=0.1 * rc.ARCSEC).verdict
    'undecided'
    """
    unit, label = unit_of(component)
    rule = CheckRule(within, miss, false_alarm, ageing_std)
    curves = _curve(earlier, component), _curve(new, component)
    return quick_check(*curves, rule, align_order, unit, label)


def combine(*results: Curve, enlarge: Enlargement = "birge") -> Result:
    """Return the best estimate of one table's deviations from independent measurements.

    Each is a result, its file or session, a bag, a reference curve or its table
    or DataFrame.
    Generalised least squares with all covariances; every input has its own zero, and everything in
    the result counts from its mean. ``verdict`` is suspect if an input is or if they contradict
    each other: then ``enlarge`` ("birge", "mandel-paule", "none") says what is done to the
    uncertainties. ``details`` hold weights and chi-square. Raises DataError for a failed input,
    and for inputs without common angles that cannot be interpolated.

    >>> import rotcal_ros as rc
    >>> folder = "examples/data"
    >>> best = rc.combine(f"{folder}/result_tracer.json", f"{folder}/result_ball_plate.json")
    >>> best.method, best.verdict, best.components
    ('combination', 'ok', ('EXC', 'EYC', 'EZC', 'EAC', 'EBC', 'ECC'))
    """
    inputs = [_measured_input(k, r) for k, r in enumerate(results, 1)]
    return combine_measured(inputs, enlarge).result


def solve_together(*sources: Recording | Measurements | Result | Name) -> Result:
    """Solve what several instruments observed of one table: one curve of each deviation.

    Each is a recording, a table of :func:`read_table`, a bag, or a result or its file, which then
    stands for its observations. What cannot be solved alone is, where the others determine what
    it lacks. Everything in the result counts from its mean; ``verdict`` is suspect if an input is,
    if something was wrong with one, or if they contradict each other; ``details`` hold weights,
    chi-square and noise of each. Raises DataError for inputs that share observations, or that
    fewer than two common angles join.

    >>> import rotcal_ros as rc
    >>> plate = rc.read_bag("examples/data/ball_plate_bag")
    >>> joint = rc.solve_together(plate, "examples/data/result_tracer.json")
    >>> joint.method, joint.components
    ('combination', ('EXC', 'EYC', 'EZC', 'EAC', 'EBC', 'ECC'))
    """
    instruments = [_instrument(k, source) for k, source in enumerate(sources, 1)]
    return solve_instruments(instruments).result


def iso230(runs: BidirectionalRuns | Result | Name) -> Iso230:
    """Evaluate repeated runs from both directions after ISO 230-2.

    ``runs`` are deviations (m, n) in rad (actual - commanded), a table of angle, run, direction
    and deviation in any form, or a result, its file or a bag of a plan with runs. Every figure
    is in rad: ``accuracy`` A, ``repeatability`` R, ``reversal`` B ...; ``uncertainties`` has
    theirs under the same names. Raises DataError for runs that are not complete.

    >>> import rotcal_ros as rc
    >>> figures = rc.iso230("examples/data/runs.csv")
    >>> figures.targets.shape, figures.warnings
    ((12,), ())
    >>> figures.uncertainties["accuracy"].expanded < 0.5 * figures.accuracy
    True
    """
    if isinstance(runs, str | PathLike):
        return evaluate_runs(read_repeated_runs(Path(runs)))
    if isinstance(runs, Result):
        return evaluate_runs(require_runs(runs, f"the {runs.method} result"))
    return evaluate_runs(runs)


def uncertainty(
    source: Configuration | Recording | Measurements,
    *,
    trials: int = 10_000,
    seed: int = 1,
    digits: int = 2,
    workers: int = 1,
) -> PropagatedResult:
    """Propagate the stated noise through the solver by Monte Carlo, after JCGM 101.

    A configuration: about what its plan would see, before anything is measured. A recording or a
    table (see :func:`read_table`): about what was measured. ``components`` maps each to value,
    linear_std, mean, std, low and high (95 %), arrays (n,) in m or rad; ``warnings`` say where
    the trials contradict the solver. There are at most ``trials``; they end when the figures are
    stable to ``digits``. Raises ConfigurationError if the method has no trials.

    >>> import rotcal_ros as rc
    >>> configuration = rc.read_configuration("examples/data/ball_plate.yaml")
    >>> spread = rc.uncertainty(configuration, trials=200)
    >>> spread.components["ECC"].std.shape
    (12,)
    """
    return propagate_measurement(
        _measured(source), trials=trials, digits=digits, seed=seed, workers=workers
    )


def write_report(
    source: Recording | Measurements | Result, path: Name, truth: Mapping[str, Any] | None = None
) -> Path:
    """Write the self-contained HTML report of a recording, a table or a result; return its path.

    A recording or a table, of :func:`read_table`, is solved. ``truth`` is the content of the
    truth.json of a simulation, SI. Raises BagError when the page cannot be written, DataError when
    the source cannot be solved.

    >>> import tempfile
    >>> import rotcal_ros as rc
    >>> recording = rc.read_bag("examples/data/ball_plate_bag")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     rc.write_report(recording, folder + "/report.html").name
    'report.html'
    """
    # Figures take a second to load.
    from rotcal_ros.report.page import report_measurement, report_result

    if isinstance(source, Result):
        report_result(ResultSource(source, {}), Path(path), truth)
    else:
        report_measurement(source, Path(path), truth)
    return Path(path)


def _curve(curve: Curve, component: str) -> MeasuredCurve:
    if isinstance(curve, Result):
        return measured_curve(curve, component)
    if isinstance(curve, MeasuredCurve):
        return curve
    table = as_path_or_table(curve, "DataFrame")
    if not isinstance(table, Table):
        return read_curve(table, component)
    # What to_dataframe() returns is SI, and has columns of other components.
    ours = {"angle_rad": "angle_rad", component: "deviation_rad", f"{component}_std": "u_rad"}
    if ours.keys() <= {*table.header}:
        at = [table.header.index(name) for name in ours]
        lines = tuple((row, tuple(cells[k] for k in at)) for row, cells in table.lines)
        table = replace(table, header=tuple(ours.values()), lines=lines)
    return read_deviations(table)


def _measured_input(number: int, source: Curve) -> CombinationInput:
    if isinstance(source, str | PathLike):
        return read_measured(Path(source))
    if isinstance(source, Result):
        return CombinationInput.of(f"{source.method} ({number})", source)
    return CombinationInput.of(f"reference ({number})", _curve(source, "ECC"))


def _instrument(number: int, source: Recording | Measurements | Result | Name) -> JointInput:
    if isinstance(source, str | PathLike):
        return read_instrument(MeasurementInput(Path(source)))
    if isinstance(source, Result):
        return JointInput(f"{source.method} ({number})", source)
    return joint_input(f"{source.configuration.method.name} ({number})", source)


def _measured(source: Configuration | Recording | Measurements) -> Measurements:
    """Return what was measured, or for a configuration the nominal observations of its plan."""
    if isinstance(source, Configuration):
        calibration = prepare_whole(source).of_distances
        return PlannedMeasurements(calibration, calibration.nominal_observations())
    if isinstance(source, Recording):
        return PlannedMeasurements(source.calibration, source.observations, source.sha256)
    return source
