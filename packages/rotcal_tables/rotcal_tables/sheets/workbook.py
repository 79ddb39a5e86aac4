"""A program of its own that reads a workbook from standard input, within bounds.

The library gives none: a cell far away makes it fill all the area up to it, and a text that many
cells share is copied for each. So it works here, where the system ends what takes too much, and
``files`` reads what comes out: lines of JSON, one a sheet: its name, the number of its first row,
and its rows. A time is a list of its text. Exit code 3: there are more cells or characters.
"""

import io
import json
import resource
import sys
from datetime import date, datetime, time, timedelta

MEMORY_BYTES = 1 << 30
WORK_S = 60
CELLS = 2_000_000
CHARACTERS = 50_000_000
TOO_MUCH = 3


def main() -> int:
    """Read the workbook and write its sheets; return the exit code."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (WORK_S, WORK_S))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    from python_calamine import CalamineError, CalamineWorkbook

    cells = characters = 0
    try:
        book = CalamineWorkbook.from_filelike(io.BytesIO(sys.stdin.buffer.read()))
        for name in book.sheet_names:
            sheet = book.get_sheet_by_name(name)
            rows = []
            for row in sheet.to_python(skip_empty_area=True):
                rows.append([_plain(value) for value in row])
                cells += len(row)
                characters += sum(len(value) for value in row if isinstance(value, str))
                if cells > CELLS or characters > CHARACTERS:
                    return TOO_MUCH
            first = sheet.start[0] + 1 if sheet.start else 1
            sys.stdout.write(json.dumps([name, first, rows]) + "\n")
    except MemoryError:
        return TOO_MUCH
    except (CalamineError, OSError, ValueError) as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


def _plain(value: object) -> object:
    """Return a cell as JSON has it: a number, a text, or a list of the text of a time."""
    if isinstance(value, time):
        value = timedelta(
            hours=value.hour, minutes=value.minute, seconds=value.second,
            microseconds=value.microsecond,
        )  # fmt: skip
    elif isinstance(value, date) and value.year <= 1900:  # hours beyond a day, shown as a date
        moment = value if isinstance(value, datetime) else datetime(*value.timetuple()[:3])
        value = moment - datetime(1899, 12, 31)
    if isinstance(value, timedelta):
        seconds, micro = divmod(abs(value) // timedelta(microseconds=1), 1_000_000)
        part = f".{micro:06}".rstrip("0") if micro else ""
        sign = "-" if value < timedelta(0) else ""
        return [f"{sign}{seconds // 3600}:{seconds // 60 % 60:02}:{seconds % 60:02}{part}"]
    if isinstance(value, datetime | date):
        return value.isoformat()
    if isinstance(value, bool):
        return str(value)
    return value if isinstance(value, int | float | str) else ""


if __name__ == "__main__":
    sys.exit(main())
