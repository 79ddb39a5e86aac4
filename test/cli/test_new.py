"""``rotcal new``: a set-up that every verb reads, with the meaning of all that it states."""

import shutil
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

import rotcal_ros as rc
from rotcal_ros.cli.main import rotcal

DATA = Path(__file__).parents[2] / "examples" / "data"
PLATE = (
    "--method=ball_plate", "--positions=24", "--set=plan.plate.ball_steps=[0, 3, 4, 9, 14, 20]",
    "--set=plan.plate.circle_radius_m=0.185", "--set=plan.plate.ball_diameter_m=0.02",
)  # fmt: skip
NESTS = "--set=plan.nests_m=[[1, 0, 0], [0, 1, 0], [0, 0, 1]]"
BY_METHOD = {
    "tracer_multistation": ("--method=tracer_multistation", "--positions=36"),
    "tracer_six": ("--method=tracer_six", "--positions=36"),
    "ball_plate": PLATE,
    "plane_mirror": ("--method=plane_mirror", "--positions=36", NESTS),
}


def run(*arguments, answers=None):
    words = ["new", *map(str, arguments)]
    return CliRunner().invoke(rotcal, words, prog_name="rotcal", input=answers)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("method", BY_METHOD)
def test_a_set_up_of_every_method_is_read_again_and_is_not_simulated(here, method):
    done = run(*BY_METHOD[method], "--yes", "--set=identity.serial=007")
    assert done.exit_code == 0, done.output
    assert done.stdout == "rotcal solve measurements.csv --setup setup.yaml\n"
    made = rc.read_configuration("setup.yaml")
    assert (made.method.name, made.simulated, made.identity.serial) == (method, False, "007")
    if method == "ball_plate":
        assert (made.plan.plate.grid, made.plan.measure) == (24, "centre")
    else:
        assert (made.plan.table_positions, made.plan.table_step_deg) == (36, 10.0)
    entries = yaml.safe_load(Path("setup.yaml").read_text())
    assert {"identity", "air"} < entries.keys()
    assert not {"simulation", "plan", "/**"} & entries.keys()


def test_every_setting_has_its_meaning_above_it(here):
    run("--yes", "--set=solver.length_std_m=3e-8", "--set=cell.axis=B")
    lines = Path("setup.yaml").read_text().splitlines()
    at = lines.index("length_std_m: 3.0e-08")
    assert lines[at - 1] == (
        "# m, standard deviation of one captured length, repeatability included"
    )
    assert lines[lines.index("  axis: B") - 1].startswith("  # ")
    settings = [i for i, line in enumerate(lines) if ": " in line and "#" not in line]
    bare = [lines[i] for i in settings if not lines[i - 1].lstrip().startswith("#")]
    assert not [line for line in bare if not line.startswith("method: ")]
    assert max(map(len, lines)) <= 98


def test_a_plain_table_is_solved_with_it_and_counts_as_measured(here):
    for name in ("lengths.csv", "targets.csv"):
        shutil.copy(DATA / name, here)
    done = run("--positions=12", "--yes", "--set=solver.length_std_m=1.2e-7", "-o", "own.yaml")
    assert done.exit_code == 0
    known = rc.read_table(DATA / "lengths.csv", DATA / "tracer.yaml").solve()
    result = rc.read_table("lengths.csv", "own.yaml").solve()
    assert not result.simulated
    apart = abs(result.deviations["ECC"] - known.deviations["ECC"])
    assert apart.max() < 0.5 * known.std["ECC"].max()  # of one the error motion is estimated


def test_the_columns_of_a_table_say_the_method_where_one_alone_fits(here):
    (here / "runs.csv").write_text("position,setting,reading_rad\n0,0,1e-6\n1,0,2e-6\n")
    done = run("runs.csv", "--positions=12", "--yes", "-o", "own.yaml")
    assert done.exit_code == 0, done.output
    assert yaml.safe_load(Path("own.yaml").read_text())["method"] == "angle_comparison"
    assert "rotcal solve runs.csv --setup own.yaml" in done.stdout
    (here / "open.csv").write_text("a,b\n1,2\n")
    asked = run("open.csv", "--yes", "-o", "other.yaml")
    assert asked.exit_code == 2
    assert "state it by --method" in asked.stderr
    assert not Path("other.yaml").exists()


def test_what_is_not_given_is_asked_for_until_it_can_be(here):
    answers = ["", "x", "18", "", "", "", "", "", "3e-8", "", "my table", "4711", "hall", "A. B."]
    done = run("--method=tracer_multistation", answers="\n".join([*answers, "2026-03-31", ""]))
    assert done.exit_code == 0, done.output
    assert "Error: plan.table_positions: expected int" in done.stderr
    assert "step between table angles [20]" in done.stderr
    made = rc.read_configuration("setup.yaml")
    assert (made.plan.table_positions, made.plan.table_step_deg) == (18, 20.0)
    assert made.plan.table_start_deg == 0.0
    assert (made.solver.length_std_m, made.solver.target_std_m) == (3e-8, 1e-6)
    assert (made.identity.item, made.identity.serial) == ("my table", "4711")
    assert made.identity.measured == "2026-03-31"


def test_a_bad_date_is_asked_for_again(here):
    """By its type it is any text: it was refused when all had been answered."""
    answers = [""] * 13 + ["yesterday", "31.3.2026", "2026-03-31", ""]
    done = run("--method=tracer_multistation", answers="\n".join(answers))
    assert done.exit_code == 0, done.output
    assert done.stderr.count("is not a date: expected one like 2026-03-31 or") == 2
    assert rc.read_configuration("setup.yaml").identity.measured == "2026-03-31"


def test_explicit_angles_take_the_place_of_steps(here):
    done = run("--yes", "--set=plan.table_angles_deg=[0, 10, 35, 100]")
    assert done.exit_code == 0
    text = Path("setup.yaml").read_text()
    assert "table_angles_deg: [0.0, 10.0, 35.0, 100.0]" in text
    assert "table_step_deg" not in text


def test_nothing_is_overwritten(here):
    Path("setup.yaml").write_text("mine")
    refused = run("--yes")
    assert (refused.exit_code, "not overwritten" in refused.stderr) == (2, True)
    assert Path("setup.yaml").read_text() == "mine"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--method=tracer_sixx"], "did you mean 'tracer_six'"),
        (["--set=plan.tabel_positions=3"], "did you mean 'plan.table_positions'"),
        (["--set=plan.table_positions=many"], "plan.table_positions: expected int"),
        (["--set=simulation.seed=3"], "a set-up has no setting 'simulation.seed'"),
        (["--method=ball_plate"], "--set plan.plate.grid=... --set plan.plate.ball_steps=..."),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_written(here, arguments, words):
    refused = run(*arguments, "--yes")
    assert refused.exit_code == 2
    assert words in refused.stderr
    assert not list(here.iterdir())


def test_a_set_up_that_lacks_something_is_kept_and_told(here):
    refused = run("--method=plane_mirror", "--yes")
    assert refused.exit_code == 2
    assert "cannot be used yet" in refused.stderr
    assert "plan.nests_m" in refused.stderr
    assert Path("setup.yaml").exists()
