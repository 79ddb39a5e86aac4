"""Collected definitions against rosbags' own parser and generator."""

from __future__ import annotations

from pathlib import Path

import pytest
from bag_samples import MSG_DEFS, STORE
from rosbags.typesys import get_types_from_msg

from rotcal_ros.bags.definitions import collect_definition
from rotcal_ros.foundation.errors import BagError

NAMES = sorted(f"rotcal_msgs/msg/{p.stem}" for p in (MSG_DEFS / "msg").glob("*.msg"))


@pytest.fixture(scope="module")
def share(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return share folders with the ROS messages that ours contain."""
    root = tmp_path_factory.mktemp("share")
    for name in (
        "std_msgs/msg/Header", "builtin_interfaces/msg/Time", "diagnostic_msgs/msg/KeyValue",
        "unique_identifier_msgs/msg/UUID",
    ):  # fmt: skip
        text, _ = STORE.generate_msgdef(name, ros_version=2)
        path = root / f"{name}.msg"
        path.parent.mkdir(parents=True)
        path.write_text(text.split("=" * 80)[0])
    (root / "rotcal_msgs").symlink_to(MSG_DEFS)
    return root


def lookup(share: Path):  # type: ignore[no-untyped-def]
    def find(package: str) -> Path:
        if not (share / package).is_dir():
            raise LookupError(f"package {package} not found")
        return share / package

    return find


@pytest.mark.parametrize("name", NAMES)
def test_definition_is_whole(share: Path, name: str) -> None:
    """What rosbags reads from the text is what it reads from the files one by one."""
    types = get_types_from_msg(collect_definition(name, lookup(share)), name)
    own_text = (MSG_DEFS / "msg" / f"{name.rpartition('/')[2]}.msg").read_text()
    assert types[name] == get_types_from_msg(own_text, name)[name]
    expected, _ = STORE.generate_msgdef(name, ros_version=2)
    assert types.keys() == get_types_from_msg(expected, name).keys()
    for other in types.keys() - {name}:
        assert types[other] == STORE.fielddefs[other]


def test_all_forms_of_fields(tmp_path: Path) -> None:
    def define(name: str, text: str) -> None:
        path = tmp_path / f"{name}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    define(
        "a/msg/Top",
        "# Commented c/Nothing x\nuint8 KIND=3\nInner[3] inner # a comment\nb/Other[<=5] others\n"
        "string<=10 text\nfloat64[] numbers\nint32 count 7\nb/msg/Deep deep\n",
    )
    define("a/msg/Inner", "bool yes\n")
    define("b/msg/Other", "Deep deep\n")
    define("b/msg/Deep", "string S='a/b c'\nuint8 x\n")
    text = collect_definition("a/msg/Top", lambda package: tmp_path / package)
    assert [line for line in text.splitlines() if line.startswith("MSG: ")] == [
        "MSG: a/Inner",
        "MSG: b/Other",
        "MSG: b/Deep",
    ]
    types = get_types_from_msg(text, "a/msg/Top")
    assert set(types) == {"a/msg/Top", "a/msg/Inner", "b/msg/Other", "b/msg/Deep"}


def test_missing_dependency_names_both(tmp_path: Path) -> None:
    (tmp_path / "a" / "msg").mkdir(parents=True)
    (tmp_path / "a" / "msg" / "Top.msg").write_text("gone/Away away\n")
    with pytest.raises(BagError, match=r"gone/msg/Away \(needed for a/msg/Top\)"):
        collect_definition("a/msg/Top", lambda package: tmp_path / package)


@pytest.mark.parametrize("name", ["no_slash", "a/srv/Thing", "a/msg/Top/Deeper"])
def test_what_is_no_message(tmp_path: Path, name: str) -> None:
    with pytest.raises(BagError, match="not installed"):
        collect_definition(name, lambda package: tmp_path / package)
