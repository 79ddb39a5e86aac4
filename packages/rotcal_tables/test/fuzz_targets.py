"""What ``make fuzz`` reads of this package: files of instruments, counts, names of points."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import texts_harmed as texts
from targets import Target

from rotcal_ros.foundation.table_columns import SheetSettings
from rotcal_tables.sheets.reading import READER

POINTS: Final = (("position", "ball", "x_m", "y_m", "z_m"),)
PAIRS: Final = (("position", "deviation_rad"),)


def _read_points(path: Path) -> None:
    READER.read(path, POINTS, SheetSettings(names="P{position}_N{ball}"), dict)


def _read_pairs(path: Path) -> None:
    READER.read(path, PAIRS, SheetSettings(counts_per_turn=400, counter="16"), dict)


DMIS: Final = b"UNITS/MM,ANGDEC\n" + b"".join(
    b"FA(P%d_N%d)=FEAT/SPHERE,OUTER,CART,1.5,%d,3.25,30.001\n" % (p, n, p)
    for p in range(3)
    for n in range(2)
)
COUNTS: Final = b"commanded [deg],encoder [counts]\n" + b"".join(
    b"%d,%d\n" % (36 * k, 40 * k) for k in range(10)
)
TARGETS: Final = (
    Target("points/p.dmo", lambda: [DMIS], texts.harmed_lines, _read_points),
    Target("counts/c.csv", lambda: [COUNTS], texts.harmed_csv, _read_pairs),
)
