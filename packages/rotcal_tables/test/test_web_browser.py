"""``rotcal web`` in Chromium: a table is dropped, understood, corrected, solved; for everybody."""

import base64
import json
import math
import re
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

import pytest
import uvicorn
from accessibility import assert_accessible, assert_reachable
from click.testing import CliRunner
from exports import DATA, EXPORTS, MM, lines
from test_files_of_instruments import rtl
from test_page_language import english_words

from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation.plugins import PLANS, names
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.page.app import listening_socket
from rotcal_tables.web import make_app

expect = pytest.importorskip("playwright.sync_api").expect

pytestmark = pytest.mark.slow

PATIENCE_MS = 60_000
DROP = """async ([name, content]) => {
  const bytes = Uint8Array.from(atob(content), (c) => c.charCodeAt(0));
  const transfer = new DataTransfer();
  transfer.items.add(new File([bytes], name));
  document.querySelector(".drop").dispatchEvent(
    new DragEvent("drop", { dataTransfer: transfer, bubbles: true, cancelable: true }));
}"""
FREE = "#tables, #command, #controller, #error, #language, #links, #warnings, td, option, .name"
"""Places with what the tables and the command line say."""


@contextmanager
def served(folder):
    """Serve the page; yield the address with its key."""
    listening = listening_socket("127.0.0.1", 0)
    port = listening.getsockname()[1]
    app = make_app(folder, port)
    server = uvicorn.Server(uvicorn.Config(app, log_level="warning", lifespan="off"))
    thread = Thread(target=server.run, args=([listening],), daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{port}/?key={app.key}"
    server.should_exit = True
    thread.join()


@pytest.fixture
def opened(chromium, tmp_path):
    """Return what opens the page; no script of it may fail, and it asks nobody else."""
    errors, asked = [], []
    with served(tmp_path) as address:

        def open_page(**options):
            page = chromium.new_page(**options)
            page.set_default_timeout(PATIENCE_MS)
            page.on("pageerror", lambda error: errors.append(str(error)))
            page.on("request", lambda request: asked.append(request.url))
            page.goto(address)
            page.wait_for_selector("#measurement .field")
            pages.append(page)
            return page

        pages = []
        yield open_page
        for page in pages:
            page.close()
    assert errors == []
    assert {re.match(r"\w+://[\d.]+", url)[0] for url in asked} == {"http://127.0.0.1"}


def drop(page, name, content):
    page.evaluate(DROP, [name, base64.b64encode(content).decode()])
    expect(page.locator("#files .there", has_text=name)).to_be_visible(timeout=PATIENCE_MS)


def dropped(page, name, content, positions="12"):
    """Drop a table of lengths with its targets; its numbers of positions are evenly so many."""
    count = page.locator("[id='set.plan.table_positions']")
    assert count.get_attribute("placeholder") in ("as in the table", "wie in der Tabelle", None)
    if positions and count.is_visible():
        count.fill(positions)
        count.press("Tab")
    drop(page, "targets.csv", (DATA / "targets.csv").read_bytes())
    drop(page, name, content)
    expect(page.locator("#understood[aria-busy=false]")).to_be_visible(timeout=PATIENCE_MS)


def solve(page):
    page.locator("#solve").click()
    expect(page.locator("#result")).to_be_visible(timeout=PATIENCE_MS)
    page.locator("#links a[href='/made/report.html']").wait_for()


def test_a_table_is_dropped_solved_and_taken_along(opened, tmp_path):
    page = opened(viewport={"width": 1280, "height": 1500}, locale="en-GB")
    EXPORTS["german_ansi.csv"](tmp_path / "export.csv")
    dropped(page, "laengen.csv", (tmp_path / "export.csv").read_bytes())
    first = page.locator("#tables .numbers tbody tr").first
    assert first.locator("td").all_inner_texts() == ["5", "0", "0", "0.3131669079"]
    expect(page.get_by_label("column that is length")).to_have_value("Gemessene Länge (mm)")
    solve(page)
    assert page.locator("#marks .mark").inner_text().startswith("Measurement: ok")
    expect(page.locator("#curve canvas")).to_be_visible()
    assert page.locator("#curve_words").inner_text().startswith("ECC at 12 angles from 288 ")
    with page.expect_popup() as report:
        page.get_by_role("link", name="Report", exact=True).click()
    expect(report.value.locator("h1")).to_be_visible(timeout=PATIENCE_MS)
    with page.expect_download() as taken:
        page.get_by_role("link", name="Set-up (YAML)").click()
    assert taken.value.path().read_text().startswith("# Laser tracer, multi-station")
    assert_accessible(page)
    assert_reachable(page)
    page.set_viewport_size({"width": 390, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") == 390


def test_deviations_become_a_controller_s_file_and_a_report(opened):
    """A stranger's way: drop, say the sign, see the curve, choose a controller, take it along."""
    page = opened(locale="en-GB")
    rows = "".join(f"{30 * n};{2.5 * n % 7 - 3:.1f}\n".replace(".", ",") for n in range(12))
    drop(page, "laser.csv", ("Winkel [°];Fehler [arcsec]\n" + rows).encode("cp1252"))
    expect(page.locator("#method")).to_have_value("deviations", timeout=PATIENCE_MS)
    page.get_by_role("button", name=re.compile("stands 3.5 arcsec too far")).click()
    noise = page.locator("[id='set.solver.u_arcsec']")
    noise.fill("0,5")
    noise.press("Tab")
    expect(page.locator("#solve")).to_be_enabled(timeout=PATIENCE_MS)
    solve(page)
    assert page.locator("#marks .mark").inner_text().startswith("Measurement: ok")
    expect(page.locator("#curve canvas")).to_be_visible()
    assert "nothing checked its values" in page.locator("#warnings").inner_text()
    page.locator("#controller").select_option("csv")
    page.locator("#in_force_replace").check()
    page.get_by_role("button", name="Write the files").click()
    with page.expect_download() as taken:
        page.get_by_role("link", name="c_csv.csv").click()
    rows = (line.split(",") for line in taken.value.path().read_text().splitlines())
    at_90 = next(row for row in rows if row[0].startswith("90"))
    assert float(at_90[1]) == pytest.approx(-(-2.5 - -3.0), abs=1e-4)  # counts from 0 degrees
    with page.expect_popup() as report:
        page.get_by_role("link", name="Report", exact=True).click()
    expect(report.value.locator("h1")).to_be_visible(timeout=PATIENCE_MS)
    assert "Deviations that are known already" in report.value.locator("body").inner_text()
    assert_accessible(page)


def rows_of(amplitude):
    """Return 12 angles and deviations, as a table whose names leave nothing open."""
    angles = [30 * n for n in range(12)]
    values = [amplitude * math.sin(math.radians(a)) + 0.05 * (-1) ** (a // 30) for a in angles]
    lines = (f"{a},{v:.3f}" for a, v in zip(angles, values, strict=True))
    return ("angle_deg,deviation_arcsec\n" + "\n".join(lines)).encode()


def test_a_second_table_says_whether_the_compensation_acts(opened, tmp_path):
    page = opened(locale="en-GB", viewport={"width": 1280, "height": 1500})
    drop(page, "before.csv", rows_of(20.0))
    expect(page.locator("#method")).to_have_value("deviations", timeout=PATIENCE_MS)
    page.locator("[id='set.solver.u_arcsec']").fill("0.3")
    solve(page)
    outcome = page.locator("#after_outcome")
    for amplitude, cause in ((0.0, "it acts"), (20.0, "inactive"), (40.0, "adds what it should")):
        page.set_input_files("#after", {
            "name": "after.csv", "mimeType": "text/csv", "buffer": rows_of(amplitude),
        })  # fmt: skip
        row = outcome.locator("tbody tr").nth(3)
        left = f"{amplitude - 0.05:.2f}"
        expect(row.locator("td").nth(2)).to_have_text(left, timeout=PATIENCE_MS)
        assert row.locator("td").all_inner_texts() == ["90", "19.95", left]
        assert cause in outcome.locator("li").first.inner_text()
        acts = outcome.locator(".mark").inner_text() == "The table acts"
        assert acts == (amplitude == 0.0)
    page.set_input_files("#after", {
        "name": "again.csv", "mimeType": "text/csv",
        "buffer": rows_of(0.0).replace(b"deviation_arcsec", b"error [arcsec]"),
    })  # fmt: skip
    page.locator("#after_error").get_by_role("button", name=re.compile("too far")).click()
    expect(outcome).to_contain_text("The table acts", timeout=PATIENCE_MS)
    assert_accessible(page)
    assert page.request.get(f"{page.url}made/result.json").ok


def test_a_question_is_answered_by_a_button_and_can_be_taken_back(opened):
    page = opened(color_scheme="dark", locale="en-GB")
    dropped(page, "lengths.csv", lines(("Position", "Target", "Length"), MM, ",").encode())
    expect(page.locator("#solve")).to_be_disabled()
    expect(page.locator("#error")).to_contain_text("states no unit")
    assert_accessible(page)
    page.get_by_role("button", name="574.172198 mm = 0.574172 m").click()
    expect(page.locator("#solve")).to_be_enabled(timeout=PATIENCE_MS)
    expect(page.get_by_label("unit of length")).to_have_value("mm")
    page.get_by_role("button", name="Take back: sheet.length_unit = mm").click()
    expect(page.locator("#error")).to_contain_text("states no unit", timeout=PATIENCE_MS)


def test_what_fits_is_advised_as_at_the_terminal(opened):
    if "advise" not in names(PLANS):
        pytest.skip("the package that advises is not installed")
    page = opened(locale="en-GB", viewport={"width": 1280, "height": 1500})
    page.get_by_text("Nothing measured yet?").click()
    listing = page.get_by_role("button", name="List the methods")
    page.get_by_label("polygon and autocollimator").check()
    listing.click()
    expect(page.locator("#advice_error")).to_contain_text("state a U", timeout=PATIENCE_MS)
    page.get_by_label("touch probe of the machine tool").check()
    page.get_by_label("ECC", exact=True).fill("2,5")
    page.get_by_label("How well the machine measures").fill("0.8")
    listing.click()
    ways = page.locator("#ways article")
    expect(ways).to_have_count(2, timeout=PATIENCE_MS)
    arguments = ("--own", "probe", "--own", "polygon", "--want", "ECC=2.5", "--machine-um", "0.8")
    asked = CliRunner().invoke(rotcal, ["plan", "advise", *arguments, "--json"])
    for shown, way in zip(ways.all(), json.loads(asked.stdout)["ways"], strict=True):
        assert shown.locator("h3").inner_text() == f"{way['title']} ({way['instrument']})"
        words, u = shown.locator("p").first.inner_text(), way["expanded"]["ECC"] / ARCSEC
        assert words.startswith("fits" if way["meets"] else "misses")
        assert f"{way['seconds'] / 60:.2f} min" in words
        assert f"U(ECC) {u:.2f} arcsec" in words
        assert ", ".join(way["untested"]) in shown.inner_text()
        assert shown.locator("code").inner_text() == way["command"]
    assert_accessible(page)


def test_all_that_a_laser_s_file_leaves_open_is_asked_together(opened):
    page = opened(locale="en-GB")
    drop(page, "laser.rtl", rtl().encode())
    expect(page.locator("#method")).to_have_value("deviations", timeout=PATIENCE_MS)
    groups = page.locator("#answers .buttons")
    expect(groups).to_have_count(3, timeout=PATIENCE_MS)
    expect(groups.nth(1).locator("p")).to_contain_text("'deviation' (deviation) states no unit")
    expect(groups.nth(2).locator("p")).to_contain_text("(if reading_unit=arcsec)")
    assert "--set" not in page.locator("#error").inner_text()
    assert_accessible(page)
    groups.nth(1).get_by_role("button", name="4.4 urad").click()
    expect(groups).to_have_count(2, timeout=PATIENCE_MS)
    groups.nth(1).get_by_role("button", name="stands 0.907565 arcsec too far").click()
    page.get_by_role("button", name="240 deg").click()
    expect(page.locator("#solve")).to_be_enabled(timeout=PATIENCE_MS)


def test_angles_of_a_table_count_where_no_plan_is_stated(opened):
    page = opened(locale="en-GB")
    table = Path(__file__).with_name("data").joinpath("lengths_5_degrees_on.csv").read_bytes()
    dropped(page, "lengths.csv", table, positions="")
    expect(page.locator("#tables")).to_contain_text("table angles of the table")
    expect(page.locator("#solve")).to_be_enabled()
    count = page.get_by_label("Number of table angles")
    count.fill("12")
    count.press("Tab")
    expect(page.locator("#error")).to_contain_text("5 degrees is not in the plan")
    assert_accessible(page)
    page.get_by_role("button", name="5 degrees, as the table says").click()
    expect(page.locator("#solve")).to_be_enabled(timeout=PATIENCE_MS)


def test_an_error_stands_at_its_field(opened):
    page = opened(locale="en-GB")
    dropped(page, "lengths.csv", (DATA / "lengths.csv").read_bytes())
    wrong = page.get_by_label("Standard deviation of one captured length, repeatability included")
    wrong.fill("much")
    wrong.press("Tab")
    expect(wrong).to_have_attribute("aria-invalid", "true", timeout=PATIENCE_MS)
    expect(wrong).to_have_accessible_description(re.compile("found 'much'"))
    wrong.fill("0,12")
    wrong.press("Tab")
    expect(wrong).to_have_attribute("aria-invalid", "false", timeout=PATIENCE_MS)
    solve(page)
    assert "length_std_m: 1.2e-07" in page.request.get(f"{page.url}made/setup.yaml").text()


def test_a_refusal_names_boxes_in_the_language_of_the_page(opened):
    page = opened(locale="de-DE")
    rows = "".join(f"{30 * n};{2.5 * n % 7 - 3:.1f}\n".replace(".", ",") for n in range(12))
    drop(page, "laser.csv", ("Winkel [°];Fehler [arcsec]\n" + rows).encode("cp1252"))
    expect(page.locator("#method")).to_have_value("deviations", timeout=PATIENCE_MS)
    page.get_by_role("button", name=re.compile("stands 3.5 arcsec too far")).click()
    expect(page.locator("#solve")).to_be_enabled(timeout=PATIENCE_MS)
    page.locator("#solve").click()
    noise = page.locator("[id='set.solver.u_arcsec']")
    expect(noise).to_have_attribute("aria-invalid", "true", timeout=PATIENCE_MS)
    label = page.locator("label[for='set.solver.u_arcsec']").inner_text()
    assert label.startswith("Standardmessunsicherheit")
    told = page.locator("#error_words").inner_text()
    assert label.lower() in told.lower()
    assert "--" not in told
    assert "setup.yaml" not in told
    noise.fill("0,5")
    noise.press("Tab")
    expect(page.locator("#solve")).to_be_enabled(timeout=PATIENCE_MS)
    page.locator("#solve").click()
    expect(page.locator("#marks .mark").first).to_be_visible(timeout=PATIENCE_MS)
    page.locator("#controller").select_option("csv")
    page.locator("#controller_form button").click()
    told = page.locator("#controller_error")
    box = page.locator("label[for=in_force_replace]").inner_text()
    expect(told).to_contain_text(box, timeout=PATIENCE_MS)
    assert "--" not in told.inner_text()


def test_instruments_that_are_not_shown_are_stated_too(opened):
    page = opened(locale="en-GB")
    page.evaluate("document.querySelectorAll('details').forEach((e) => { e.open = true; })")
    for kind in ("tracer", "machine"):
        page.locator("#instrument").select_option(kind)
        page.locator(f"[data-name='identity.instruments.{kind}.serial']").fill(f"of {kind}")
    dropped(page, "lengths.csv", (DATA / "lengths.csv").read_bytes())
    solve(page)
    text = page.request.get(f"{page.url}made/setup.yaml").text()
    assert "serial: of tracer" in text
    assert "serial: of machine" in text


def seen(page):
    """Return what stands in all fields of the page."""
    return page.evaluate(
        """() => [...document.querySelectorAll("main input, main select, main textarea")]
          .map((e) => `${e.id}=${e.type === "radio" ? e.checked : e.value}`)"""
    )


def test_what_was_stated_outlasts_a_reload_and_another_language(opened):
    page = opened(locale="en-GB")
    rows = [(p, t, "300.0", n) for p, t, n in MM]
    dropped(page, "mine.csv", lines(("Position", "Target", "Length", "Other"), rows, ",").encode())
    page.get_by_role("button", name="300 mm = 0.3 m").click()
    page.get_by_label("column that is length").select_option("Other")
    page.get_by_label("Take back: length = Other").wait_for()
    page.get_by_label("How it was measured").select_option("tracer_multistation")
    page.locator("[data-name='identity.serial']").fill("4711")
    page.evaluate(
        "document.querySelectorAll('details:not(#advice *)').forEach((e) => { e.open = true; })"
    )
    page.locator("#instrument").select_option("machine")
    solve(page)
    page.get_by_label("None: the new table replaces").check()
    page.get_by_label("Letter of the machine’s axis").fill("B")
    before = seen(page)
    assert {"set.identity.serial=4711", "axis=B", "in_force_replace=true"} <= set(before)
    for again in (page.reload, lambda: page.locator("#language").select_option("de")):
        again()
        expect(page.locator("#corrected button")).to_have_count(2, timeout=PATIENCE_MS)
        assert seen(page) == before
    dropped(page, "next.csv", lines(("Position", "Target", "Length"), MM, ",").encode())
    expect(page.locator("#corrected")).to_be_hidden(timeout=PATIENCE_MS)
    page.reload()
    expect(page.locator("#error")).to_contain_text("states no unit", timeout=PATIENCE_MS)
    expect(page.locator("#corrected")).to_be_hidden()


def test_a_refusal_is_shown_and_accepted_by_a_tick_for_that_reason_alone(opened):
    page = opened(locale="en-GB", color_scheme="dark")
    dropped(page, "lengths.csv", (DATA / "lengths.csv").read_bytes())
    page.get_by_label("Day of the measurement").fill("2020-03-31")
    solve(page)
    page.locator("#controller").select_option("fagor")
    page.get_by_label("None: the new table replaces").check()
    write = page.get_by_role("button", name="Write the files")
    write.click()
    old = page.get_by_label(re.compile("the measurement is .* days old"))
    expect(old).to_be_focused(timeout=PATIENCE_MS)
    expect(page.locator("#controller_error")).to_contain_text("does not belong here")
    assert_accessible(page)
    old.check()
    write.click()
    page.get_by_label(re.compile("not verified")).check()
    write.click()
    expect(page.locator("#controller_links a")).to_have_count(2, timeout=PATIENCE_MS)
    expect(page.locator("#controller_words")).to_contain_text("accepted by a person (age)")
    page.locator("#controller").select_option("csv")
    write.click()
    expect(old).not_to_be_checked(timeout=PATIENCE_MS)


def test_it_speaks_german(opened):
    page = opened(locale="de-DE")
    dropped(page, "lengths.csv", (DATA / "lengths.csv").read_bytes())
    solve(page)
    text = page.evaluate(
        """(free) => {
          document.querySelectorAll("details").forEach((e) => { e.open = true; });
          const named = [...document.querySelectorAll("[aria-label]")].map((e) => e.ariaLabel);
          document.querySelectorAll(free).forEach((e) => e.remove());
          return [document.body.innerText, ...named].join("\\n");
        }""",
        FREE,
    )
    words = set(re.findall(r"[a-zäöüß]{3,}", text.lower()))
    assert len(words) > 100
    assert words & english_words() == set()
