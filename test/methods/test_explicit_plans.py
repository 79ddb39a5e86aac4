"""Plans that list their own targets and pairs, in a configuration or in tables beside it."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from rotcal_ros.foundation.errors import ConfigurationError, DataError, PlanError
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import changed, parse_configuration, prepare_to_measure, read_configuration
from rotcal_ros.methods.measurements import read_measurements
from rotcal_ros.methods.tracer.table import read_pairs, write_pairs, write_targets

DEMO = Path(__file__).parents[2] / "config" / "tracer_paper.yaml"
M = 11
ALONG = M - 3
"""What the plane of the stations tells of their error motion along the axis."""
rng = np.random.default_rng(4)
TARGETS = [tuple(point) for point in rng.uniform([-0.6, -0.5, 0.4], [0.6, 0.5, 1.0], (14, 3))]
PAIRS = [
    (int(j), int(i))
    for j in rng.permutation(M)
    for i in rng.choice(len(TARGETS), 8, replace=False)
]


def written(folder, plan="targets_file: targets.csv  # where\n      pairs_file: pairs.csv"):
    """Return a configuration file of the demonstration with an explicit plan, and its tables."""
    write_targets(folder / "targets.csv", TARGETS)
    write_pairs(folder / "pairs.csv", PAIRS)
    text = DEMO.read_text()
    head, tail = text.index("      box_centre_m"), text.index("    capture:")
    (folder / "cell.yaml").write_text(f"{text[:head]}      {plan}\n{text[tail:]}")
    return folder / "cell.yaml"


def test_the_steps_are_those_of_the_tables(tmp_path):
    plan = prepare_to_measure(read_configuration(written(tmp_path))).plan
    assert [(step.table_position, step.target) for step in plan.steps] == PAIRS
    assert [step.position for step in plan.steps] == [TARGETS[i] for _, i in PAIRS]
    angles = np.radians(-145.0 + 30.0 * np.array([j for j, _ in PAIRS]))
    np.testing.assert_allclose([step.table_angle for step in plan.steps], angles)


def test_the_text_holds_the_tables_and_all_else_as_it_was(tmp_path):
    path = written(tmp_path)
    configuration = read_configuration(path)
    for name in ("targets.csv", "pairs.csv"):
        (tmp_path / name).unlink()
    again = parse_configuration(configuration.text)
    assert again.plan == configuration.plan
    assert again.plan_id == configuration.plan_id
    assert again.plan.targets_m == tuple(np.array(TARGETS).ravel())
    plain, whole = (yaml.safe_load(text) for text in (path.read_text(), configuration.text))
    for document in (plain, whole):
        document["/**"]["ros__parameters"].pop("plan")
    assert whole == plain
    lines = path.read_text().splitlines()
    kept = [line for line in lines if "_file:" not in line]
    assert [line for line in configuration.text.splitlines() if line in kept] == kept
    assert max(map(len, configuration.text.splitlines())) < 110


def test_another_table_is_another_plan(tmp_path):
    path = written(tmp_path)
    before = read_configuration(path).plan_id
    write_pairs(tmp_path / "pairs.csv", PAIRS[::-1])
    assert read_configuration(path).plan_id != before


def test_lists_stand_in_the_configuration_as_well(tmp_path):
    pairs = np.array(PAIRS).ravel().tolist()
    flat = f"{{table_positions: 11, targets_file: targets.csv, pairs: {pairs}}}"
    path = written(tmp_path)
    text = path.read_text()
    head, tail = text.index("    plan:"), text.index("    capture:")
    path.write_text(f"{text[:head]}    plan: {flat}\n{text[tail:]}")
    plan = prepare_to_measure(read_configuration(path)).plan
    assert [(step.table_position, step.target) for step in plan.steps] == PAIRS


def test_a_change_may_name_a_table(tmp_path):
    configuration = read_configuration(written(tmp_path))
    with pytest.raises(ConfigurationError, match=r"pairs_file: plan\.pairs is given as well"):
        changed(configuration, ["plan.pairs_file=pairs.csv"])
    path = written(tmp_path, "targets_file: targets.csv")
    configuration = changed(read_configuration(path), ["plan.pairs_file=pairs.csv"])
    assert len(prepare_to_measure(configuration).plan.steps) == len(PAIRS)


def test_its_lengths_are_solved(tmp_path):
    calibration = prepare_to_measure(read_configuration(written(tmp_path)))
    measured = calibration.measured({}, seed=3)
    result = calibration.solve(measured.observations)
    assert result.verdict == "ok"
    assert result.dof == len(PAIRS) - 4 * M + ALONG
    error = np.abs(result.deviations["ECC"])[1:] / result.std["ECC"][1:]
    assert error.max() < 4.0
    assert result.std["ECC"].max() < 3.0 * ARCSEC


@pytest.mark.parametrize(
    ("pairs", "words"),
    [
        ([*PAIRS, (11, 0)], r"step 88 .*there are table positions 0 to 10"),
        ([*PAIRS, (0, 14)], r"step 88 .*there are targets 0 to 13"),
        (PAIRS[:83], r"table position \d+ has 3 lengths, at least 4"),
    ],
    ids=["position", "target", "too few"],
)
def test_what_cannot_be_measured_is_refused(tmp_path, pairs, words):
    path = written(tmp_path)
    write_pairs(tmp_path / "pairs.csv", pairs)
    with pytest.raises(PlanError, match=words):
        prepare_to_measure(read_configuration(path))


def test_with_one_zero_for_all_fewer_lengths_are_enough(tmp_path):
    path = written(tmp_path)
    few = [pair for k, pair in enumerate(PAIRS) if k % 8 < 3 or k == 3]
    write_pairs(tmp_path / "pairs.csv", few)
    with pytest.raises(PlanError, match="1 stations with at least 4"):
        prepare_to_measure(read_configuration(path))
    shared = changed(read_configuration(path), ["solver.zero=per_segment"])
    calibration = prepare_to_measure(shared)
    result = calibration.solve(calibration.measured({}, seed=3).observations)
    assert result.dof == len(few) - 3 * M - 1 + ALONG == ALONG
    write_pairs(tmp_path / "pairs.csv", few[:-1])
    with pytest.raises(PlanError, match="has 2 lengths, at least 3"):
        prepare_to_measure(changed(read_configuration(path), ["solver.zero=per_segment"]))
    write_pairs(tmp_path / "pairs.csv", few[:3] + few[4:])
    with pytest.raises(PlanError, match="33 lengths from 11 stations are fewer than the 34"):
        prepare_to_measure(changed(read_configuration(path), ["solver.zero=per_segment"]))
    circle = ["solver.zero=per_segment", "solver.circle_std_m=7.0e-8"]
    write_pairs(tmp_path / "pairs.csv", [pair for k, pair in enumerate(PAIRS) if k % 8 < 2])
    calibration = prepare_to_measure(changed(read_configuration(path), circle))
    result = calibration.solve(calibration.measured({}, seed=3).observations)
    assert result.dof == 2 * M - 3 * M - 1 + 2 * (M - 3)


def test_a_pair_may_be_measured_several_times(tmp_path):
    """As a plan, from its observations, and from a table beside its targets."""
    path, pairs = written(tmp_path), [*PAIRS, *PAIRS[::3]]
    write_pairs(tmp_path / "pairs.csv", pairs)
    calibration = prepare_to_measure(read_configuration(path))
    assert [(s.table_position, s.target) for s in calibration.plan.steps] == pairs
    observations = calibration.measured({}, seed=3).observations
    result = calibration.solve(observations)
    assert result.rejected == ()
    assert result.dof == len(pairs) - 4 * M + ALONG
    once = calibration.solve(observations[: len(PAIRS)])
    assert (result.std["ECC"][1:] < once.std["ECC"][1:]).all()
    rows = [
        f"{o.table_position},{o.target},{o.mean[0]!r}"
        for o in sorted(observations, key=lambda o: o.table_position)
    ]
    table = tmp_path / "lengths.csv"
    table.write_text("\n".join(["position,target,length_m", *rows]) + "\n")
    tabled = read_measurements(table, read_configuration(path)).solve()
    assert tabled.deviations["ECC"] == pytest.approx(result.deviations["ECC"], abs=1e-12)
    table.write_text("\n".join(["position,target,length_m", *rows, rows[0], rows[0]]) + "\n")
    with pytest.raises(DataError, match="was measured already"):
        read_measurements(table, read_configuration(path))


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("0,0,0\n0,1,1\n", "step 0 is listed twice"),
        ("0,0,0\n2,1,1\n", "step 1 is missing"),
        ("0,0,x\n", "target must be a whole number"),
    ],
)
def test_a_wrong_table_is_named_with_its_setting(tmp_path, rows, words):
    path = written(tmp_path)
    (tmp_path / "pairs.csv").write_text("step,table_position,target\n" + rows)
    with pytest.raises(ConfigurationError, match=rf"cell\.yaml: plan\.pairs_file: .*{words}"):
        read_configuration(path)


def test_rows_are_ordered_by_their_step(tmp_path):
    (tmp_path / "p.csv").write_text("step,table_position,target\n1,3,4\n0,5,6\n")
    assert read_pairs(tmp_path / "p.csv") == (5, 6, 3, 4)


def test_a_text_without_a_place_has_no_tables(tmp_path):
    with pytest.raises(ConfigurationError, match="give targets_m instead"):
        parse_configuration(written(tmp_path).read_text())


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        ("targets_m: [1.0, 2.0]", "targets_m has 2 numbers"),
        ("pairs: [0, 1, 2]", "pairs has 3 numbers"),
        ("{targets_file: targets.csv, targets_m: [0.0, 0.0, 1.0]}", "keep one of them"),
        ("targets_file: [a, b]", "expected the name of a file"),
        ("targets_file: none.csv", "cannot read the table"),
    ],
)
def test_impossible_settings_are_named(tmp_path, plan, words):
    path = written(tmp_path)
    text = path.read_text()
    head, tail = text.index("    plan:"), text.index("    capture:")
    plan = plan if plan.startswith("{") else f"\n      {plan}"
    path.write_text(f"{text[:head]}    plan: {plan}\n{text[tail:]}")
    with pytest.raises(ConfigurationError, match=words):
        read_configuration(path)


def test_repeated_runs_do_not_go_with_pairs(tmp_path):
    configuration = changed(read_configuration(written(tmp_path)), ["plan.runs=2"])
    with pytest.raises(PlanError, match="do not go with explicit pairs"):
        prepare_to_measure(configuration)
