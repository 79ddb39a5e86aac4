"""docs/formats.md has the columns of plain tables as the methods read them."""

from pathlib import Path

from rotcal_ros.methods import find_method
from rotcal_ros.methods.plane_mirror import method as plane_mirror
from rotcal_ros.methods.tracer import table as tracer
from rotcal_ros.methods.tracer_six import method as tracer_six


def test_the_page_of_formats_has_the_columns_that_are_read():
    page = (Path(__file__).parents[1] / "docs" / "formats.md").read_text("utf-8")
    headers = [
        *tracer.HEADERS, *tracer.STATIONS, tracer.TARGETS, *tracer_six.HEADERS,
        plane_mirror.HEADER, plane_mirror.TIMED, *find_method("angle_comparison").table.headers,
        *find_method("table_balls").table.headers,
    ]  # fmt: skip
    rows = [row for row in page.splitlines() if row.startswith("|")]
    for header in headers:
        least, *more = [",".join(header), ",".join(header[:-1]), header[-1]]
        assert any(f"`{least}`" in row or all(f"`{m}`" in row for m in more) for row in rows), (
            header
        )
