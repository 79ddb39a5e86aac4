"""Takes the pictures of the pages in docs/figures, with Debian's Chromium.

usage: python scripts/page_screenshots.py [NAME ...]     all of them, or those that are named
"""

from __future__ import annotations

import io
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty
from subprocess import PIPE, Popen

from PIL import Image
from playwright.sync_api import Browser, Page, expect, sync_playwright

from rotcal_ros.sessions.processes import Processes
from rotcal_ros.sessions.running import RunningSession, run_processes
from rotcal_ros.sessions.session import Session, prepare_session

ROOT = Path(__file__).parents[1]
FIGURES = ROOT / "docs" / "figures"
TIMEOUT_MS = 120_000
COLOURS = 200
DESK, WALL = (1280, 860), (3840, 2160)
WEB = "page_web"
"""The page of rotcal web, for which nothing is calibrated."""
SIX = ("plan.table_positions=12",)


@dataclass(frozen=True)
class Scene:
    """A calibration with its page; ``page`` looks at it."""

    session: Session
    nodes: RunningSession
    page: Page

    def text(self, place: str, words: str) -> None:
        """Wait until a place of the page has words."""
        expect(self.page.locator(place)).to_contain_text(words)

    def steps(self, count: int) -> None:
        """Wait for a step."""
        script = "n => parseInt(document.getElementById('step').textContent) >= n"
        self.page.wait_for_function(script, arg=count)


@dataclass(frozen=True)
class Shot:
    """A picture: what is calibrated, what has to happen before, and how it is looked at."""

    configuration: str
    until: Callable[[Scene], None]
    size: tuple[int, int] = DESK
    changes: tuple[str, ...] = ()


def measuring(scene: Scene) -> None:
    """Wait until a good part of the curve is there."""
    scene.steps(92)
    expect(scene.page.locator("#curve canvas")).to_be_visible()


def person(scene: Scene) -> None:
    """Wait for the second place, so that something has been measured."""
    scene.page.get_by_role("button", name="Continue").click()
    scene.text("#headline", "Fix the tracer at place 2")


def confirm(scene: Scene) -> None:
    """Wait for the table that the bridge offers."""
    scene.text("#headline", "A table waits for your confirmation")
    expect(scene.page.locator("#offer_chart canvas")).to_be_visible()


def lost_node(scene: Scene) -> None:
    """Kill the capture."""
    scene.steps(20)
    _kill(scene, "capture")
    scene.text("#headline", "ended without a result")
    lost = scene.page.locator('#nodes li:has(.name:text-is("capture"))')
    expect(lost).to_contain_text("silent")


def lost_page(scene: Scene) -> None:
    """Kill the page."""
    scene.steps(40)
    _kill(scene, "operator_page")
    scene.text("#lost", "Connection lost at")


def _kill(scene: Scene, name: str) -> None:
    processes: Processes = scene.nodes._processes
    processes.children[name].kill()


def bridge(folder: Path) -> tuple[str, ...]:
    """Return the settings of a bridge to a controller that is a folder."""
    (folder / "controller").mkdir()
    secret = folder / "secret"
    secret.write_text("only for this picture\n")
    secret.chmod(0o600)
    return (
        "bridge.controller=linuxcnc",
        "bridge.spacing_deg=10.0",
        "bridge.combine=replace",  # it is not stated what the simulated control holds
        f"bridge.controller_folder={folder / 'controller'}",
        f"bridge.secret_file={secret}",
    )


SHOTS = {
    "page_measuring": Shot("tracer_demo", measuring),
    "page_measuring_wall": Shot("tracer_demo", measuring, size=WALL),
    "page_person": Shot("tracer_six_demo", person, changes=SIX),
    "page_confirm": Shot("ball_plate_demo", confirm),
    "page_lost_node": Shot("tracer_demo", lost_node),
    "page_lost_page": Shot("tracer_demo", lost_page),
}


def take_web(browser: Browser, folder: Path) -> None:
    """Drop the sample lengths, as a German program exports them, and write the picture."""
    metres = (ROOT / "examples" / "data" / "lengths.csv").read_text().splitlines()[1:]
    rows = [line.replace(",", ";").replace(".", ",") for line in metres]
    table = folder / "laengen.csv"
    table.write_text("\n".join(("Tischposition;Ziel;Länge", *rows)) + "\n", encoding="utf-8")
    command = (sys.executable, "-m", "rotcal_ros.cli.main", "web", "--no-browser")
    with Popen(command, stdout=PIPE, text=True) as serving:
        assert serving.stdout is not None
        page = browser.new_page(viewport={"width": DESK[0], "height": DESK[1]}, locale="en-GB")
        page.set_default_timeout(TIMEOUT_MS)
        page.goto(serving.stdout.readline().strip())
        for place, path in enumerate((table, ROOT / "examples" / "data" / "targets.csv")):
            page.locator("#files li").nth(place).locator("input").set_input_files(path)
            expect(page.locator("#files .there")).to_have_count(place + 1)
        page.get_by_role("button", name="0.3131669079 m =").click()
        expect(page.get_by_label("unit of length")).to_have_value("m")
        page.locator("#solve").click()
        expect(page.locator("#links a[href*=report]")).to_be_visible()
        page.evaluate("document.querySelector('#understood').scrollIntoView()")
        _keep(page.screenshot(), FIGURES / f"{WEB}.png", DESK[0])
        page.close()
        serving.send_signal(signal.SIGINT)


def take(browser: Browser, name: str, shot: Shot, folder: Path) -> None:
    """Run a calibration until it is as the picture needs it, and write the picture."""
    changes = (*shot.changes, *(bridge(folder) if shot.until is confirm else ()))
    session = prepare_session(ROOT / "config" / f"{shot.configuration}.yaml", folder / "cell",
                              changes)  # fmt: skip
    width, height = shot.size
    cell: AbstractContextManager[RunningSession] = run_processes(
        replace(session, shown_by=("page",))
    )
    with cell as nodes:
        page = browser.new_page(viewport={"width": width, "height": height}, color_scheme="light")
        page.set_default_timeout(TIMEOUT_MS)
        page.goto(_address(nodes))
        shot.until(Scene(session, nodes, page))
        page.wait_for_timeout(1000)
        _keep(page.screenshot(), FIGURES / f"{name}.png", width)
        page.close()


def _address(nodes: RunningSession) -> str:
    """Return the address of the page, which the client prints once it is there."""
    deadline = time.monotonic() + TIMEOUT_MS / 1e3
    while time.monotonic() < deadline:
        with suppress(Empty):
            event = nodes.events.get(timeout=0.1)
            if event["event"] == "page":
                return str(event["address"])
    raise TimeoutError("no page")


def _keep(picture: bytes, path: Path, width: int) -> None:
    """Write a picture in few colours; that of a wall at a third of its size."""
    image = Image.open(io.BytesIO(picture)).convert("RGB")
    if width > DESK[0]:
        image = image.resize((DESK[0], round(image.height * DESK[0] / width)))
    image.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
        path, optimize=True
    )
    print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1e3:.0f} kB")


def main() -> None:
    """Take the pictures that are named, or all."""
    chromium = shutil.which("chromium")
    if chromium is None:
        sys.exit("Chromium is not installed: apt install chromium")
    expect.set_options(timeout=TIMEOUT_MS)
    arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=arguments)
        for name in sys.argv[1:] or (*SHOTS, WEB):
            with tempfile.TemporaryDirectory() as folder:
                if name == WEB:
                    take_web(browser, Path(folder))
                else:
                    take(browser, name, SHOTS[name], Path(folder))
        browser.close()


if __name__ == "__main__":
    main()
