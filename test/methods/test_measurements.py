"""Plain tables: what fits the plan is taken, everything else is refused with file and row."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from importlib.metadata import EntryPoint
from itertools import product
from math import dist
from pathlib import Path

import numpy as np
import pytest
from mirror_cell import measure, paper_cell
from mirror_points import points_table

from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.configuration import (
    Configuration,
    dump_configuration,
    parse_configuration,
    read_configuration,
)
from rotcal_ros.methods.measurements import read_measurements
from rotcal_ros.methods.method import find_method, method_names, usable_methods
from rotcal_ros.methods.tracer.table import read_targets

EXAMPLES = Path(__file__).parents[2] / "examples/data"
TARGETS = [(0.1 * x, 0.2 * y, 0.5 + 0.1 * z) for x, y, z in product(range(2), repeat=3)]
STATIONS = [(0.3, 0.0, 0.2), (0.0, 0.3, 0.2), (-0.3, 0.0, 0.2)]


@pytest.fixture
def configuration() -> Configuration:
    return parse_configuration(
        dump_configuration(
            "tracer_multistation", {"plan": {"table_angles_deg": [0.0, 90.0, 180.0]}}
        )
    )


def tracer_rows(factor: float = 1.0) -> list[str]:
    return [
        f"{s},{t},{factor * (dist(STATIONS[s], TARGETS[t]) - 0.25)!r}"
        for s, t in product(range(3), range(8))
    ]


def write_tracer(
    folder: Path, rows: list[str], targets: list[tuple[float, float, float]] | None = None
) -> Path:
    lines = [f"{i},{x!r},{y!r},{z!r}" for i, (x, y, z) in enumerate(targets or TARGETS)]
    (folder / "targets.csv").write_text("\n".join(["target,x_m,y_m,z_m", *lines]))
    path = folder / "lengths.csv"
    path.write_text("\n".join(["# made by hand", "position,target,length_m", "", *rows]) + "\n")
    return path


def test_tracer_table_becomes_observations(configuration: Configuration, tmp_path: Path) -> None:
    path = write_tracer(tmp_path, tracer_rows())
    data = read_measurements(path, configuration)
    assert data.calibration.plan.targets == tuple(TARGETS)
    assert data.calibration.plan.table_angles == (0.0, 90 * DEGREE, 180 * DEGREE)
    assert len(data.observations) == 24
    observation = data.observations[9]
    assert (observation.table_position, observation.target) == (1, 1)
    assert observation.mean == (dist(STATIONS[1], TARGETS[1]) - 0.25,)
    assert observation.probe_position == TARGETS[1]
    assert observation.accepted
    assert len({o.step for o in data.observations}) == 24
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert data.sha256["lengths.csv"] == digest
    assert set(data.sha256) == {"lengths.csv", "targets.csv"}


def test_rows_may_be_missing_and_in_any_order(
    configuration: Configuration, tmp_path: Path
) -> None:
    rows = tracer_rows()
    path = write_tracer(tmp_path, [rows[i] for i in (23, 4, 17)])
    data = read_measurements(path, configuration)
    assert [(o.table_position, o.target) for o in data.observations] == [(2, 7), (0, 4), (2, 1)]


@pytest.mark.parametrize(
    ("row", "text"),
    [
        ("0,1", "expected 3 values"),
        ("0,1,nan", "length_m must be a finite number, found 'nan'"),
        ("0,1,inf", "finite"),
        ("0,1,", "finite"),
        ("0,1,0,3", "expected 3 values"),
        ("a,1,0.3", "position must be a whole number from 0, found 'a'"),
        ("-1,1,0.3", "whole number"),
        ("1.0,1,0.3", "whole number"),
        ("3,1,0.3", "positions 0 to 2"),
        ("0,8,0.3", "targets 0 to 7"),
        ("0,1,312.5", "millimetres"),
        ("0,0,0.2", "measured already"),
    ],
)
def test_bad_row_is_named(
    configuration: Configuration, tmp_path: Path, row: str, text: str
) -> None:
    path = write_tracer(tmp_path, [tracer_rows()[0], row])
    with pytest.raises(DataError, match=text) as caught:
        read_measurements(path, configuration)
    assert f"{path}, row 5" in str(caught.value)


def test_lengths_in_millimetres_do_not_fit_the_targets(
    configuration: Configuration, tmp_path: Path
) -> None:
    """Short enough to be metres, but they change more than the targets are apart."""
    path = write_tracer(tmp_path, tracer_rows(100.0))
    with pytest.raises(DataError, match="millimetres instead of metres"):
        read_measurements(path, configuration)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", "expected .*'position,target,length_m"),
        ("0,0,0.25\n", "expected .*'position,target,length_m"),
        ("position,target,speed\n0,0,1\n", "no column length_m: .*'speed'"),
        ("position;length_m\n0;1\n", "no column (position, )?target"),
    ],
)
def test_wrong_header(configuration: Configuration, tmp_path: Path, text: str, error: str) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(BagError, match=error):
        read_measurements(path, configuration)


def test_empty_missing_and_binary_tables(configuration: Configuration, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    with pytest.raises(BagError, match="cannot read the table"):
        read_measurements(path, configuration)
    path.write_bytes(b"\x00\x01\xff\xfe\x00\x00")
    with pytest.raises(BagError, match="cannot read the table"):
        read_measurements(path, configuration)
    path.write_text("position,target,length_m\n")
    with pytest.raises(DataError, match="no rows"):
        read_measurements(path, configuration)


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        (["0,0,0,0", "2,0,0,0"], "target 1 is missing"),
        (["1,0,0,0", "2,0,0,0"], "target 0 is missing"),
        (["0,0,0,0", "0,0,0,1"], "listed twice"),
        (["0,0,450,0"], "y_m is 450 m"),
    ],
)
def test_bad_targets(tmp_path: Path, rows: list[str], text: str) -> None:
    path = tmp_path / "targets.csv"
    path.write_text("\n".join(["target,x_m,y_m,z_m", *rows]))
    with pytest.raises(DataError, match=text):
        read_targets(path)


PLATE = {"grid": 12, "ball_steps": [0, 1, 5], "circle_radius_m": 0.1, "ball_diameter_m": 0.01}


def test_ball_plate_table(tmp_path: Path) -> None:
    setup = parse_configuration(dump_configuration("ball_plate", {"plan": {"plate": PLATE}}))
    path = tmp_path / "plate.csv"
    path.write_text("position,ball_step,x_m,y_m,z_m\n1,0,0.1,0.2,0.3\n0,5,1,2,3\n")
    data = read_measurements(path, setup)
    assert [(o.step, o.table_position, o.target, o.mean, o.kind) for o in data.observations] == [
        (0, 1, 0, (0.1, 0.2, 0.3), PointKind.CENTRE),  # rows in the order of measurement
        (1, 0, 5, (1.0, 2.0, 3.0), PointKind.CENTRE),
    ]
    path.write_text("position,ball_step,x_m,y_m,z_m\n1,2,0.1,0.2,0.3\n")
    with pytest.raises(
        DataError, match=r"row 2: position 1, ball step 2 is not .* ball steps 0, 1, 5"
    ):
        read_measurements(path, setup)


def test_a_row_that_is_not_in_the_plan_is_named(
    configuration: Configuration, tmp_path: Path
) -> None:
    path = write_tracer(tmp_path, tracer_rows())
    data = read_measurements(path, configuration)
    assert [o.table_position for o in data.observations] == [p for p in range(3) for _ in range(8)]
    path.write_text("\n".join(["position,target,length_m", "99,0,0.1"]))
    with pytest.raises(DataError, match=r"row 2: position 99, target 0 is not in the plan"):
        read_measurements(path, configuration)


def test_plane_mirror_table_is_read_by_its_method(tmp_path: Path) -> None:
    """Stations with names, rows in any order, comments: what a tracker program writes."""
    deviations = np.zeros((17, 6))
    deviations[:, 5] = 3.0 * ARCSEC * np.sin(np.arange(17))
    problem = measure(paper_cell(), deviations)
    named = replace(problem, station_names=tuple("ABCDEF"))
    head, *rows = points_table(named).splitlines()
    path = tmp_path / "mirror.csv"
    path.write_text("\n".join(["# metres", head, *rows]))
    mirror = {"plan": {"table_step_deg": 22.5, "table_positions": 17}}
    setup = parse_configuration(dump_configuration("plane_mirror", mirror))
    result = read_measurements(path, setup).solve()
    expected = deviations[:, 5] - deviations[0, 5]
    np.testing.assert_allclose(result.deviations["ECC"], expected, atol=1e-9)
    assert [way["way"] for way in result.details["ways"]] == ["stitching", "registration"]

    path.write_text("\n".join([head, rows[0].replace("nest", "reflected"), *rows[1:]]))
    with pytest.raises(DataError, match=r"mirror\.csv, row 2: kind 'reflected'"):
        read_measurements(path, setup).solve()
    tracer = parse_configuration(dump_configuration("tracer_multistation", {}))
    with pytest.raises(
        BagError, match=r"a table of the method plane_mirror, but .* sets up tracer_multistation"
    ):
        read_measurements(path, tracer).solve()


def test_table_solves_to_the_injected_deviations(tmp_path: Path) -> None:
    """Exact lengths from a table whose angles are off by known amounts."""
    commanded = [30.0 * i for i in range(7)]
    errors = np.array([0.0, 5.0, -3.0, 8.0, 1.0, -6.0, 2.0]) * ARCSEC
    grid = [(0.2 * x, 0.25 * y, 0.4 + 0.2 * z) for x, y, z in product((-1, 0, 1), repeat=3)]
    rows = []
    for number, (angle, error) in enumerate(zip(commanded, errors, strict=True)):
        phi = angle * DEGREE + error
        station = (0.3 * np.cos(phi), 0.3 * np.sin(phi), 0.1)
        rows += [
            f"{number},{target},{dist(station, point) - 0.4 - 0.01 * number!r}"
            for target, point in enumerate(grid)
        ]
    path = write_tracer(tmp_path, rows, grid)
    setup = parse_configuration(
        dump_configuration("tracer_multistation", {"plan": {"table_angles_deg": commanded}})
    )
    result = read_measurements(path, setup).solve()
    np.testing.assert_allclose(result.deviations["ECC"], errors, atol=1e-3 * ARCSEC)
    assert result.n_observations == 7 * 27


@pytest.mark.parametrize(
    ("table", "setup"),
    [("lengths.csv", "tracer.yaml"), ("three_places/lengths.csv", "tracer_six.yaml")],
)
def test_a_table_of_lengths_with_the_sign_turned_round_says_so(table, setup, tmp_path):
    """Not "spread the targets": that no target would cure."""
    path = EXAMPLES / table
    head, *rows = path.read_text().splitlines()
    column = head.split(",").index("length_m")
    cells = [row.split(",") for row in rows]
    for row in cells:
        row[column] = row[column].removeprefix("-") if "-" in row[column] else f"-{row[column]}"
    (tmp_path / "targets.csv").write_text((path.parent / "targets.csv").read_text())
    turned = tmp_path / "lengths.csv"
    turned.write_text("\n".join([head, *(",".join(row) for row in cells)]) + "\n")
    with pytest.raises(DataError, match="opposite sign they fit: turn their sign round"):
        read_measurements(turned, read_configuration(EXAMPLES / setup)).solve()


def test_a_method_of_another_package_that_does_not_load_troubles_no_other(
    configuration, tmp_path, monkeypatch
):
    table = write_tracer(tmp_path, tracer_rows(), TARGETS)
    broken = EntryPoint("broken", "no_such_package:METHOD", plugins.METHODS)
    found = plugins._found
    monkeypatch.setattr(
        plugins,
        "_found",
        lambda group: (
            {**found(group), "broken": broken} if group == plugins.METHODS else found(group)
        ),
    )
    assert "broken" in method_names()
    assert "broken" not in {method.name for method in usable_methods()}
    assert len(read_measurements(table, configuration).observations) == 24
    with pytest.raises(ConfigurationError, match=r"'broken' .* cannot be loaded"):
        find_method("broken")
