"""Tables of our own form from their text, read as files are."""

from pathlib import Path
from tempfile import TemporaryDirectory

from rotcal_ros.foundation.tables import read_table


def table_in(text, name="table.csv"):
    """Return the table in ``text``."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_text(text, encoding="utf-8")
        return read_table(path)
