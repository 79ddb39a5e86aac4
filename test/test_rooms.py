"""The table of rooms in CONTRIBUTING and the import contracts agree."""

import re
from pathlib import Path

import grimp
import pytest
from importlinter.api import read_configuration

ROOT = Path(__file__).parents[1]
CONTRACTS = read_configuration(str(ROOT / "pyproject.toml"))["contracts_options"]
LAYERS = next(contract["layers"] for contract in CONTRACTS if contract["type"] == "layers")


def names(text: str, separators: str = ",") -> list[str]:
    return [name.strip().strip("`") for name in re.split(f"[{separators}]", text)]


def rows(head: str) -> list[list[str]]:
    """Return the cells of the table with this head."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    lines = text.split(f"{head}\n")[1].split("\n\n")[0].splitlines()[1:]
    cells = [line.strip("| ").split("|") for line in lines]
    assert all(len(row) == head.count("|") - 1 and row[-1].strip() for row in cells)
    return cells


def table() -> dict[str, list[str]]:
    """Return what each room of the table knows, in the table's order."""
    cells = rows("| room | knows | holds |")
    return {room: names(knows) for several, knows, _holds in cells for room in names(several)}


def allowed() -> dict[str, set[str]]:
    """Return what each room may know by the layers: all below, and beside it where ":" joins."""
    found: dict[str, set[str]] = {}
    below: set[str] = set()
    for layer in reversed(LAYERS):
        rooms = names(layer, "|:")
        for room in rooms:
            found[room] = below | (set(rooms) - {room} if ":" in layer else set())
        below = below | set(rooms)
    return found


def test_the_layers_hold_every_room():
    rooms = {
        path.stem
        for path in (ROOT / "rotcal_ros").iterdir()
        if (path.suffix == ".py" and path.stem != "__init__") or (path / "__init__.py").is_file()
    }
    assert rooms == set(allowed())


def test_the_table_holds_the_rooms_in_the_order_of_the_layers():
    assert list(table()) == [room for layer in LAYERS for room in names(layer, "|:")]


@pytest.mark.parametrize("room", table())
def test_the_table_says_nothing_that_the_contract_forbids(room):
    knows = table()[room]
    assert knows in (["nothing"], ["all below"]) or set(knows) <= allowed()[room]


def test_the_table_names_every_room_that_a_room_imports():
    graph = grimp.build_graph("rotcal_ros", cache_dir=None)
    for room in table():
        graph.squash_module(f"rotcal_ros.{room}")
    for room, knows in table().items():
        imported = graph.find_modules_directly_imported_by(f"rotcal_ros.{room}")
        found = {name.split(".")[1] for name in imported - {"rotcal_ros"}}
        unnamed = found - {room, *knows, *names(LAYERS[-1], "|:")}
        assert knows == ["all below"] or not unnamed, room


def test_the_table_holds_every_extension():
    places = (ROOT / "rotcal_ros" / "extensions").glob("*/__init__.py")
    assert [names(row[0])[0] for row in rows("| extension | holds |")] == sorted(
        place.parent.name for place in places
    )
