"""Every command and every snippet of the pages runs, or says why not; see snippets.py."""

import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

import pytest
import yaml
from snippets import PAGES, PYTHON, ROOT, SHELL, YAML, Block, blocks

import rotcal_ros as rc
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.methods.configuration import GROUPS
from rotcal_ros.methods.settings_reference import all_sections

pytestmark = pytest.mark.slow

DATA = ROOT / "examples" / "data"
GOLDEN = ROOT / "test" / "golden"
DEADLINE_S = 120.0
BLOCKS = [block for page in PAGES for block in blocks(page)]
RUN = [b for b in BLOCKS if b.kind in (SHELL, PYTHON)]
PAGES_THAT_RUN = [p for p in PAGES if any(b.page == p and b.to_run().strip() for b in RUN)]
INPUTS = {
    # What the pages call by a name of the reader's own: an example of what they mean.
    "BAG": GOLDEN / "ball_plate" / "bag",
    "OTHER.yaml": GOLDEN / "ball_plate" / "table" / "setup.yaml",
    "bags/one": GOLDEN / "ball_plate" / "bag",
    "lengths.csv": DATA / "lengths.csv",
    "older.json": DATA / "result_tracer.json",
    "out/a/bag": DATA / "ball_plate_bag",
    "out/a/result.json": DATA / "result_ball_plate.json",
    "out/b/result.json": DATA / "result_tracer.json",
    "out/ball_plate_demo/bag": DATA / "ball_plate_bag",
    "my_table.yaml": GOLDEN / "ball_plate" / "table" / "setup.yaml",
    "out/demo/bag": GOLDEN / "tracer_six" / "bag",
    "out/demo/result.json": DATA / "result_tracer.json",
    "points.csv": DATA / "tracker.csv",
    "result.json": GOLDEN / "tracer_six" / "result.json",
    "runs.csv": DATA / "runs.csv",
    "setup.yaml": DATA / "plane_mirror.yaml",
    "targets.csv": DATA / "targets.csv",
    "tracer.yaml": DATA / "tracer.yaml",
}


@pytest.fixture(scope="module")
def program(tmp_path_factory, warm):
    """Return a folder with ``rotcal`` and ``python`` of this checkout and environment."""
    folder = tmp_path_factory.mktemp("bin")
    for name in ("rotcal", "python"):
        (folder / name).write_text(warm.program(name))
        (folder / name).chmod(0o755)
    return folder


@pytest.fixture(scope="module")
def made():
    """Return texts by name: a second measurement of the table, and a reference for it."""
    again = rc.read_configuration(DATA / "tracer.yaml", "simulation.seed=2")
    second = rc.solve(rc.simulate_observations(again), again)
    truth = rc.simulated_truth(rc.read_configuration(DATA / "ball_plate.yaml"))["ECC"]
    rows = (f"{30 * k},{e / rc.ARCSEC:.3f},0.05" for k, e in enumerate(truth))
    return {
        "out/check/run/result.json": second.to_json(),
        "out/second/result.json": second.to_json(),
        "polygon.csv": "\n".join(["angle_deg,deviation_arcsec,u_arcsec", *rows, ""]),
    }


@pytest.fixture
def reader(tmp_path, program, made):
    """Return a function that runs a text of bash in a folder like the reader's."""
    for name in ("config", "docs", "examples", "research", "scripts"):
        shutil.copytree(ROOT / name, tmp_path / name)
    for name, source in INPUTS.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        copy = shutil.copytree if source.is_dir() else shutil.copy
        copy(source, tmp_path / name)
    for name, text in made.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    path = os.pathsep.join([str(program), os.environ["PATH"]])
    env = {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT), "HOME": str(tmp_path)}

    def run(text):
        return subprocess.run(
            ["bash", "-euo", "pipefail", "-c", text], cwd=tmp_path, env=env,
            capture_output=True, text=True, timeout=load_scaled_timeout(DEADLINE_S),
        )  # fmt: skip

    return run


@pytest.mark.parametrize("page", PAGES_THAT_RUN, ids=lambda p: str(p.relative_to(ROOT)))
def test_what_a_page_shows_runs(page, reader):
    for block in blocks(page):
        text = block.to_run()
        if block.kind == PYTHON and text:
            text = f"python - <<'PYTHON'\n{text}\nPYTHON"
        if block.kind in (SHELL, PYTHON) and text.strip():
            ran = reader(text)
            assert ran.returncode == 0, f"{block.place}:\n{text}\n{ran.stdout[-2000:]}{ran.stderr}"


@pytest.mark.parametrize("block", [b for b in BLOCKS if b.comments], ids=lambda b: b.place)
def test_a_block_that_does_not_run_says_why_or_where_it_does(block):
    for mark in block.marks():
        left = block.left_to(mark) if mark.lines else [block.text]
        assert left, f"{block.place}: no line begins with {mark.lines!r}"
        texts = [(ROOT / file).read_text() for file in mark.files]
        for name in configurations(left) if texts else ():
            assert any(name in text for text in texts), f"{block.place}: {name} in {mark.files}"


@pytest.mark.parametrize("block", [b for b in BLOCKS if b.kind == YAML], ids=lambda b: b.place)
def test_a_configuration_in_a_page_names_settings_that_exist(block):
    document = yaml.safe_load(block.text)
    groups = document.get("/**", {}).get("ros__parameters", document)
    known = {name for section in all_sections() for name, _ in section.settings()}
    for group in groups.keys() & set(GROUPS):
        for name in dotted(groups[group], group):
            assert any(f"{k}.".startswith(f"{name}.") or name == k for k in known), name


def test_the_comments_are_understood():
    def block(comment, text="rotcal run config/a.yaml\nrotcal solve b"):
        return Block(ROOT / "README.md", 1, SHELL, text, (comment,))

    assert block("a remark").marks() == ()
    assert block("not run: needs root").to_run() == ""
    assert block("lines `rotcal run` run by test/x.py").to_run() == "rotcal solve b"
    assert block("lines `rotcal run` run by test/x.py").marks()[0].files == ("test/x.py",)
    for comment in ("not run", "not run:", "run by", "not run because", "lines run by x"):
        with pytest.raises(ValueError, match="no reason"):
            block(comment).marks()


def test_blocks_are_found(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "text\n\n<!-- not run: no -->\n\n    rotcal solve a \\\n        --json\n"
        "    rotcal doctor\n"
        "\n* list\n\n    of two paragraphs\n\n```python\nimport rotcal_ros\n```\n\n    a = b c\n"
    )
    found = list(blocks(page))
    assert [(b.kind, b.line) for b in found] == [(SHELL, 5), (PYTHON, 13), ("", 17)]
    assert found[0].comments == ("not run: no",)
    assert found[0].commands() == ["rotcal solve a \\\n    --json", "rotcal doctor"]


def configurations(commands):
    """Return the names of the configurations that commands take, without their suffix."""
    words = (word for command in commands for word in command.partition(" #")[0].split())
    return {Path(word).stem for word in words if word.startswith("config/")}


def dotted(values, prefix):
    """Yield the names of nested settings: plan.plate.grid."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from dotted(value, f"{prefix}.{name}")
        else:
            yield f"{prefix}.{name}"
