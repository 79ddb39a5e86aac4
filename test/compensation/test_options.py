"""Settings of a controller as people write them."""

import pytest

from rotcal_ros.compensation.controllers import parse_options, parse_revolutions
from rotcal_ros.foundation.errors import ConfigurationError


def test_values_are_what_they_look_like():
    texts = ["turns=3", " unit = 0.5 ", "backlash=difference", "adds=false", "name=a=b"]
    assert parse_options(texts) == {
        "turns": 3,
        "unit": 0.5,
        "backlash": "difference",
        "adds": False,
        "name": "a=b",
    }


@pytest.mark.parametrize(
    ("texts", "why"),
    [
        (["turns"], "'turns': expected NAME=VALUE"),
        (["=3"], "'=3': expected NAME=VALUE"),
        (["turns=3", " turns=4"], "'turns' is given twice"),
        (["turns=["], "not valid YAML"),
    ],
)
def test_other_texts_are_refused(texts, why):
    with pytest.raises(ConfigurationError, match=why):
        parse_options(texts)


@pytest.mark.parametrize(
    ("text", "first", "turns"), [("-1:2", -1, 3), (" 0:1 ", 0, 1), ("+2:+9999", 2, 9997)]
)
def test_revolutions(text, first, turns):
    assert parse_revolutions(text) == {"first_turn": first, "turns": turns}


@pytest.mark.parametrize("text", ["", "3", "1:1", "2:-1", "a:b", "0:10000", "0:1:2", "0 : 1"])
def test_other_revolutions_are_refused(text):
    with pytest.raises(ConfigurationError, match="expected FIRST:LAST with LAST above FIRST"):
        parse_revolutions(text)
