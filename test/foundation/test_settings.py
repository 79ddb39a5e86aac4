from dataclasses import MISSING, dataclass
from typing import Annotated, ClassVar, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.plugins import name_hint
from rotcal_ros.foundation.settings import (
    Constant,
    all_constants,
    declarations,
    expert,
    group,
    load,
    setting,
    to_mapping,
)


@dataclass(frozen=True)
class Inner:
    rate_hz: float = setting(10.0, doc="Hz, rate", minimum=0.1, maximum=1000.0)


@dataclass(frozen=True)
class Outer:
    name: str = setting(doc="name of the cell")
    count: int = setting(3, doc="number", minimum=1)
    order: str = setting("a", doc="order", choices=("a", "b"))
    way: Literal["up", "down"] = setting("up", doc="way")
    limit_m: float | None = setting(None, doc="m, limit", minimum=0.0)
    centre_m: tuple[float, float, float] = setting((0.0, 0.0, 0.0), doc="m, centre")
    angles_deg: tuple[float, ...] = setting((), doc="deg, angles")
    inner: Inner = group(Inner)


def test_a_setting_that_comes_first_is_marked_where_it_is_declared() -> None:
    @dataclass(frozen=True)
    class Marked:
        joint: str = setting("", doc="joint", first=True)
        axis: str = setting("C", doc="axis")

    assert [one.info.first for one in declarations(Marked)] == [True, False]


def test_a_setting_for_experts_is_marked_by_itself_or_with_its_group() -> None:
    @dataclass(frozen=True)
    class Marked:
        axis: str = setting("C", doc="axis")
        wait_s: float = expert(2.0, doc="s, wait", minimum=0.0)
        usual: Inner = group(Inner)
        faults: Inner = group(Inner, expert=True)

    marked = {one.name: one.info.expert for one in declarations(Marked)}
    assert marked == {
        "axis": False, "wait_s": True, "usual.rate_hz": False, "faults.rate_hz": True,
    }  # fmt: skip
    loaded = load(Marked, {"wait_s": 3, "faults": {"rate_hz": 7}}, "here")
    assert (loaded.wait_s, loaded.usual.rate_hz, loaded.faults.rate_hz) == (3.0, 10.0, 7.0)
    with pytest.raises(ConfigurationError, match=r"here.wait_s: -1.0 is out of range 0.0 to inf"):
        load(Marked, {"wait_s": -1}, "here")


@dataclass(frozen=True)
class WithConstants:
    rate_hz: float = setting(10.0, doc="Hz, rate")
    limit: ClassVar[Annotated[float, "nobody knows better"]] = 1e-7
    places: ClassVar[tuple[int, ...]] = (1, 2)


@dataclass(frozen=True)
class Around:
    inner: WithConstants = group(WithConstants)


@pytest.mark.parametrize("stated", [1e-7, "1e-7"])
def test_what_is_no_longer_a_setting_may_be_stated_with_the_value_that_it_has(stated) -> None:
    loaded = load(Around, {"inner": {"limit": stated, "rate_hz": 5}}, "here")
    assert loaded.inner == WithConstants(rate_hz=5.0)
    assert (loaded.inner.limit, to_mapping(loaded)) == (1e-7, {"inner": {"rate_hz": 5.0}})
    assert dict(all_constants(Around)) == {"inner.limit": Constant(1e-7, "nobody knows better")}


@pytest.mark.parametrize("stated", [2e-7, "2e-7", None, "much", [1e-7]])
def test_another_value_of_it_is_refused_in_one_line_that_says_what_to_do(stated) -> None:
    with pytest.raises(ConfigurationError) as caught:
        load(Around, {"inner": {"limit": stated}}, "here")
    assert str(caught.value) == (
        f"here.inner.limit: {stated!r} is stated, but this is no longer a setting: it is always "
        "1e-07 (nobody knows better); leave it out"
    )


def test_another_constant_of_a_class_was_never_a_setting() -> None:
    with pytest.raises(ConfigurationError, match="here: unknown setting 'places'"):
        load(WithConstants, {"places": [1, 2]}, "here")


def test_defaults_and_whole_numbers_for_floats() -> None:
    loaded = load(Outer, {"name": "x", "centre_m": [1, 2, 3], "inner": {"rate_hz": 5}}, "here")
    assert loaded == Outer(name="x", centre_m=(1.0, 2.0, 3.0), inner=Inner(rate_hz=5.0))
    assert isinstance(loaded.inner.rate_hz, float)


@pytest.mark.parametrize("text", ["5e-8", "5.e-8", "0.5E-7", "+.5e-07", "50e-9"])
def test_numbers_with_an_exponent_may_lack_what_yaml_wants(text: str) -> None:
    """YAML 1.1 takes 5e-8 and 1.0e5 without a sign for texts."""
    values = {"name": "x", "limit_m": text, "centre_m": [text, 1, 2.0], "angles_deg": [text]}
    loaded = load(Outer, values, "here")
    assert loaded.limit_m == pytest.approx(5e-8, rel=1e-15)
    assert loaded.centre_m[0] == loaded.angles_deg[0] == loaded.limit_m
    assert load(Outer, {"name": "5e-8"}, "here").name == "5e-8"


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({}, "'name' is missing"),
        ({"name": "x", "cuont": 1}, "did you mean 'count'"),
        ({"name": 5}, "expected str"),
        ({"name": "x", "count": True}, "expected int"),
        ({"name": "x", "count": 1.5}, "expected int"),
        ({"name": "x", "count": 0}, "out of range 1 to inf"),
        ({"name": "x", "order": "c"}, "none of a, b"),
        ({"name": "x", "way": "dwon"}, "none of up, down; did you mean 'down'"),
        ({"name": "x", "way": None}, "expected str"),
        ({"name": "x", "limit_m": -1}, "out of range 0.0 to inf"),
        ({"name": "x", "inner": {"rate_hz": "5e1 Hz"}}, "expected float"),
        ({"name": "x", "inner": {"rate_hz": "50"}}, "expected float"),
        ({"name": "x", "inner": {"rate_hz": "9e9"}}, "out of range"),
        ({"name": "x", "limit_m": "9e999"}, "expected a finite number"),
        ({"name": "x", "centre_m": [1.0]}, "expected 3 values, found 1"),
        ({"name": "x", "angles_deg": [1.0, float("nan")]}, r"angles_deg\[1\]: expected a finite"),
        ({"name": "x", "inner": {"rate_hz": 0.0}}, r"here.inner.rate_hz: 0.0 is out of range"),
        ({"name": "x", "inner": 4}, "expected a group"),
        ({"name": "x", "angles_deg": "12"}, "expected a list"),
    ],
)
def test_refused(values: dict[str, object], text: str) -> None:
    with pytest.raises(ConfigurationError, match=text):
        load(Outer, values, "here")


def test_declarations_are_flat_and_complete() -> None:
    found = {declared.name: declared for declared in declarations(Outer)}
    assert list(found) == [
        "name", "count", "order", "way", "limit_m", "centre_m", "angles_deg", "inner.rate_hz",
    ]  # fmt: skip
    assert found["name"].default is MISSING
    assert found["way"].info.choices == ("up", "down")
    assert (found["limit_m"].optional, found["limit_m"].kind) == (True, float)
    assert (found["centre_m"].is_list, found["centre_m"].length) == (True, 3)
    assert (found["angles_deg"].is_list, found["angles_deg"].length) == (True, None)
    assert found["inner.rate_hz"].info.maximum == 1000.0


@given(
    st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=8),
    st.integers(1, 10**6),
    st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=5),
)
def test_mapping_round_trip(name: str, count: int, angles: list[float]) -> None:
    settings = Outer(name=name, count=count, angles_deg=tuple(angles))
    assert load(Outer, to_mapping(settings), "here") == settings


@pytest.mark.parametrize(
    ("known", "hint"),
    [
        (["balls", "grid"], "; did you mean 'balls'?"),
        (["one", "two"], "; known: one, two"),
        ([], "; known: none"),
    ],
)
def test_a_hint_is_never_empty(known, hint):
    assert name_hint("ball", known) == hint
