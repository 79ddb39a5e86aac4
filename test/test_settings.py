from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotcal_ros.errors import ConfigurationError
from rotcal_ros.settings import group, load, setting, to_mapping, walk


@dataclass(frozen=True)
class Inner:
    rate_hz: float = setting(10.0, doc="Hz, rate", minimum=0.1, maximum=1000.0)


@dataclass(frozen=True)
class Outer:
    name: str = setting(doc="name of the cell")
    count: int = setting(3, doc="number", minimum=1)
    order: str = setting("a", doc="order", choices=("a", "b"))
    centre_m: tuple[float, float, float] = setting((0.0, 0.0, 0.0), doc="m, centre")
    angles_deg: tuple[float, ...] = setting((), doc="deg, angles")
    inner: Inner = group(Inner)


def test_defaults_and_whole_numbers_for_floats() -> None:
    loaded = load(Outer, {"name": "x", "centre_m": [1, 2, 3], "inner": {"rate_hz": 5}}, "here")
    assert loaded == Outer(name="x", centre_m=(1.0, 2.0, 3.0), inner=Inner(rate_hz=5.0))
    assert isinstance(loaded.inner.rate_hz, float)


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


def test_walk_flattens_groups_for_ros_parameters() -> None:
    names = [name for name, _, _ in walk(Outer(name="x"))]
    assert names == ["name", "count", "order", "centre_m", "angles_deg", "inner.rate_hz"]


@given(
    st.text(max_size=8),
    st.integers(1, 10**6),
    st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=5),
)
def test_mapping_round_trip(name: str, count: int, angles: list[float]) -> None:
    settings = Outer(name=name, count=count, angles_deg=tuple(angles))
    assert load(Outer, to_mapping(settings), "here") == settings
