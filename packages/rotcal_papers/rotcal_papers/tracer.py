"""The laser tracer paper: its printed numbers, and what follows from them.

Tables 1 to 3 and Eq. 37 and 38 are all that is printed of the experiment; its 704 lengths are not.
So the stations of Table 1 are solved as they are, and what the lengths could have shown follows
from the plan, to first order. The words stand in ``templates/tracer.yaml``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_papers.reproduction import PrintedTable, Reproduction
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE, MILLIMETRE
from rotcal_ros.methods.figures import Figure, style
from rotcal_ros.methods.tracer.solver.circle import (
    ABSORBED,
    TableMotion,
    bearing_slopes,
    table_motion,
)
from rotcal_ros.methods.tracer.solver.stations import StationProblem, solve
from rotcal_ros.planning.points import serpentine_grid

TABLE_1_MM: Final = (
    (-64.9938, -6.6256, 122.5146, 1128.5363),
    (-53.0600, -38.1824, 122.5137, 1128.5372),
    (-26.9493, -59.5448, 122.5127, 1128.5363),
    (6.3444, -64.9883, 122.5125, 1128.5375),
    (37.8969, -53.0580, 122.5123, 1128.5373),
    (59.2589, -26.9510, 122.5112, 1128.5378),
    (64.7067, 6.3400, 122.5104, 1128.5377),
    (52.7784, 37.8971, 122.5107, 1128.5373),
    (26.6701, 59.2624, 122.5109, 1128.5382),
    (-6.6235, 64.7100, 122.5107, 1128.5383),
    (-38.1803, 52.7804, 122.5108, 1128.5379),
)
"""Stations X, Y, Z and their distances d to the first target."""
TABLE_2_Z_MM: Final = (
    122.5133, 122.5136, 122.5134, 122.5128, 122.5120, 122.5112, 122.5106, 122.5103, 122.5105,
    122.5110, 122.5118,
)  # fmt: skip
"""Heights of the projected stations; their X and Y are those of Table 1, as printed."""
TABLE_3_ARCSEC: Final = (5.9, 0.7, -0.4, -9.9, -9.2, -7.2, 1.0, -0.1, 1.0, 2.9)
"""Deviations of the steps, stations P2 to P11."""
START_DEG: Final = -145.0
STEP_DEG: Final = 30.0
BLOCK_M: Final = (0.45, 0.6, 0.45)
PER_SIDE: Final = 4
SHIPPED_CENTRE_M: Final = (0.0, 0.0, 1.425)
"""Where ``config/tracer_paper.yaml`` has the block, of which the paper prints the size only."""
LENGTH_STD: Final = 0.2e-6
TARGET_STD: Final = 1e-6
"""What a length and a coordinate are taken to be good for, m: the paper prints "below 1 um"."""


@dataclass(frozen=True)
class _Found:
    """What follows from Table 1."""

    stations: Floats
    distances: Floats
    motion: TableMotion
    result: Result

    @property
    def step_uncertainty(self) -> Floats:
        """U (k = 2) of the steps, rad."""
        assert self.result.adjacent_std is not None
        return COVERAGE_FACTOR * self.result.adjacent_std

    @property
    def about_mean(self) -> float:
        """U (k = 2) of the curve about its mean, rms over the angles, rad."""
        n = len(self.stations)
        centred = np.eye(n) - 1.0 / n
        variance = np.diag(centred @ self.result.covariance["ECC"] @ centred)
        return float(COVERAGE_FACTOR * np.sqrt(variance.mean()))


def reproduce() -> Reproduction:
    """Return the paper's tables, figures and claims, computed again from what it prints."""
    found = _solved()
    values = _values(found)
    return Reproduction.of("tracer", values, _tables(found, values), _figures(found))


def _angles(count: int) -> Floats:
    """Return the commanded angles (m,) of so many stations, rad."""
    return np.asarray(DEGREE * (START_DEG + STEP_DEG * np.arange(count)), dtype=np.float64)


def _solved() -> _Found:
    table = MILLIMETRE * np.array(TABLE_1_MM)
    angles = _angles(len(table))
    stations, distances = table[:, :3], table[:, 3]
    result = solve(StationProblem(stations, angles, np.arange(len(table)), distances))
    return _Found(stations, distances, table_motion(stations, angles), result)


def first_target_of(stations: Floats, distances: Floats) -> tuple[Floats, float]:
    """Return the place (3,) m of the first target above the ``stations``, and its rms misfit, m.

    From the ``distances`` (m,) as the paper defines them, d_j = |A1 - P_j|: Gauss and Newton.
    """
    place = stations.mean(axis=0) + np.array([0.0, 0.0, distances.mean()])
    for _ in range(20):
        apart = place - stations
        length = np.linalg.norm(apart, axis=1)
        place = place - np.linalg.lstsq(apart / length[:, None], length - distances, rcond=None)[0]
    misfit = np.linalg.norm(place - stations, axis=1) - distances
    return place, float(np.sqrt((misfit**2).mean()))


def block_uncertainties(stations: Floats, first_target: Floats) -> dict[str, float]:
    """Return U(ECC) about its mean (k = 2, rms over the angles, rad) of the paper's 704 lengths.

    For the readings of d_j: the block begins at the ``first_target``, upwards or downwards, with
    a zero per station; or one zero for all, with the block where our configuration has it.
    """
    half = 0.5 * np.array(BLOCK_M)
    shipped = np.array(SHIPPED_CENTRE_M)
    return {
        "block_up": _predicted(stations, first_target + half),
        "block_down": _predicted(stations, first_target + half * [1.0, 1.0, -1.0]),
        "one_zero": _predicted(stations, shipped, shared=True),
        "shipped": _predicted(stations, shipped),
    }


def _predicted(stations: Floats, centre: Floats, *, shared: bool = False) -> float:
    """Return that of the paper's network (Eq. 1-4), plane and circle: nothing says it is round."""
    targets, m = _block(centre), len(stations)
    n, zeros = len(targets), 1 if shared else m
    each = np.arange(m * n)
    position, target = np.divmod(each, n)
    apart = stations[position] - targets[target]
    unit = apart / np.linalg.norm(apart, axis=1)[:, None] / LENGTH_STD
    rows, xyz = np.zeros((m * n, 3 * m + zeros + 3 * n)), np.arange(3)
    rows[each[:, None], 3 * position[:, None] + xyz] = unit
    rows[each[:, None], 3 * m + zeros + 3 * target[:, None] + xyz] = -unit
    rows[each, 3 * m + (0 if shared else position)] = -1.0 / LENGTH_STD
    known = np.eye(3 * n, rows.shape[1], 3 * m + zeros) / TARGET_STD
    upper = np.asarray(np.linalg.qr(np.vstack([rows, known]), mode="r"))
    turn = np.zeros((m, rows.shape[1]))
    turn[:, : 3 * m] = bearing_slopes(stations, table_motion(stations, _angles(m)))[:]
    root = np.linalg.solve(upper.T, (turn - turn.mean(axis=0)).T)
    return COVERAGE_FACTOR * float(np.sqrt((root**2).sum() / m))


def _block(centre: Floats) -> Floats:
    """Return the 64 targets of the block as our plans have them: a serpentine in each layer."""
    x, y, z = centre.tolist()
    return np.array(serpentine_grid((x, y, z), BLOCK_M, (PER_SIDE, PER_SIDE, PER_SIDE)))


def _values(found: _Found) -> dict[str, float]:
    """Return the numbers of the page by their names."""
    motion, result, plane = found.motion, found.result, found.motion.plane
    off = plane.distances(found.stations)
    free = len(off) - ABSORBED
    printed = MILLIMETRE * np.column_stack([np.array(TABLE_1_MM)[:, :2], TABLE_2_Z_MM])
    projected = found.stations - off[:, None] * plane.normal
    adjacent, ecc = motion.adjacent / ARCSEC, motion.cumulative / ARCSEC
    squares, q = float((adjacent**2).sum()), len(adjacent)
    place, misfit = first_target_of(found.stations, found.distances)
    x, y, z = (place / MILLIMETRE).tolist()
    blocks = block_uncertainties(found.stations, place)
    values = {
        "lengths": len(off) * PER_SIDE**3,
        "normal_x": plane.normal[0],
        "normal_y": plane.normal[1],
        "lambda_mm": -off[0] / MILLIMETRE,
        "table_2_difference_mm": np.abs(projected - printed).max() / MILLIMETRE,
        "centre_x_mm": motion.centre[0] / MILLIMETRE,
        "centre_y_mm": motion.centre[1] / MILLIMETRE,
        "radius_mm": motion.radius / MILLIMETRE,
        "tilt_arcsec": motion.tilt / ARCSEC,
        "table_3_difference_arcsec": np.abs(adjacent - TABLE_3_ARCSEC).max(),
        "ecc_end_arcsec": ecc[-1],
        "span_arcsec": np.ptp(ecc),
        "half_span_arcsec": 0.5 * np.ptp(ecc),
        "largest_step_arcsec": np.abs(adjacent).max(),
        "sigma_by_steps_arcsec": 0.5 * np.sqrt(squares / (q * (q - 1))),
        "sigma_by_stations_arcsec": 0.5 * np.sqrt(squares / (q * (q + 1))),
        "algorithm_error_arcsec": np.abs(result.details["algorithm_error"]).max() / ARCSEC,
        "u_smallest": COVERAGE_FACTOR * result.std["ECC"][1:].min() / ARCSEC,
        "u_largest": COVERAGE_FACTOR * result.std["ECC"].max() / ARCSEC,
        "u_about_mean_arcsec": found.about_mean / ARCSEC,
        "steps_beyond": np.count_nonzero(np.abs(motion.adjacent) > found.step_uncertainty),
        "radial_um": np.sqrt((motion.radial**2).sum() / free) / MICROMETRE,
        "axial_um": np.sqrt((off**2).sum() / free) / MICROMETRE,
        "arcsec_per_um": MICROMETRE / motion.radius / ARCSEC,
        "first_target_x_mm": x,
        "first_target_y_mm": y,
        "first_target_z_mm": z,
        "first_target_misfit_um": misfit / MICROMETRE,
        "distance_spread_um": np.ptp(found.distances) / MICROMETRE,
        **{f"u_{name}_arcsec": u / ARCSEC for name, u in blocks.items()},
    }
    return {name: float(value) for name, value in values.items()}


def _tables(found: _Found, values: Mapping[str, float]) -> Iterator[PrintedTable]:
    """Yield Tables 1 to 3, and what d may mean."""
    motion, result = found.motion, found.result
    off = motion.plane.distances(found.stations)
    projected = found.stations - off[:, None] * motion.plane.normal
    yield PrintedTable.of(
        "Table 1, as printed: stations, and their distances from the first target, mm",
        ("station", "X", "Y", "Z", "d"),
        (".0f", ".4f", ".4f", ".4f", ".4f"),
        [(j, *row) for j, row in enumerate(TABLE_1_MM, start=1)],
    )
    yield PrintedTable.of(
        "Table 2: projected stations, mm, and how far each stood from plane and circle, µm",
        ("station", "X", "Y", "Z", "Z printed", "axial", "radial"),
        (".0f", ".4f", ".4f", ".4f", ".4f", "+.2f", "+.2f"),
        np.column_stack(
            [
                np.arange(1, len(off) + 1),
                projected / MILLIMETRE,
                TABLE_2_Z_MM,
                off / MICROMETRE,
                motion.radial / MICROMETRE,
            ]
        ),
    )
    yield PrintedTable.of(
        "Table 3: deviations of the steps, and the curve that they add up to, arcsec (U: k = 2)",
        ("station", "step, printed", "step", "U(step)", "ECC", "U(ECC)"),
        (".0f", ".1f", ".2f", ".1f", ".2f", ".1f"),
        np.column_stack(
            [
                np.arange(2, len(off) + 1),
                TABLE_3_ARCSEC,
                motion.adjacent / ARCSEC,
                found.step_uncertainty / ARCSEC,
                motion.cumulative[1:] / ARCSEC,
                COVERAGE_FACTOR * result.std["ECC"][1:] / ARCSEC,
            ]
        ),
    )
    yield PrintedTable.of(
        "What d may mean, and U(ECC) of the 704 lengths then, about the mean of the curve, arcsec "
        f"(k = 2, with {LENGTH_STD / MICROMETRE:g} µm per length and {TARGET_STD / MICROMETRE:g} "
        "µm per coordinate)",
        ("reading", "U"),
        ("", ".2f"),
        [
            (words, values[f"u_{name}_arcsec"])
            for name, words in (
                ("block_up", "d = |A1 - P|, so A1 is on the axis; the block stands above it"),
                ("block_down", "the same; the block hangs below it"),
                ("one_zero", "one zero for all, the beam never broken; block centred on the axis"),
                ("shipped", "a zero per station; block centred on the axis, as in our set-up"),
            )
        ],
    )


def _figures(found: _Found) -> tuple[Figure, ...]:
    return (
        Figure(
            "Fig. 6: path of the reflector",
            "64 targets in four layers, 150 mm apart, with the same path in each: a serpentine is "
            "assumed. Placed as in config/tracer_paper.yaml.",
            draw_path(_block(np.array(SHIPPED_CENTRE_M))),
        ),
        Figure(
            "Fig. 7: plane of the stations",
            "Stations about the centre, and their distances from fitted plane and circle. The "
            "largest "
            "step between neighbours, 2.3 µm, lies between the last station and the first, which "
            "no "
            "closing measurement joins.",
            draw_plane(found.motion, found.motion.plane.distances(found.stations)),
        ),
        Figure(
            "Fig. 8: deviations at each indexing angle",
            "Left what the paper draws, the deviations of the steps; right the curve that they "
            "add "
            "up to. Bands and whiskers: U, k = 2, from the circle of the stations.",
            draw_deviations(found.result, np.array(TABLE_3_ARCSEC)),
        ),
    )


@style.house_style
def draw_path(targets: Floats) -> str:
    """Draw the way through the ``targets`` (n, 3) m from above and from the side."""
    above, side = style.grid(1, 2)
    mm = targets / MILLIMETRE
    for ax, across, name in ((above, 1, "y"), (side, 2, "z")):
        ax.plot(mm[:, 0], mm[:, across], "-", color=style.GREY, linewidth=0.8)
        ax.plot(mm[:, 0], mm[:, across], "o", color=style.BLUE, markersize=3)
        ax.plot(*mm[0, [0, across]], "s", color=style.ORANGE, markersize=6, label="A1")
        ax.set_xlabel("x / mm")
        ax.set_ylabel(f"{name} / mm")
        ax.set_aspect("equal")
    return style.svg(above)


@style.house_style
def draw_plane(motion: TableMotion, axial: Floats) -> str:
    """Draw the stations about their centre, and ``axial`` distances (m,) m from their plane."""
    above, residuals = style.grid(1, 2)
    x, y = motion.in_plane.T / MILLIMETRE
    around = np.linspace(0.0, 2.0 * np.pi, 181)
    radius = motion.radius / MILLIMETRE
    above.plot(radius * np.cos(around), radius * np.sin(around), color=style.GREY, linewidth=0.8)
    above.plot(x, y, "o", color=style.BLUE, markersize=4)
    for number, place in enumerate(zip(x, y, strict=True), start=1):
        above.annotate(f"P{number}", place, xytext=(4, 4), textcoords="offset points", fontsize=7)
    above.set_aspect("equal")
    above.set_xlabel("x / mm")
    above.set_ylabel("y / mm")
    numbers = np.arange(1, len(axial) + 1)
    residuals.bar(numbers, axial / MICROMETRE, 0.6, color=style.BLUE, label="from the plane")
    residuals.plot(
        numbers, motion.radial / MICROMETRE, "s", color=style.ORANGE, markersize=4,
        label="from the circle",
    )  # fmt: skip
    residuals.set_xlabel("station")
    residuals.set_ylabel("distance / µm")
    style.whole_numbers(residuals.xaxis)
    return style.svg(above)


@style.house_style
def draw_deviations(result: Result, printed: Floats) -> str:
    """Draw steps and curve of the ``result`` beside the ``printed`` steps (arcsec)."""
    assert result.adjacent_deviations is not None
    assert result.adjacent_std is not None
    steps, curve = style.grid(1, 2)
    numbers = np.arange(2, len(printed) + 2)
    steps.bar(
        numbers, result.adjacent_deviations / ARCSEC, 0.6,
        yerr=COVERAGE_FACTOR * result.adjacent_std / ARCSEC, color=style.BLUE, alpha=0.75,
        ecolor=style.INK, capsize=2, label="recomputed",
    )  # fmt: skip
    steps.plot(numbers, printed, "s", color=style.ORANGE, markersize=4, label="Table 3")
    steps.axhline(0.0, color=style.GREY, linewidth=0.8)
    steps.set_xlabel("station")
    steps.set_ylabel("deviation of the step / arcsec")
    style.whole_numbers(steps.xaxis)
    band = COVERAGE_FACTOR * result.std["ECC"] / ARCSEC
    angles = result.angles / DEGREE
    style.curve_with_band(
        curve, angles, result.deviations["ECC"] / ARCSEC, band, "ECC, with U (k = 2)"
    )
    style.angle_axis(curve, angles)
    curve.set_ylabel("ECC / arcsec")
    return style.svg(steps)
