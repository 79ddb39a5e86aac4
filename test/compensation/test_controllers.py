"""Every writer: what it wrote, read back and applied by the control's rule, removes the error.

The round trip is checked against the deviation curve itself, on angles the writer never saw.
"""

from datetime import datetime, timezone

import numpy as np
import pytest
from chances import LONG
from compensation_examples import TAU, even, result_of, wavy
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from rotcal_ros.compensation.controllers import controller_names, make_controller
from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.compensation.writing import without_provenance
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC, DEGREE

NOW = datetime(2026, 1, 2, 3, 4, 5, tzinfo=timezone.utc)
UP, DOWN = Approach.POSITIVE, Approach.NEGATIVE

VARIANTS = {
    "linuxcnc type 1": ("linuxcnc", {"turns": 2, "first_turn": -1}),
    "linuxcnc type 0": ("linuxcnc", {"file_type": 0, "turns": 3}),
    "csv": ("csv", {}),
}


def export(table, name, spacing=None, **more):
    return prepare_export(table, name, now=NOW, spacing=spacing, accept_unverified=True, **more)


# The round trip.


@st.composite
def deviation_curves(draw):
    """Amplitudes (order, arcsec, phase) of a forward curve and of the reversal."""
    phase = st.floats(0.0, 6.28)
    terms = draw(
        st.lists(st.tuples(st.integers(1, 4), st.floats(2.0, 25.0), phase), min_size=1, max_size=3)
    )
    reversal = draw(st.tuples(st.floats(-3.0, 3.0), st.floats(0.0, 2.0), phase))
    return terms, reversal


MEASURED = {
    "curve": deviation_curves(),
    "rows": st.sampled_from([36, 40, 72, 80]),
    "reference": st.floats(0.0, 6.28),
    "seed": st.integers(0, 2**32 - 1),
}
EXAMPLES = settings(max_examples=30 if LONG else 2, deadline=None)


def assert_error_removed(name, values, curve, rows, reference, seed, halves=True):
    """What is left is below the stated residual, and ``halves`` the deviation at least."""
    terms, (offset, size, phase) = curve

    def up(t):
        return wavy(t, terms)

    def down(t):
        return up(t) + offset * ARCSEC + wavy(t, [(2, size, phase)])

    angles = even(180)
    table = table_from_result(
        result_of(angles, up(angles)),
        reverse=result_of(angles, down(angles)),
        reference_angle=reference,
    )
    assume(np.max(np.abs(table.correction_forward)) > 5.0 * ARCSEC)
    done = export(table, name, TAU / rows, settings=values)
    rule = make_controller(name, values).read(done.files)
    low, high = make_controller(name, values).travel
    command = np.random.default_rng(seed).uniform(low, high, 2000)
    command = np.append(command, [0.0, TAU, high, low, reference])
    for approach, deviation in ((UP, up), (DOWN, down)):
        added = rule.correction(command, approach)
        moved = command + added
        left = added + deviation(moved) - up(reference)
        # The spline through points two degrees apart follows these curves to 3e-5 arcsec.
        assert np.max(np.abs(left)) <= done.residual.stated + 1e-4 * ARCSEC
        before = deviation(command) - up(reference)
        assert np.max(np.abs(left)) < np.max(np.abs(before)) + 4.0 * ARCSEC
        # Never twice the deviation: the correction opposes the error.
        if halves:
            assert np.sum(left**2) < 0.5 * np.sum((deviation(command) - up(reference)) ** 2) + (
                len(command) * done.residual.direction**2
            )


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS)
@EXAMPLES
@given(**MEASURED)
def test_what_is_left_is_below_the_stated_residual(variant, **measured):
    assert_error_removed(*VARIANTS[variant], **measured)


def test_second_order_is_simulated_and_stated():
    """e = A sin t: commanded t, moved by -e(t), left is e'(t) e(t), at most A^2 / 2."""
    amplitude = 0.01
    angles = even(360)
    done = export(table_from_result(result_of(angles, amplitude * np.sin(angles))), "csv")
    assert done.residual.simulated == pytest.approx(amplitude**2 / 2, rel=0.02)
    assert done.residual.second_order == pytest.approx(amplitude**2, rel=0.05)


def assert_rounding(name, value_arcsec, angle_arcsec):
    """Angles are rounded too: that many arcsec times the steepest slope of the curve."""
    angles = even(36)
    table = table_from_result(result_of(angles, wavy(angles)))
    done = export(table, name, spacing=TAU / 36)  # the measured angles
    rounding = done.residual.rounding / ARCSEC
    fine = even(36_000)
    slope = np.max(np.abs(np.diff(wavy(fine)))) / (fine[1] - fine[0])
    expected = value_arcsec + slope * angle_arcsec
    # the spline through 36 rows and the margin of the sampling: the slope to a few percent
    allowed = 0.05 * slope * angle_arcsec + 1e-12
    assert rounding == pytest.approx(expected, rel=0, abs=allowed)
    written = make_controller(name).read(done.files).correction(angles, UP)
    off = np.max(np.abs(written - table.correction_forward)) / ARCSEC
    assert 0.2 * rounding < off <= rounding * (1.0 + 1e-9)


def test_rounding_is_half_a_step_and_what_the_angle_moves():
    assert_rounding("csv", 0.5e-6, 3.6e-6)


@pytest.mark.parametrize("name", controller_names())
def test_a_turned_sign_does_not_pass(name, monkeypatch):
    """The proof before writing catches a reader and rule that turn what was written."""
    angles = even(36)
    table = table_from_result(result_of(angles, wavy(angles)))
    kind = type(make_controller(name))
    read = kind.read

    class Turned:
        def __init__(self, rule):
            self.rule = rule

        def correction(self, angle, approach):
            return -self.rule.correction(angle, approach)

    monkeypatch.setattr(kind, "read", lambda *given: Turned(read(*given)))
    with pytest.raises(DataError, match="by the control's rule, the file leaves"):
        export(table, name)


SPACINGS_DEG = [7.0, 13.3, 50.0]
"""They do not divide the turn."""


def assert_spacing_taken(name, spacing_deg, even_only=False):
    """The rows are written, or refused by a control that takes ``even_only``."""
    angles = even(72)
    table = table_from_result(result_of(angles, wavy(angles, [(1, 20.0, 0.4)])))
    spacing = spacing_deg * DEGREE
    if even_only:
        with pytest.raises(ConfigurationError, match="divides 360"):
            export(table, name, spacing)
        return
    done = export(table, name, spacing)
    rule = make_controller(name).read(done.files)
    command = np.linspace(0.0, TAU, 1441)
    left = rule.correction(command, UP) + wavy(command, [(1, 20.0, 0.4)])
    left = left - wavy(0.0, [(1, 20.0, 0.4)])
    assert np.max(np.abs(left)) <= done.residual.stated + 1e-4 * ARCSEC


@pytest.mark.parametrize("name", ["csv", "linuxcnc"])
@pytest.mark.parametrize("spacing_deg", SPACINGS_DEG)
def test_spacings_that_do_not_divide_the_turn(name, spacing_deg):
    assert_spacing_taken(name, spacing_deg)


@pytest.mark.parametrize("name", controller_names())
def test_files_are_named_as_the_controller_declares(name):
    angles = even(36)
    files = export(table_from_result(result_of(angles, wavy(angles))), name, TAU / 36).files
    own = [f"c_{name}{suffix}" for suffix in make_controller(name).suffixes]
    assert own == list(without_provenance(files))


@pytest.mark.parametrize("name", controller_names())
def test_wrap_has_no_jump(name):
    angles = even(36)
    table = table_from_result(result_of(angles, wavy(angles)))
    done = export(table, name, TAU / 36)
    rule = make_controller(name).read(done.files)
    for approach in (UP, DOWN):
        ends = rule.correction(np.array([0.0, TAU - 1e-9, TAU]), approach)
        assert np.ptp(ends) < max(1e-3 * ARCSEC, make_controller(name).resolution(table) / 2.0)


@pytest.mark.parametrize("name", ["linuxcnc", "csv"])
def test_an_arc_goes_to_those_that_hold_the_ends(name):
    angles = np.deg2rad(np.arange(-90, 91, 10))
    table = table_from_result(result_of(angles, wavy(angles)), reference_angle=0.0)
    done = export(table, name)
    rule = make_controller(name).read(done.files)
    left = rule.correction(angles, UP) + wavy(angles) - wavy(0.0)
    assert np.max(np.abs(left)) <= done.residual.stated
    with pytest.raises(ConfigurationError, match="arc cannot be repeated"):
        export(table, "linuxcnc", settings={"turns": 2})
