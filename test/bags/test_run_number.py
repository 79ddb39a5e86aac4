"""Which run a file says that it is of; whatever else stands there is none."""

import pytest

from rotcal_ros.bags import names
from rotcal_ros.bags.names import run_number


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        ("0", 0),
        ("12", 12),
        ("999999999", 999_999_999),
        ("9" * 5000, 7),
        ("\u00b2", 7),
        ("-1", 7),
        ("", 7),
    ],
)
def test_only_a_number_of_a_recorder_counts(number, expected):
    assert run_number({names.RUN: {"number": number}}, 7) == expected


def test_where_nothing_is_said_it_is_the_first():
    assert run_number({}) == 0
