"""What ``make fuzz`` reads of this package: the file of a goal."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import texts_harmed as texts
from targets import Target

from rotcal_design.goal import goal_settings


def _read_goal(path: Path) -> None:
    goal_settings(None, path, ["need_arcsec=1.0"])


TARGETS: Final = (
    Target("goal/g.yaml", lambda: [b"need_arcsec: 1.2\nlargest_arcsec: 2.5\nkeep_out_m: []\n"],
           texts.harmed_yaml, _read_goal),
)  # fmt: skip
