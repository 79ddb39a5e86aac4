"""The frames that messages of the cell are stamped with."""

from typing import Final

TABLE: Final = "table_base"
MACHINE: Final = "machine"
TRACER: Final = "tracer"
