"""A dropout names the steps whose windows it touches, in words and for machines."""

from types import SimpleNamespace

import pytest

from rotcal_ros.bags.dropouts import GAP, Dropout
from rotcal_ros.recordings.missing_data import Window, placed, sentences

SECOND = 10**9


def windows(*accepted):
    """Return windows of half a second, one beginning at each second."""
    return [
        Window(step, step * SECOND, step * SECOND + SECOND // 2)
        for step, good in enumerate(accepted)
        if good
    ]


def file(*spans):
    return SimpleNamespace(
        dropouts=tuple(
            Dropout("/cell/a", int(begin * SECOND), int(end * SECOND), 1, GAP)
            for begin, end in spans
        )
    )


@pytest.mark.parametrize(
    ("span", "steps"),
    [((0.6, 0.9), ()), ((0.4, 0.45), (0,)), ((0.5, 1.0), (0, 1)), ((1.2, 9.0), (1, 3)),
     ((2.1, 2.2), ())],
)  # fmt: skip
def test_the_steps_are_those_of_accepted_windows(span, steps):
    (found,) = placed([file(span)], windows(True, True, False, True))
    assert found.steps == steps
    assert found.to_dict()["steps"] == list(steps)


def test_dropouts_of_all_files_come_in_the_order_of_time():
    found = placed([file((3.0, 3.1)), file((1.0, 1.1), (2.0, 2.1))], ())
    assert [f.dropout.from_ns // SECOND for f in found] == [1, 2, 3]


def test_words_name_few_steps_and_say_how_many_dropouts_there_are():
    everything = placed([file((0, 99))], windows(*[True] * 7))
    assert sentences(everything)[0].endswith(f"{GAP}; steps 0 to 6, 7 in all")
    (one,) = sentences(placed([file((2.0, 2.1))], windows(*[True] * 7)))
    assert one.endswith("; step 2")
    many = placed([file(*((n, n) for n in range(25)))], ())
    assert sentences(many)[-1] == "and 5 more dropouts"
