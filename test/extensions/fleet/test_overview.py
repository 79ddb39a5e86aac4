"""The overview of many bags: what it counts, whom it names, and that 10,000 bags stay readable."""

import os
import re

import numpy as np
import pytest

pytest.importorskip("pyarrow")
pytest.importorskip("duckdb")
import pyarrow as pa
import pyarrow.parquet as parquet
from browser import launched

from rotcal_ros.extensions.fleet import overview
from rotcal_ros.extensions.fleet.overview import PAGE, bags_by_table, connected, write_overview
from rotcal_ros.extensions.fleet.results_dataset import _schema

pytestmark = pytest.mark.usefixtures("without_figures")

DAY_NS = 86_400 * 10**9
U = 1e-7


def bag(number, table="table", span=1e-6, session=None, verdict="ok", error=None, n=9):
    """Return the two rows of a bag whose ECC has a range of ``span`` rad and U of 2e-7 rad."""
    common = {
        "source": f"/bags/{table}/run_{number:06}", "table": table, "key": f"{number}",
        "session": f"{table} {number}" if session is None else session,
        "start": number * DAY_NS, "error": error, "warnings": "", "seconds": 1.0,
    }  # fmt: skip
    if error:
        return [common]
    common |= {"verdict": verdict, "verdict_line": verdict, "covered": True, "n_observations": n,
               "component": "ECC", "std": U}  # fmt: skip
    return [{**common, "angle_rad": a, "deviation": d} for a, d in ((0.0, 0.0), (1.0, span))]


def written(folder, *bags):
    folder.mkdir()
    rows = [row for one in bags for row in one]
    parquet.write_table(pa.Table.from_pylist(rows, _schema()), folder / "part-1.parquet")
    return folder


def read(dataset):
    with connected(dataset) as connection:
        return list(bags_by_table(connection))


def test_a_bag_far_from_the_others_of_its_table_is_an_alarm(tmp_path):
    spans = [1.0e-6, 1.1e-6, 0.9e-6, 1.05e-6, 0.95e-6, 2.0e-6]
    # The median is 1.025e-6, the median absolute deviation 0.075e-6: 3 sigma + U are 0.534e-6.
    bags = [bag(n, span=s) for n, s in enumerate(spans)]
    bags += [bag(n, "short", s) for n, s in enumerate([1e-6, 1e-6, 1e-6, 9e-6])]
    found = read(written(tmp_path / "d", *bags))
    assert [b.source[-1] for b in found if b.alarm] == ["5"]
    (span,) = found[-1].spans
    assert (span.range, span.u, span.jumps) == (2.0e-6, 2e-7, True)
    assert span.middle == pytest.approx(1.025e-6)
    nearer = [bag(n, span=s) for n, s in enumerate([*spans[:5], 1.55e-6])]
    assert not any(b.alarm for b in read(written(tmp_path / "e", *nearer)))


def test_of_a_recording_and_its_twins_the_one_with_most_observations_counts(tmp_path):
    bags = [
        bag(1, session="s", n=5),
        bag(2, session="s", n=9),
        bag(3, session=""),
        bag(4, session=""),
    ]
    dataset = written(tmp_path / "d", *bags)
    assert {b.source[-1]: b.twin_of[-1:] for b in read(dataset)} == {
        "1": "2", "2": "", "3": "", "4": ""
    }  # fmt: skip
    counts = write_overview(dataset, "", tmp_path / "overview.html")
    assert (counts.bags, counts.twins, counts.tables[0].bags) == (4, 1, 3)


def test_bad_bags_and_bad_verdicts_are_alarms(tmp_path):
    bags = [bag(1), bag(2, verdict="suspect"), bag(3, error="torn <b> & \\udc"), bag(4)]
    counts = write_overview(written(tmp_path / "d", *bags), "", tmp_path / "overview.html")
    assert [b.alarm for b, _ in counts.alarms] == ["verdict suspect", "torn <b> & \\udc"]
    assert "torn &lt;b&gt; &amp;" in (tmp_path / "overview.html").read_text()


def test_a_trend_is_drawn_to_scale_and_thinned():
    points = [overview.Point(n * DAY_NS, 1.0 + (n == 500), 0.0) for n in range(3000)]
    drawing = overview.drawn(points, "ECC")
    heights = [float(y) for y in re.findall(r'cy="([\d.]+)"', drawing)]
    assert len(heights) == 600
    floor, top = (float(re.findall(r"M70 ([\d.]+)H", drawing)[i]) for i in (0, 2))
    assert min(heights) == top
    assert max(heights) == pytest.approx((floor + top) / 2)


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    """The overview of 10,000 bags of 40 tables, every hundredth without a result."""
    folder = tmp_path_factory.mktemp("large")
    n = 10_000
    number = np.arange(n)
    missing = number % 100 == 7
    sources = [f"/bags/table_{i % 40:03}/run_{i:06}" for i in number]
    columns = {
        "source": sources, "table": [s.split("/")[2] for s in sources],
        "key": sources, "session": sources, "start": number * 3600 * 10**9,
        "error": np.where(missing, "is not an MCAP file", None), "warnings": [""] * n,
        "verdict": np.where(missing, None, "ok"), "verdict_line": np.where(missing, None, "ok"),
        "covered": np.ones(n, bool), "component": np.where(missing, None, "ECC"),
        "deviation": np.zeros(n), "std": np.full(n, U), "n_observations": np.ones(n, int),
    }  # fmt: skip
    arrays = [
        pa.array(columns[field.name], field.type) if field.name in columns
        else pa.nulls(n, field.type)
        for field in _schema()
    ]  # fmt: skip
    (folder / "d").mkdir()
    parquet.write_table(
        pa.Table.from_arrays(arrays, schema=_schema()), folder / "d" / "part-1.parquet"
    )
    counts = write_overview(folder / "d", "solver: {}", folder / "overview.html")
    assert (counts.bags, counts.bad, len(counts.tables)) == (n, 100, 40)
    return folder


@pytest.mark.slow
@pytest.mark.slow
def test_every_bag_is_on_one_page_and_no_page_is_large(large):
    pages = list((large / "overview").glob("table-*.html"))
    assert len(pages) == 40 * -(-250 // PAGE)
    found = [s for page in pages for s in re.findall(r"<td>(/bags/\S+)</td>", page.read_text())]
    assert len(found) == len(set(found)) == 10_000
    assert max(path.stat().st_size for path in [*pages, large / "overview.html"]) < 300_000


def test_every_link_leads_to_a_page(large):
    pages = [large / "overview.html", *(large / "overview").glob("*.html")]
    links = {
        (page.parent / link).resolve()
        for page in pages
        for link in re.findall(r'href="([^"#:]+\.html)"', page.read_text())
    }
    assert all(link.is_file() for link in links)
    assert links >= {page.resolve() for page in pages if page.name.startswith("table-")}


@pytest.mark.slow
def test_a_reader_searches_and_pages_in_a_browser_without_a_request_elsewhere(large):
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as library:
        browser = launched(library)
        page = browser.new_page(viewport={"width": 1200, "height": 900})
        requests, errors = [], []
        page.on("request", lambda request: requests.append(request.url))
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto((large / "overview.html").as_uri())
        assert not any("bags.js" in url for url in requests)  # read when it is needed
        page.fill("#words", "table_003 run_0000")
        page.wait_for_function("document.getElementById('count').textContent !== ''")
        assert page.inner_text("#count") == "3 of 10000 bags"  # 3, 43 and 83
        page.fill("#words", "")
        page.select_option("#standing", "no")
        page.wait_for_function("document.getElementById('count').textContent.startsWith('100 ')")
        assert page.locator("#found tr").count() == 100
        page.locator("#found a").first.click()
        page.wait_for_url("**/overview/table-*.html")
        assert page.locator("svg").count() == 1
        page.get_by_text("later").first.click()
        page.wait_for_url("**/overview/table-*-2.html")
        assert not errors
        assert all(url.startswith("file://") for url in requests)
        if screenshot := os.environ.get("ROTCAL_SCREENSHOTS"):
            page.go_back()
            page.screenshot(path=f"{screenshot}/table.png")
            page.goto((large / "overview.html").as_uri())
            page.fill("#words", "table_003 run_0000")
            page.wait_for_function("document.getElementById('count').textContent !== ''")
            page.screenshot(path=f"{screenshot}/overview.png")
        browser.close()
