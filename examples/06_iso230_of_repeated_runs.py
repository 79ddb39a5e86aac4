"""Repeated runs up and down after ISO 230-2: accuracy A, repeatability R, reversal B."""

from pathlib import Path

import rotcal_ros as rc

DATA = Path(__file__).parent / "data"

figures = rc.iso230(DATA / "runs.csv")
for name, (both, forward, reverse), _ in figures.summary():
    texts = ("-" if x is None else f"{x / rc.ARCSEC:.2f}" for x in (both, forward, reverse))
    print(f"{name:24s}", *(f"{text:>7s}" for text in texts), "arcsec")
print(f"mean reversal: {figures.mean_reversal / rc.ARCSEC:.2f} arcsec")
print(*figures.warnings or ["as many runs and targets as the standard requires"])
