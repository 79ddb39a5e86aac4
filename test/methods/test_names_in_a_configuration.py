"""Names of the axis, the cell and its topics are those that controllers and ROS can bear."""

import pytest

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.methods import parse_configuration
from rotcal_ros.methods.configuration import dump_configuration


def parsed(group, name, value):
    text = dump_configuration("tracer_multistation", {group: {name: value}})
    return getattr(getattr(parse_configuration(text), group), name)


@pytest.mark.parametrize(
    ("group", "name", "value"),
    [
        *(("cell", "axis", bad) for bad in ("c", "..", "", "C 1", "1C", "C/D")),
        *(
            (group, name, bad)
            for group, name in (("cell", "namespace"), ("topics", "tracer_length"))
            for bad in (
                "/bad name",
                "9cell",
                "/a/9",
                "/a//b",
                "/a/",
                "/",
                "~/a",
                "/{node}",
                "/a\n",
            )
        ),
        *(("topics", name, "/x y") for name in ("probe_point", "joint_states", "temperature")),
    ],
)
def test_a_name_that_cannot_be_is_refused_with_its_place(group, name, value):
    with pytest.raises(ConfigurationError, match=rf"configuration: {group}: {name}"):
        parsed(group, name, value)


@pytest.mark.parametrize(
    ("group", "name", "value"),
    [
        ("cell", "axis", "C1"),
        ("cell", "axis", "ROT_B"),
        ("cell", "namespace", "/hall_2/cell7"),
        ("cell", "namespace", "cell"),
        ("topics", "tracer_length", "/etalon/distance_mm"),
        ("topics", "tracer_length", ""),
    ],
)
def test_other_names_are_taken(group, name, value):
    assert parsed(group, name, value) == value
