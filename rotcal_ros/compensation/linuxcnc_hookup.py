"""Whether the ini file of a LinuxCNC puts its tables into force as they are meant."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rotcal_ros.compensation.linuxcnc import load
from rotcal_ros.compensation.linuxcnc_ini import ENCODING, Ini
from rotcal_ros.compensation.linuxcnc_machine import Joint, joints_with_tables
from rotcal_ros.foundation.untrusted import read_bytes

LARGEST_TRIM_DEG = 1.0
"""Nobody compensates more; trims read as positions give angles of the whole travel."""


def hook_up(path: Path) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield every table that the machine of the ini file ``path`` loads, with what is wrong.

    Nothing for a machine without a table. Raises ConfigurationError when the ini file cannot be
    read or makes no sense.
    """
    ini = Ini.read(path)
    for joint in joints_with_tables(ini):
        assert joint.table_path is not None
        about = f"[{joint.section}] {joint.table_path.name}, type {joint.table_type}"
        yield about, tuple(_complaints(joint, joint.table_path))


def _complaints(joint: Joint, table: Path) -> Iterator[str]:
    if (count := joint.ini.count(joint.section)) > 1:
        yield f"{count} sections [{joint.section}]: LinuxCNC ignores all but the first"
    try:
        text = read_bytes(table).decode(ENCODING)
    except OSError as error:
        yield f"{table}: {error.strerror}: LinuxCNC does not start"
        return
    loaded = load(text, joint.table_type)
    lines = len(text.splitlines())
    if loaded.messages or lines != len(loaded.nominal_deg) or lines == 0:
        yield f"of {lines} lines LinuxCNC uses {len(loaded.nominal_deg)}"
    if len(loaded.nominal_deg) == 0:
        return
    largest = float(np.max(np.abs([loaded.forward_deg, loaded.reverse_deg])))
    if largest > LARGEST_TRIM_DEG:
        yield (
            f"read as type {joint.table_type} the largest trim is {largest:.4g} deg: "
            f"COMP_FILE_TYPE is {joint.table_type} and the table of another type"
        )
    if beyond := joint.beyond(float(loaded.nominal_deg[0]), float(loaded.nominal_deg[-1])):
        yield beyond
