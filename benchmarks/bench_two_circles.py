"""Two circles against scipy's sparse solvers, and all that is said of 3600 angles.

Complete grids, a tenth of the readings missing, and a tenth of the angles: ``splu`` of the normal
equations, and ``lsmr`` to the last digits. Both sides run alternately, from the same design.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import resource
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product

import numpy as np
from racing import Row, race
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import lsmr, splu

from rotcal_ros.adjust.circles import CircularDesign
from rotcal_ros.adjust.engine import adjust
from rotcal_ros.adjust.fit import fit_model
from rotcal_ros.adjust.model import Model
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.angle_comparison.model import model_of, readings_of
from rotcal_ros.methods.angle_comparison.settings import (
    ComparisonPlanSettings,
    ComparisonSolverSettings,
)
from rotcal_ros.planning.readings import Readings

TRIALS = 1000


def measurement(angles: int, settings: int, kind: str) -> Model:
    """Noise of 1 arcsec on a circle of so many angles, settings one to so many steps apart."""
    step, random = 360.0 / angles, np.random.default_rng(1)
    shifts = tuple(step * (k * (k + 1) // 2) for k in range(settings))
    plan = ComparisonPlanSettings(table_positions=angles, table_step_deg=step, shifts_deg=shifts)
    if kind == "some angles":
        some = step * np.flatnonzero(random.uniform(size=angles) > 0.1)
        plan = replace(plan, table_angles_deg=tuple(some.tolist()))
    read = readings_of(plan)
    kept = random.uniform(size=len(read.value)) > 0.1 * (kind == "some readings")
    values = random.normal(0.0, ARCSEC, int(kept.sum()))
    read = Readings(
        read.position[kept], read.target[kept], read.station[kept], values, read.when[kept]
    )
    return model_of(plan, ComparisonSolverSettings(sigma_arcsec=1.0), read)


def opponents(model: Model) -> dict[str, Callable[[], np.ndarray]]:
    """Return scipy's ways to the outputs of a model."""
    design = model.equations(model.first)[1]
    rows = design.few if isinstance(design, CircularDesign) else csr_array(design)
    outputs, white = csr_array(np.asarray(model.every_output)), model.observed / model.std
    (table, marks, _), p = model.blocks.values(), rows.shape[1]
    free = np.delete(np.arange(p), [table, table + marks])  # a mark and a zero stand still

    def weighted() -> csr_array:
        data = rows.data / np.repeat(model.std, np.diff(rows.indptr))
        return csr_array((data, rows.indices, rows.indptr), shape=rows.shape)

    def by_splu() -> np.ndarray:
        some, x = csc_array(weighted())[:, free], np.zeros(p)
        x[free] = splu(csc_array(some.T @ some)).solve(some.T @ white)
        return outputs @ x

    def by_lsmr() -> np.ndarray:
        return outputs @ lsmr(weighted(), white, atol=1e-14, btol=1e-14, maxiter=10_000)[0]

    return {"splu": by_splu, "lsmr": by_lsmr}


def fits() -> Iterator[Row]:
    """Yield one fit against each of the opponents."""
    for kind, angles, settings in product(
        ("complete", "some readings", "some angles"), (36, 72, 180, 360), (4, 12)
    ):
        model = measurement(angles, settings, kind)
        every = np.ones(model.size[0], dtype=np.bool_)

        def ours(model: Model = model, every: np.ndarray = every) -> np.ndarray:
            return fit_model(model, every, model.std, model.first).value

        for name, other in opponents(model).items():
            a, b, difference = race(ours, other, (10, 10))
            yield Row(f"{kind}, {angles} x {settings}, {name}", a, b, b / a, difference)


def whole(angles: int, settings: int) -> Iterator[Row]:
    """Yield the whole adjustment, what is said of it, and trials: nothing to compare with."""
    begin = moment = time.process_time()

    def row(name: str, since: float) -> Row:
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
        name = f"{angles} x {settings}, {name}, peak {peak} MB"
        return Row(name, time.process_time() - since, None, None, None)

    found = adjust(measurement(angles, settings, "complete"))
    assert found.verdict == "ok"
    yield row("model, adjustment, verdict", moment)
    moment = time.process_time()
    found.protections()
    yield row("protections", moment)
    moment = time.process_time()
    found.trials(np.random.default_rng(1), TRIALS)
    yield row(f"{TRIALS} trials", moment)
    yield row("all of it", begin)


def rows() -> Iterator[Row]:
    """Run everything, one row after the other; memory first, for a peak stays."""
    yield from whole(3600, 4)
    yield from fits()


if __name__ == "__main__":
    for each in rows():
        print(each)
