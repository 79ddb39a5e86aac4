"""The page of refusals says what the errors say, and each of its cures can be found there."""

import re
import runpy
from pathlib import Path

import pytest

import rotcal_ros as rc
from rotcal_ros.bags.settings import TopicSettings
from rotcal_ros.planning.settings import TableAdapterSettings

ROOT = Path(__file__).parents[1]
SCRIPT = runpy.run_path(str(ROOT / "scripts" / "troubleshooting.py"))
SOURCE = """
LEAST: Final = 3

def f(path, found):
    if path:
        raise BagError(f"{path.name} exists: {found.kind!r}; name another file with -o")
    if found:
        error = PlanError(f"{found} angles, a circle takes {LEAST}: " "raise table_positions")
        raise error
    raise ValueError("of no matter: leave it")
    raise DataError("only a fact, without any advice")
    raise DataError(first if path else f"{self.error}. Set `a | b`, then go on" + more)
"""


@pytest.fixture(scope="module")
def page():
    return SCRIPT["page"]()


def test_what_an_error_says_is_told_from_what_to_do():
    assert list(SCRIPT["refusals"](SOURCE)) == [
        ("<name> exists: <kind>", "name another file with -o"),
        ("<found> angles, a circle takes 3", "raise table_positions"),
    ]


@pytest.mark.parametrize(
    ("cause", "cure"),
    [
        (lambda: rc.combine(), "give at least one"),
        (lambda: TopicSettings(length_unit="mm", length_unit_m=0.5), "state one of them"),
        (lambda: TableAdapterSettings(lower_deg=-90.0), "give both ends of the travel"),
    ],
)
def test_who_searches_an_error_finds_its_cure(cause, cure, page):
    with pytest.raises(rc.RotcalError) as caught:
        cause()
    rows = re.findall(r"^\| `(.*)` \| (.*) \|$", page, re.M)
    (found,) = [
        advice
        for says, advice in rows
        if re.match(
            re.sub(r"<.*?>", ".*?", re.escape(says).replace(r"\<", "<")), str(caught.value)
        )
    ]
    assert found.startswith(cure)
