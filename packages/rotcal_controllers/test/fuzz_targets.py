"""What ``make fuzz`` reads of this package: settings of machines."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import texts_harmed as texts
from targets import Target

from rotcal_controllers.fanuc import Fanuc
from rotcal_controllers.machine_files import MachineData, PunchedParameters
from rotcal_controllers.twincat import TwinCat


def _data(path: Path) -> None:
    data = MachineData.read(str(path))
    axis = data.axis("C1")
    for name in ("MA_BACKLASH", "MA_ENC_COMP_ENABLE"):
        data.number(name, f"0,{axis}")


def _punched(path: Path) -> None:
    found, axis = PunchedParameters.read(str(path)), Fanuc().axis_number
    found.number(1851, axis)
    found.bit(3605, axis, 0)


def _list(path: Path) -> None:
    TwinCat(machine_file=str(path)).for_axis("C")


ARCHIVE: Final = b'N10000 $MN_AXCONF_MACHAX_NAME_TAB[4]="C1"\nN32450 $MA_BACKLASH[0,AX5]=0.002\n'
PUNCHED: Final = b"%\nN01851Q1A1P4A4P0\nN03605Q1A1P00000000A4P00000001\n%\n"
LIST: Final = b"getriebe[0].lose 1000 #backlash\nlr_param.anwahl_losekomp 1\n"
TARGETS: Final = (
    Target("archive/a.ini", lambda: [ARCHIVE], texts.harmed_lines, _data),
    Target("punched/p.txt", lambda: [PUNCHED], texts.harmed_lines, _punched),
    Target("axislist/a.lis", lambda: [LIST], texts.harmed_lines, _list),
)
