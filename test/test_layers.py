"""The table of packages in CONTRIBUTING and the import contracts agree."""

import re
from pathlib import Path

import grimp
import pytest
from importlinter.api import read_configuration

ROOT = Path(__file__).parents[1]
CONTRACTS = read_configuration(str(ROOT / "pyproject.toml"))["contracts_options"]
LAYERS, *_, OF_PACKAGES = (
    contract["layers"] for contract in CONTRACTS if contract["type"] == "layers"
)
BESIDE = sorted(path.parent.name for path in ROOT.glob("packages/*/package.xml"))
"""The packages beside the core."""


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
    """Return what each package of the table knows, in the table's order."""
    cells = rows("| package | knows | holds |")
    return {
        package: names(knows) for several, knows, _holds in cells for package in names(several)
    }


def allowed() -> dict[str, set[str]]:
    """Return what each package may know: all below, and beside it where ":" joins layers."""
    found: dict[str, set[str]] = {}
    below: set[str] = set()
    for layer in reversed(LAYERS):
        packages = names(layer, "|:")
        for package in packages:
            found[package] = below | (set(packages) - {package} if ":" in layer else set())
        below = below | set(packages)
    return found


def test_the_layers_hold_every_room():
    packages = {
        path.stem
        for path in (ROOT / "rotcal_ros").iterdir()
        if (path.suffix == ".py" and path.stem != "__init__") or (path / "__init__.py").is_file()
    }
    assert packages == set(allowed())


def test_the_table_holds_the_rooms_in_the_order_of_the_layers():
    assert list(table()) == [package for layer in LAYERS for package in names(layer, "|:")]


@pytest.mark.parametrize("package", table())
def test_the_table_says_nothing_that_the_contract_forbids(package):
    knows = table()[package]
    assert knows in (["nothing"], ["all below"]) or set(knows) <= allowed()[package]


def test_the_table_names_every_room_that_a_room_imports():
    graph = grimp.build_graph("rotcal_ros", cache_dir=None)
    for package in table():
        graph.squash_module(f"rotcal_ros.{package}")
    for package, knows in table().items():
        imported = graph.find_modules_directly_imported_by(f"rotcal_ros.{package}")
        found = {name.split(".")[1] for name in imported - {"rotcal_ros"}}
        unnamed = found - {package, *knows, *names(LAYERS[-1], "|:")}
        assert knows == ["all below"] or not unnamed, package


def test_the_table_and_the_contract_hold_every_package():
    assert [names(row[0])[0] for row in rows("| package beside the core | holds |")] == BESIDE
    assert [sorted(names(layer, "|")) for layer in OF_PACKAGES] == [BESIDE, ["rotcal_ros"]]


def imported_by(folder: Path) -> set[str]:
    """Return the packages beside the core that files below a folder import, or name as such."""
    text = "\n".join(path.read_text("utf-8") for path in sorted(folder.rglob("*.py")))
    return {name for name in BESIDE if re.search(rf"\b{name}\b(?!/)", text)}


def test_the_core_and_its_tests_name_no_package():
    found = set().union(
        *(imported_by(ROOT / folder) for folder in ("rotcal_ros", "launch", "test"))
    )
    assert found == set()


@pytest.mark.parametrize("package", BESIDE)
def test_a_package_and_its_tests_know_no_other(package):
    assert imported_by(ROOT / "packages" / package) == {package}
