"""Figures of the ball plate method: plate, machine, and residuals by ball and position.

Vectors are drawn radial, tangential (counter-clockwise) and along the axis at their place on
the ball circle.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import DEGREE, MICROMETRE, MILLIMETRE
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.figures import Figure, style
from rotcal_ros.methods.result_tables import ResultTable, by_axis

_DIRECTIONS: Final = ("radial", "tangential", "axial")
_COLOURS: Final = (style.BLUE, style.ORANGE, style.GREEN)


def figures(result: Result, _truth: Mapping[str, Any] | None = None) -> list[Figure]:
    """Return the figures that only this method can fill."""
    if not {"groups", "residual_rows", "grid"} <= result.details.keys():
        return []
    return [
        Figure(
            "Set-up in plan view",
            "Balls on the plate at table angle zero, and the positions of the table at which they "
            "were touched, from above.",
            set_up(result),
            "set-up",
        ),
        Figure(
            "Errors of the plate",
            "Place of each ball on the plate less its nominal place, with k = 2: manufacture and "
            "clamping. Mean radius, and the plate's shift, tilt and turn in the mean, are partly "
            "a matter of definition (docs/ball_plate.md).",
            plate_errors(result),
        ),
        Figure(
            "Errors of the machine",
            "Systematic error of the coordinate measuring machine at each measuring position, "
            "with k = 2.",
            machine_errors(result),
        ),
        Figure(
            "Residuals by ball and position",
            "Observed − computed per ball, over the table position (left) and over the measuring "
            "position (right). A column or a row that stands out names a table position, a "
            "machine position or a ball; crosses were rejected.",
            residual_maps(result),
            "residuals",
        ),
        Figure(
            "Normalised residuals",
            "Test value of each centre in the order of measurement; a rejected one is a cross.",
            centre_tests(result),
            "residuals",
        ),
    ]


@style.house_style
def set_up(result: Result) -> str:
    """Draw the circle of the balls about the axis with the grid of table positions, to scale."""
    radius = float(result.details["radius"]) / MILLIMETRE
    (ax,) = style.grid(height=4.6)
    turn, grid = np.linspace(0.0, 2.0 * np.pi, 181), int(result.details["grid"])
    ax.plot(radius * np.cos(turn), radius * np.sin(turn), color=style.GREY, linewidth=0.9)
    for number, group in enumerate(result.details["groups"]):
        steps = np.asarray(group["ball_steps"])
        at = 2.0 * np.pi * steps / grid
        stops = 2.0 * np.pi * np.asarray(group["cmm_positions"]) / grid
        rays = np.array([0.25, 0.95]) * radius
        for angle in stops:
            ax.plot(rays * np.cos(angle), rays * np.sin(angle), color=style.MISSING, linewidth=0.8)
        x, y = radius * np.cos(at), radius * np.sin(at)
        label = "" if number else "balls, by grid step"
        ax.plot(x, y, "o", color=style.BLUE, markersize=7, label=label)
        for step, point in zip(steps.tolist(), zip(x, y, strict=True), strict=True):
            ax.annotate(str(step), point, xytext=(7, 5), textcoords="offset points")
    ax.plot(0.0, 0.0, "+", color=style.INK, markersize=10, label="axis of the table")
    ax.set_aspect("equal")
    ax.margins(0.12)
    ax.set_xlabel("x / mm")
    ax.set_ylabel("y / mm")
    return style.svg(ax)


@style.house_style
def plate_errors(result: Result) -> str:
    """Draw the plate errors of every ball as bars with k = 2 whiskers."""
    (ax,) = style.grid(height=3.0)
    for number, group in enumerate(result.details["groups"]):
        steps = np.asarray(group["ball_steps"])
        angle = 2.0 * np.pi * steps / int(result.details["grid"])
        values = _local(np.asarray(group["plate_errors"]), angle) / MICROMETRE
        band = COVERAGE_FACTOR * _local_std(np.asarray(group["plate_errors_std"]), angle)
        place = np.arange(len(steps)) + number * (len(steps) + 1)
        for i, (name, colour) in enumerate(zip(_DIRECTIONS, _COLOURS, strict=True)):
            ax.bar(
                place + 0.27 * (i - 1), values[:, i], 0.25, yerr=band[:, i] / MICROMETRE,
                color=colour, ecolor=style.INK, capsize=1.5, label="" if number else name,
            )  # fmt: skip
    labels = [step for group in result.details["groups"] for step in [*group["ball_steps"], ""]]
    ax.set_xticks(np.arange(len(labels) - 1), [str(label) for label in labels[:-1]])
    ax.axhline(0.0, color=style.GREY, linewidth=0.8)
    ax.set_xlabel("ball (grid step)")
    ax.set_ylabel("plate error / µm")
    return style.svg(ax)


@style.house_style
def machine_errors(result: Result) -> str:
    """Draw the machine's errors over the angle of the measuring position with k = 2 bands."""
    panels = style.grid(3, 1, height=1.7, sharex=True)
    for group in result.details["groups"]:
        angle = 2.0 * np.pi * np.asarray(group["cmm_positions"]) / int(result.details["grid"])
        values = _local(np.asarray(group["cmm_errors"]), angle) / MICROMETRE
        band = COVERAGE_FACTOR * _local_std(np.asarray(group["cmm_errors_std"]), angle)
        place = angle / DEGREE
        for i, ax in enumerate(panels):
            style.curve_with_band(ax, place, values[:, i], band[:, i] / MICROMETRE, "")
            ax.set_ylabel(phrase("{0} / µm", phrase(_DIRECTIONS[i])))
    label = "measuring position on the ball circle / °"
    style.angle_axis(panels[-1], np.array([0.0, 360.0]), label)
    return style.svg(panels[0])


@style.house_style
def residual_maps(result: Result) -> str:
    """Draw radial, tangential and axial residuals as maps by ball and both kinds of position."""
    rows, more = result.residuals, result.details["residual_rows"]
    if rows is None or not len(rows.target):
        return ""
    cmm = np.asarray(more["cmm_index"], dtype=np.int64)
    grid = int(result.details["grid"])
    vectors = _local(np.asarray(more["vector"], dtype=np.float64), 2.0 * np.pi * cmm / grid)
    vectors /= MICROMETRE
    largest = float(np.quantile(np.abs(vectors[rows.used]), 0.999)) if rows.used.any() else 1.0
    balls, ball = np.unique(rows.target, return_inverse=True)
    panels = style.grid(3, 2, height=0.9 + 0.14 * len(balls), sharex="col", sharey=True)
    for i, name in enumerate(_DIRECTIONS):
        for ax, position in zip(panels[2 * i :], (rows.table_position, cmm), strict=False):
            count = max(grid, int(position.max()) + 1)  # more where both sides were measured
            image = np.full((count, len(balls)), np.nan)
            image[position, ball] = vectors[:, i]
            ax.grid(visible=False)
            ax.set_facecolor(style.MISSING)
            ax.imshow(
                image.T, cmap="RdBu_r", vmin=-largest, vmax=largest, aspect="auto",
                interpolation="nearest",
            )  # fmt: skip
            style.whole_numbers(ax.xaxis)
            ax.plot(
                position[~rows.used], ball[~rows.used], "x", color=style.INK, markersize=6,
                markeredgewidth=1.4,
            )  # fmt: skip
        panels[2 * i].set_ylabel(phrase("{0}: ball", phrase(name)))
        panels[2 * i].set_yticks(np.arange(len(balls)), [str(step) for step in balls], fontsize=6)
    panels[-2].set_xlabel("table position")
    panels[-1].set_xlabel("measuring position")
    figure = panels[0].figure
    figure.colorbar(panels[0].images[0], ax=panels, label="residual / µm", shrink=0.5)
    return style.svg(panels[0])


@style.house_style
def centre_tests(result: Result) -> str:
    """Draw the test value of every centre in the order of measurement."""
    rows = result.residuals
    if rows is None or not len(rows.target):
        return ""
    (ax,) = style.grid(height=2.2)
    order = np.asarray(result.details["residual_rows"]["row"])
    ax.plot(order[rows.used], rows.test_value[rows.used], ".", color=style.BLUE, markersize=3)
    if not rows.used.all():
        height = np.zeros(int((~rows.used).sum()))
        ax.plot(order[~rows.used], height, "x", color=style.RED, label="rejected", clip_on=False)
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("row, in the order of measurement")
    ax.set_ylabel("test value")
    return style.svg(ax)


def _local(vectors: Floats, angles: Floats) -> Floats:
    """Turn x, y, z (n, 3) into radial, tangential, axial at ``angles`` (n,)."""
    return np.asarray((rotation_about_z(-angles) @ vectors[:, :, None])[:, :, 0])


def _local_std(std: Floats, angles: Floats) -> Floats:
    """Turn standard deviations of x, y, z (n, 3) likewise; x and y count as uncorrelated."""
    return np.asarray(np.sqrt((rotation_about_z(-angles) ** 2 @ std[:, :, None] ** 2)[:, :, 0]))


def tables(result: Result) -> list[ResultTable]:
    """Return the errors of balls and machine, and the residuals by ball and position."""
    if not {"groups", "residual_rows"} <= result.details.keys():
        return []
    found, groups = [], result.details["groups"]
    # groups count their balls anew, and live in turned frames: their tables would mislead
    for group in groups if len(groups) == 1 else ():
        places = "Places of the balls, less their nominal ones"
        for name, title, key, steps in (
            ("balls", places, "plate_errors", "ball_steps"),
            ("machine", "Errors of the machine", "cmm_errors", "cmm_positions"),
        ):
            errors, std = (np.asarray(group[k]) / MICROMETRE for k in (key, f"{key}_std"))
            columns = by_axis("{}_um", errors) | by_axis("U_{}_um", COVERAGE_FACTOR * std)
            found.append(ResultTable.of(name, title, step=group[steps], **columns))
    rows, residuals = result.details["residual_rows"], result.residuals
    if residuals is None:
        return found
    vector = np.asarray(rows["vector"], dtype=np.float64) / MICROMETRE
    order = np.argsort(np.asarray(rows["row"]))
    centres = ResultTable.of(
        "residuals",
        "Residuals of the ball centres",
        row=np.asarray(rows["row"])[order],
        position=residuals.table_position[order],
        ball_step=residuals.target[order],
        **by_axis("{}_um", vector[order]),
        test_value=residuals.test_value[order],
        used=["yes" if used else "no" for used in residuals.used[order]],
    )
    return [*found, centres]
