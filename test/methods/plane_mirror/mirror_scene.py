"""A measured cell with known truth: deviations of a few arcsec, seen the wanted way."""

from dataclasses import replace

import numpy as np
from mirror_cell import measure, measure_direct, paper_cell

from rotcal_ros.adjust.fit import fit_model
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.plane_mirror.solver import printed
from rotcal_ros.methods.plane_mirror.solver.model import TrackerModel
from rotcal_ros.methods.plane_mirror.solver.set_up import lay_out_points

PLACES = np.array([[0.3, 0.1, 0.1], [-0.2, 0.25, 0.15]])
"""Reflectors on the table, for the way "direct"."""


def measured(way, cell=None, rng=None, reflectors=1, **more):
    cell = paper_cell(reflectors=reflectors) if cell is None else cell
    deviations = np.zeros((len(cell.angles), 6))
    deviations[:, 5] = np.random.default_rng(5).normal(0.0, 5 * ARCSEC, len(cell.angles))
    if way == "direct":
        return measure_direct(cell, deviations, PLACES, rng=rng, **more)
    return measure(cell, deviations, rng=rng, way=way, **more)


def rows_of(problem, **wanted):
    """The rows whose position, station, kind or nest is the wanted one."""
    chosen = np.ones(len(problem.xyz), dtype=bool)
    for name, value in wanted.items():
        chosen &= getattr(problem, name) == value
    return np.flatnonzero(chosen)


def only(problem, rows):
    """The problem of some rows, a mask or in the order of their numbers."""
    names = ("position", "station", "kind", "nest", "xyz")
    return replace(problem, **{name: getattr(problem, name)[rows] for name in names})


def with_points(problem, changes):
    """The problem with other points in some rows."""
    xyz = problem.xyz.copy()
    for row, point in changes.items():
        xyz[row] = point
    return replace(problem, xyz=xyz)


def estimates(problem, points):
    """Deviations (t, N) of points (t, n, 3): by a printed way, or by least squares of each."""
    if problem.way != "joint":
        layout = lay_out_points(problem)[0]
        return printed.deviation_curve(layout, problem.way, points)
    return np.array([_least_squares(replace(problem, xyz=xyz)) for xyz in points])


def _least_squares(problem):
    model = TrackerModel.of(lay_out_points(problem)[0]).model()
    every = np.ones(len(model.observed), dtype=bool)
    return fit_model(model, every, model.std, model.first).value
