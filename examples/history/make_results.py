"""Make the results of a small park of rotary tables, as five years of calibrations leave them.

usage: make_results.py FOLDER

Simulated: a table that stays as it is, one that drifts, one that was hit in 2024, and one whose
bearing goes bad.
"""

import sys
from pathlib import Path

import numpy as np

import rotcal_ros as rc
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.identity import Identity, InstrumentIdentity, Instruments

YEAR_NS = 365.25 * 86_400e9
BEGIN_NS = 1_609_459_200_000_000_000  # 2021-01-01
YEARS = np.linspace(0.0, 5.0, 11)
ANGLES = np.arange(24) * 2.0 * np.pi / 24
STD = 0.3 * rc.ARCSEC


def curve(table: str, year: float) -> np.ndarray:
    """Return the deviations ECC of a table, in arcsec."""
    found = 1.5 * np.cos(ANGLES - 0.4) + 0.5 * np.sin(2.0 * ANGLES)
    if table == "DRIFTS":
        found = found + 0.45 * year * np.cos(ANGLES)
    if table == "HIT" and year > 3.2:
        found = found + 2.5 * np.sin(ANGLES + 1.0)
    if table == "WEARS" and year > 2.5:
        found = found + 0.45 * (year - 2.5) ** 2 * np.cos(2.0 * ANGLES)
    return found


def main() -> None:
    """Write all results."""
    folder, rng = Path(sys.argv[1]), np.random.default_rng(1)
    folder.mkdir(parents=True, exist_ok=True)
    tracer = Instruments(tracer=InstrumentIdentity(serial="LT-17"))
    for table in ("STAYS", "DRIFTS", "HIT", "WEARS"):
        identity = Identity(serial=table, tolerance_arcsec=6.0, instruments=tracer)
        for year in YEARS:
            deviation = curve(table, year) * rc.ARCSEC + STD * rng.standard_normal(len(ANGLES))
            measured_ns = BEGIN_NS + round(year * YEAR_NS)
            result = rc.Result(
                method="tracer_multistation",
                angles=ANGLES,
                deviations={"ECC": deviation},
                std={"ECC": np.full(len(ANGLES), STD)},
                covariance={"ECC": STD**2 * np.eye(len(ANGLES))},
                sigma0=1.0,
                dof=50,
                n_observations=200,
                circumstances=Circumstances(
                    simulated=True, axis="C", identity=identity, begun_ns=measured_ns
                ),
            )
            (folder / f"{table}_{10 * year:02.0f}.json").write_text(result.to_json())


if __name__ == "__main__":
    main()
