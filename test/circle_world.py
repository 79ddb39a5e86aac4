"""A table and a polygon with errors of their own, and what one reads of the other; no solver."""

from pathlib import Path

import numpy as np

from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import changed, prepare, read_configuration

CONFIG = Path(__file__).parents[1] / "config" / "angle_comparison.yaml"
NOISE = 0.05
TURN = np.arange(0.0, 361.0, 30.0)
TWO, THREE, FOUR = (0, 30), (0, 30, 150), (0, 30, 90, 210)


class CircleWorld:
    """Deviations (arcsec) of some orders and of each face, by angles in degrees."""

    def __init__(self, seed, size=3.0):
        rng = self.rng = np.random.default_rng(seed)
        self.orders = {
            name: {k: size / 2.0 * rng.standard_normal(2) for k in orders}
            for name, orders in (("table", (1, 2, 3, 5)), ("reference", (1, 2, 4)))
        }
        self.face = 0.5 * size * rng.standard_normal(12)
        self.zero = 10.0 * rng.standard_normal(16)

    def _waves(self, name, degrees):
        at = np.radians(degrees)
        return sum(
            a * np.cos(k * at) + b * np.sin(k * at) for k, (a, b) in self.orders[name].items()
        )

    def table(self, degrees):
        return self._waves("table", degrees)

    def reference(self, degrees):
        face = self.face[np.round(np.asarray(degrees) / 30.0).astype(int) % 12]
        return self._waves("reference", degrees) + face

    @property
    def certificate(self):
        """True errors of the twelve faces, in the order of the angles shown."""
        return self.reference(TURN[:12])

    def read(self, shifts, noise=NOISE):
        """Return readings (settings, angles), arcsec, of a reference that really stood there."""
        exact = [
            self.table(TURN) - self.reference(TURN - shift) + zero
            for shift, zero in zip(shifts, self.zero, strict=False)
        ]
        return np.array(exact) + noise * self.rng.standard_normal((len(exact), len(TURN)))

    def error(self, result):
        """Return by how many u (n,) a result is off, but for its zero."""
        true = self.table(TURN) - self.table(0.0)
        std = result.std["ECC"] / ARCSEC
        off = np.abs(result.deviations["ECC"] / ARCSEC - true)
        return off[std > 0.0] / std[std > 0.0]


def stated(shifts, certificate=()):
    """Return a calibration of the demonstration with ``shifts`` and a certificate, arcsec."""
    values = [round(float(value), 6) for value in certificate]
    return prepare(
        changed(
            read_configuration(CONFIG),
            [
                f"plan.shifts_deg={[float(s) for s in shifts]}",
                f"solver.sigma_arcsec={NOISE}",
                f"solver.reference_errors_arcsec={values}",
            ],
        )
    )


def solved(calibration, readings):
    """Return the result of ``readings`` (settings, angles), arcsec."""
    return calibration.solve(
        step.observed((readings[step.station, step.table_position] * ARCSEC, 0.0, 0.0))
        for step in calibration.plan.steps
    )
