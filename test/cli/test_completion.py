"""What the shell offers when Tab is pressed: names that exist, and at once."""

import os
import shutil
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import pytest
from click.testing import CliRunner

from rotcal_ros.cli.main import rotcal, verbs

ROOT = Path(__file__).parents[2]
HEAVY = {"numpy", "scipy", "rich", "matplotlib", "mcap", "rclpy", "yaml", "rotcal_ros.methods"}
SCRIPT = """
import sys
from rotcal_ros.cli.main import rotcal
try:
    rotcal(prog_name="rotcal")
except SystemExit as end:
    assert end.code == 1  # what click's scripts for the shells expect
print(*sys.modules, file=sys.stderr)
"""
SHELLS = ("bash", "zsh", "fish")


def asked(line, folder=ROOT, shell="bash"):
    """Return what is offered behind ``line``, and the modules that were loaded for it."""
    words = line.split()
    place = len(words) - (not line.endswith(" "))
    last = "" if line.endswith(" ") else words[-1]
    env = {
        "_ROTCAL_COMPLETE": f"{shell}_complete",
        "COMP_WORDS": line,
        "COMP_CWORD": last if shell == "fish" else str(place),
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
    }
    ran = subprocess.run(
        [sys.executable, "-c", SCRIPT], cwd=folder, env=env, capture_output=True, text=True
    )
    return ran.stdout, set(ran.stderr.split())


def offered(line, folder=ROOT):
    """Return the words that bash is offered."""
    return [entry.partition(",")[2] for entry in asked(line, folder)[0].splitlines()]


def test_it_knows_the_verbs():
    assert offered("rotcal ") == list(verbs())
    assert offered("rotcal so") == ["solve"]
    assert offered("rotcal --d") == ["--debug"]


def test_it_knows_the_verbs_below_plan():
    assert offered("rotcal plan re") == ["reliability"]


@pytest.mark.parametrize("before", ["export bag", "verify config/verify_demo.yaml"])
def test_it_knows_the_controllers(before):
    assert offered(f"rotcal {before} --to li") == ["linuxcnc"]


def test_it_knows_the_methods_and_no_other():
    core = (
        "angle_comparison", "ball_plate", "plane_mirror", "table_balls", "tracer_multistation",
        "tracer_six",
    )  # fmt: skip
    beside = entry_points(group="rotcal_ros.methods").names  # of packages that are installed
    assert offered("rotcal settings ") == sorted({*core, *beside})


@pytest.mark.slow
@pytest.mark.parametrize(
    "before", ["run", "verify", "solve table.csv --setup", "reprocess bags --setup"]
)
def test_it_knows_the_configurations(before, tmp_path):
    (tmp_path / "config").mkdir()
    for name in ("mine.yaml", "config/a.yaml", "config/b.txt", ".hidden.yaml"):
        (tmp_path / name).touch()
    assert offered(f"rotcal {before} ", tmp_path) == ["mine.yaml", "config/a.yaml"]
    assert offered(f"rotcal {before} conf", tmp_path) == ["config/a.yaml"]
    assert offered(f"rotcal {before} config/", tmp_path) == ["config/a.yaml"]
    assert offered(f"rotcal {before} mi", tmp_path) == ["mine.yaml"]


def test_where_there_is_no_configuration_the_shell_looks_itself(tmp_path):
    assert asked("rotcal run ", tmp_path)[0] == "file,\n"


@pytest.mark.parametrize(
    "line", ["rotcal ", "rotcal run ", "rotcal export bag --to ", "rotcal settings "]
)
def test_it_loads_nothing_that_takes_time(line):
    assert not asked(line)[1] & HEAVY


@pytest.mark.parametrize("shell", SHELLS)
def test_each_shell_gets_a_script_and_its_own_form(shell):
    script = CliRunner().invoke(rotcal, env={"_ROTCAL_COMPLETE": f"{shell}_source"},
                                prog_name="rotcal").output  # fmt: skip
    assert f"_ROTCAL_COMPLETE={shell}_complete" in script
    form = {"bash": "plain,solve\n", "zsh": "plain\nsolve\n", "fish": "plain,solve\t"}[shell]
    assert asked("rotcal sol", shell=shell)[0].startswith(form)


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
def test_the_line_of_the_documentation_works_in_bash(tmp_path):
    program = tmp_path / "rotcal"
    program.write_text(f"#!{sys.executable}\nfrom rotcal_ros.cli.main import main\nmain()\n")
    program.chmod(0o755)
    line = 'eval "$(_ROTCAL_COMPLETE=bash_source rotcal)"'
    assert line in (ROOT / "docs" / "command_line.md").read_text()
    pressed = (
        f"{line}\nCOMP_WORDS=(rotcal exp); COMP_CWORD=1\n"
        "_rotcal_completion rotcal exp rotcal 2>/dev/null; echo ${COMPREPLY[*]}"
    )
    ran = subprocess.run(
        ["bash", "--norc", "-c", pressed], capture_output=True, text=True, cwd=tmp_path,
        env={"PATH": f"{tmp_path}:/usr/bin:/bin", "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert ran.stdout.split() == ["export"]
