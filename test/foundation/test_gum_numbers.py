"""The examples of JCGM 100:2008, 7.2.6, and what rounding does at the edges."""

import numpy as np
import pytest

from rotcal_ros.foundation import gum_numbers
from rotcal_ros.foundation.gum_numbers import value_with_uncertainty


@pytest.mark.parametrize(
    ("number", "expanded", "shown"),
    [
        (100.02147, 0.00079, "+100.02147 ± 0.00079"),  # JCGM 100, 7.2.4
        (10.05762, 0.027, "+10.058 ± 0.027"),  # 7.2.6: 10,057 62 ohm with 27 mohm
        (6.6, 0.8, "+6.60 ± 0.80"),
        (6.6, 0.0996, "+6.60 ± 0.10"),
        (6.6, 9.96, "+7 ± 10"),
        (1234.5, 456.0, "+1230 ± 460"),
        (-0.004, 0.12, "0.00 ± 0.12"),
        (2.5e-9, 1.04e-9, "+0.0000000025 ± 0.0000000010"),
        (0.0, 0.0, "0"),
        (0.25, 0.0, "+0.25"),
    ],
)
def test_two_digits_of_u_and_the_value_to_the_same_place(number, expanded, shown):
    assert value_with_uncertainty(number, expanded) == shown


def test_every_size_has_two_significant_digits_and_is_within_half_of_the_last_one():
    for expanded in np.geomspace(1e-6, 1e6, 997).tolist():
        text = gum_numbers.uncertainty(expanded)
        digits = text.replace(".", "").strip("0") if expanded >= 10 else text.split(".")[1]
        assert len(digits.lstrip("0")) <= 2, (expanded, text)
        place = gum_numbers.last_digit_place(expanded)
        assert abs(float(text) - expanded) <= 0.5000001 * 10.0**place
        assert 10.0 ** (place + 1) <= float(text) * 1.0000001


def test_a_half_is_rounded_up_and_numpy_numbers_are_numbers():
    assert gum_numbers.uncertainty(np.float64(0.125)) == "0.13"
    assert gum_numbers.value(np.float64(-1.5), 2.0) == "-1.5"
