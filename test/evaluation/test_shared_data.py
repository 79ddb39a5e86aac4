"""Results that rest on the same observations: known, counted once, or refused.

The worlds are drawn here, in plain numpy; how two evaluations vary together is taken from many
draws of their noise.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chances import LONG
from circle_world import NOISE, THREE, CircleWorld
from circle_world import solved as solved_circles
from circle_world import stated as stated_circles
from coded import coded
from hypothesis import given
from hypothesis import strategies as st

import rotcal_ros as rc
from rotcal_ros.evaluation.combination import CombinationInput
from rotcal_ros.evaluation.compare import TOO_ALIKE, compare
from rotcal_ros.evaluation.joint import combine
from rotcal_ros.foundation.curves.measured import measured_curve
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.foundation.raw_data import MOST_INFLUENCES, Influence, RawData
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods import changed, prepare
from rotcal_ros.methods.configuration import read_configuration
from rotcal_ros.methods.measurements import read_measurements

TAU = 2.0 * np.pi
SLACK = 0.2 if LONG else 0.4
DATED_NS = 10**17
EXAMPLES = Path(__file__).parents[2] / "examples" / "data"


def observation(step, position, angle, target, values, std, when_ns=0, kind=PointKind.REFLECTOR):
    return Observation(
        step=step, attempt=0, table_position=position, table_angle=angle, target=target, station=0,
        kind=kind, mean=tuple(values), std=(std,) * len(values), scatter=(std,) * len(values),
        probe_position=(0.0, 0.0, 0.0), n_samples=10, n_used=10, accepted=True, reason="",
        table_angle_measured=angle, temperature_c=20.0, window_start_ns=when_ns,
        window_end_ns=when_ns + 10**8 * bool(when_ns),
    )  # fmt: skip


class Tracer:
    """A tracer on a table that turns a little wrong, and a machine whose targets are a bit off."""

    def __init__(self):
        configuration = read_configuration(EXAMPLES / "tracer.yaml")
        self.calibration = prepare(changed(configuration, ("solver.error_motion_std_m=0.0",)))

    def observations(self, rng, begun_ns=0):
        plan = self.calibration.plan
        nominal = np.array(plan.targets)
        targets = nominal + rng.normal(0.0, 0.85e-6, nominal.shape)
        ecc = 2e-5 * np.sin(np.array(plan.table_angles) + 0.3)
        found = []
        for k, step in enumerate(plan.steps):
            angle = step.table_angle + ecc[step.table_position]
            arm = np.array([0.0569, -0.0318])
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            station = np.array([*(turn @ arm), 0.1225])
            length = np.linalg.norm(targets[step.target] - station) - 0.4
            reported = nominal[step.target]
            seen = observation(
                step.index, step.table_position, step.table_angle, step.target,
                [length + rng.normal(0.0, 0.12e-6)], 0.0, begun_ns and begun_ns + 10**9 * k,
            )  # fmt: skip
            found.append(replace(seen, probe_position=tuple(reported.tolist())))
        return found

    def solve(self, observations, *changes):
        configuration = changed(self.calibration.configuration, changes)
        return replace(self.calibration, configuration=configuration).solve(observations)


@pytest.fixture(scope="module")
def tracer():
    return Tracer()


def plate_calibration():
    return prepare(
        changed(
            read_configuration(EXAMPLES / "ball_plate.yaml"), ("solver.sigma_centre_m=0.0000002",)
        )
    )


def centres(calibration, rng):
    """Noise about exact places of the balls: the table, the CMM and the plate have no errors."""
    plate = calibration.configuration.plan.plate
    found = []
    for step in calibration.plan.steps:
        angle = TAU * (step.table_position + step.target) / plate.grid
        place = plate.circle_radius_m * np.array([np.cos(angle), np.sin(angle), 0.0])
        measured = place + np.array(calibration.configuration.plan.centre_m)
        values = measured + rng.normal(0.0, 0.2e-6, 3)
        found.append(
            observation(
                step.index,
                step.table_position,
                step.table_angle,
                step.target,
                values.tolist(),
                0.2e-6,
                kind=PointKind.CENTRE,
            )
        )
    return found


def both_ways(pairs):
    """Return mean chi2 / dof of differences, and that of the same taken for independent."""
    told, apart = [], []
    for first, second in pairs:
        curves = [measured_curve(r) for r in (first, second)]
        found = compare(*curves)
        told.append(found.chi2 / found.dof)
        alone = [replace(c, raw_data=RawData()) for c in curves]
        apart.append((lambda c: c.chi2 / c.dof)(compare(*alone)))
    return np.mean(told), np.mean(apart)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "fewer_targets", "changes", "slack"),
    [(24, True, (), SLACK), (25, False, ("solver.variant=station",), 1.25 * SLACK)],
)
def test_evaluations_of_the_same_lengths_vary_together_as_their_noise_says(
    tracer, seed, fewer_targets, changes, slack
):
    rng, pairs = np.random.default_rng(seed), []
    for _ in range(60 if LONG else 12):
        every = tracer.observations(rng)
        some = [o for o in every if o.target % 3] if fewer_targets else every
        pairs.append((tracer.solve(every), tracer.solve(some, *changes)))
    told, apart = both_ways(pairs)
    assert told == pytest.approx(1.0, abs=slack)  # 60 x 11 contrasts: 0.055 as one std, and slack
    assert apart < 0.5


@pytest.mark.slow
def test_half_of_the_balls_vary_together_with_all_as_their_noise_says():
    rng = np.random.default_rng(26)
    calibration = plate_calibration()
    balls = sorted({step.target for step in calibration.plan.steps})
    fewer = f"solver.balls={balls[: len(balls) - 1]}"
    less = replace(calibration, configuration=changed(calibration.configuration, (fewer,)))
    pairs = []
    for _ in range(60 if LONG else 12):
        seen = centres(calibration, rng)
        pairs.append((calibration.solve(seen), less.solve(seen)))
    told, apart = both_ways(pairs)
    assert told == pytest.approx(1.0, abs=SLACK)
    assert apart < 0.6


def test_evaluations_of_one_table_do_not_lower_the_uncertainty(tracer):
    every = tracer.observations(np.random.default_rng(1))
    some = [o for o in every if o.target % 3]
    inputs = {
        "joint": tracer.solve(every),
        "by station": tracer.solve(every, "solver.variant=station"),
        "fewer": tracer.solve(some),
    }
    # Counted from the mean, as a combination is: alone each is combined with nothing.
    alone = [combine([CombinationInput.of(n, r)]).result.std["ECC"] for n, r in inputs.items()]
    whole = combine([CombinationInput.of(n, r) for n, r in inputs.items()]).result
    best = np.min(alone, axis=0).mean()
    assert whole.std["ECC"].mean() > 0.93 * best
    bare = [CombinationInput.of(n, replace(r, raw_data=RawData())) for n, r in inputs.items()]
    fooled = combine(bare).result
    assert fooled.std["ECC"].mean() < 0.75 * best
    assert fooled.verdict == "suspect"  # chi-squared is too small
    assert TOO_ALIKE in coded(*fooled.warnings)
    assert set(whole.raw_data.hashes) == {h for r in inputs.values() for h in r.raw_data.hashes}


def test_a_combination_does_not_combine_with_what_it_rests_on(tracer):
    first = tracer.solve(tracer.observations(np.random.default_rng(1)))
    other = tracer.solve(tracer.observations(np.random.default_rng(2)))
    pair = [CombinationInput.of(n, r) for n, r in (("a", first), ("b", other))]
    both = combine(pair).result
    with pytest.raises(DataError, match=r"a and c share 288 observations \(of 288 and 576\)"):
        combine([CombinationInput.of("c", both), CombinationInput.of("a", first)])
    third = tracer.solve(tracer.observations(np.random.default_rng(3)))
    combine([CombinationInput.of("c", both), CombinationInput.of("d", third)])


def test_windows_tell_what_was_captured_again_with_other_settings(tracer):
    rng = np.random.default_rng(4)
    every = tracer.observations(rng, begun_ns=16 * 10**17)
    again = [
        replace(o, mean=(o.mean[0] + 1e-9,), window_start_ns=o.window_start_ns + 10**7)
        for o in every
    ]
    here, there = RawData.of(every, DATED_NS).common_observations(RawData.of(again, DATED_NS))
    np.testing.assert_array_equal(here, np.arange(len(every)))
    np.testing.assert_array_equal(there, here)
    later = [
        replace(o, window_start_ns=o.window_start_ns + 5 * 10**8,
                window_end_ns=o.window_end_ns + 5 * 10**8)
        for o in every
    ]  # fmt: skip
    assert not len(RawData.of(every, DATED_NS).common_observations(RawData.of(later, DATED_NS))[0])


@given(st.integers(0, 2**31), st.integers(3, 60), st.data())
def test_a_subset_is_known_in_any_order(seed, n, data):
    rng = np.random.default_rng(seed)
    every = [
        observation(k, k % 5, 0.1 * (k % 5), k // 5, [x], 1e-7)
        for k, x in enumerate(rng.normal(1.0, 0.1, n))
    ]
    size = data.draw(st.integers(2, n))
    chosen = rng.permutation(n)[:size]
    here, there = RawData.of(every, DATED_NS).common_observations(
        RawData.of([every[k] for k in chosen], DATED_NS)
    )
    assert sorted(zip(here.tolist(), there.tolist(), strict=True)) == sorted(
        zip(chosen.tolist(), range(size), strict=True)
    )


def solved_table(folder, targets, lengths):
    """Write targets by their new numbers, and lengths as texts; solve them as the example is."""
    folder.mkdir()
    (folder / "targets.csv").write_text("\n".join(["target,x_m,y_m,z_m", *targets]) + "\n")
    (folder / "lengths.csv").write_text("\n".join(["position,target,length_m", *lengths]) + "\n")
    setup = read_configuration(EXAMPLES / "tracer.yaml")
    return read_measurements(folder / "lengths.csv", setup, folder / "targets.csv").solve()


def test_a_table_of_some_targets_has_its_own_numbers_for_them(tmp_path):
    """It was taken for independent: 'ok', with U smaller than that of all data."""
    lengths = [line.split(",") for line in (EXAMPLES / "lengths.csv").read_text().split()[1:]]
    targets = [line.split(",") for line in (EXAMPLES / "targets.csv").read_text().split()[1:]]
    whole = solved_table(tmp_path / "all", map(",".join, targets), map(",".join, lengths))
    kept = [t for t, *_ in targets if int(t) % 3]
    number = {t: str(k) for k, t in enumerate(kept)}
    named = [",".join((number[t], *place)) for t, *place in targets if t in number]
    # beside new numbers a detour by millimetres, which changes the last bits
    rows = [(p, t, float(x) * 1e3 * 1e-3) for p, t, x in lengths if t in number]
    same = [f"{p},{t},{x!r}" for p, t, x in rows]
    again = [f"{p},{number[t]},{x!r}" for p, t, x in rows]
    some = solved_table(tmp_path / "some", map(",".join, targets), same)
    other = solved_table(tmp_path / "other", named, again)
    curves = {n: measured_curve(r) for n, r in (("w", whole), ("s", some), ("o", other))}
    found = compare(curves["w"], curves["o"])
    assert any("same observations" in note for note in found.notes)
    # errors of a target's coordinates are in both too, by whatever number it goes
    assert found.chi2 == pytest.approx(compare(curves["w"], curves["s"]).chi2, rel=1e-3)
    both = combine([CombinationInput.of("w", whole), CombinationInput.of("o", other)]).result
    alone = combine([CombinationInput.of("w", whole)]).result
    assert both.std["ECC"].mean() > 0.93 * alone.std["ECC"].mean()


@pytest.mark.parametrize("some", [(0, 1, 3, 4, 7, 9), (0, 2, 4, 6, 8, 10)])
def test_six_balls_of_twelve_in_a_table_of_their_own_are_the_same_data(tmp_path, some):
    """Its plan goes round another number of times: the angles of its steps are other ones."""
    rng = np.random.default_rng(12)
    rows = [
        (i, j, *(0.2 * np.array([np.cos(a), np.sin(a), 0.0]) + rng.normal(0.0, 3e-8, 3)))
        for i in range(12)
        for j in range(12)
        for a in [TAU * (i + j) / 12]
    ]
    results = {}
    for name, balls in (("all", range(12)), ("some", some)):
        lines = [f"{i},{j},{x:.12f},{y:.12f},{z:.12f}" for i, j, x, y, z in rows if j in balls]
        table, setup = tmp_path / f"{name}.csv", tmp_path / f"{name}.yaml"
        table.write_text("\n".join(["position,ball_step,x_m,y_m,z_m", *lines]) + "\n")
        setup.write_text(
            f"method: ball_plate\nname: mine\ngrid: 12\nball_steps: {list(balls)}\n"
            "circle_radius_m: 0.2\nball_diameter_m: 0.025\nmaterial: steel\n"
            f"sigma_centre_m: 3.0e-8\nseparate_groups: {str(some[1] == 2).lower()}\n"
        )
        results[name] = rc.read_table(table, setup).solve()
    here, there = results["all"].raw_data.common_observations(results["some"].raw_data)
    assert len(here) == len(there) == 72
    pair = [CombinationInput.of(n, r) for n, r in results.items()]
    alone = combine(pair[:1]).result.std["ECC"]
    assert combine(pair).result.std["ECC"].mean() > 0.93 * alone.mean()


def test_values_read_coarsely_agree_by_chance_and_are_not_called_the_same():
    rng = np.random.default_rng(5)

    def run():
        return RawData.of(
            [
                observation(k, 0, 0.0, k, [round(1.0 + 1e-3 * k + rng.normal(0.0, 5e-7), 7)], 1e-7)
                for k in range(200)
            ],
            DATED_NS,
        )

    first, second = run(), run()
    assert set(first.hashes) & set(second.hashes)  # some are equal
    assert not len(first.common_observations(second)[0])


def test_two_ways_of_a_mirror_are_refused_with_the_reason():
    setup = read_configuration(EXAMPLES / "plane_mirror.yaml")

    def way(name):
        return read_measurements(
            EXAMPLES / "tracker.csv", changed(setup, (f"solver.way={name}",))
        ).solve()

    first, second = way("joint"), way("stitching")
    n = len(first.raw_data.hashes)
    with pytest.raises(DataError, match=rf"x and y share {n} observations"):
        compare(measured_curve(first), measured_curve(second), names=("x", "y"))


def test_a_result_keeps_its_observations_in_its_file(tracer):
    result = tracer.solve(tracer.observations(np.random.default_rng(6)))
    data = json.loads(result.to_json())
    again = Result.from_dict(data).raw_data
    assert again.hashes == result.raw_data.hashes
    ours, theirs = result.raw_data.influence, again.influence
    assert theirs.causes == ours.causes
    np.testing.assert_array_equal(theirs.rows, ours.rows)
    np.testing.assert_allclose(
        theirs.deviations["ECC"], ours.deviations["ECC"], rtol=1e-6, atol=1e-14
    )
    # The influences of lengths and targets are where this covariance comes from.
    own = ours.deviations["ECC"]
    assert np.trace(own @ own.T) <= np.trace(result.covariance["ECC"]) * (1 + 1e-9)
    assert np.trace(own @ own.T) > 0.9 * np.trace(result.covariance["ECC"])


@pytest.mark.parametrize(
    ("entry", "value"),
    [
        ("sha256", [1, 2]),
        ("begun_ns", [1]),
        ("begun_ns", ["x"]),
        ("influence", {"rows": [99999], "coordinates": 1, "causes": [], "deviations": {}}),
        (
            "influence",
            {"rows": [0], "coordinates": 1, "causes": [], "deviations": {"ECC": "AAAA"}},
        ),
        ("influence", {"rows": [0], "coordinates": 1, "causes": [], "deviations": {"ECC": "!"}}),
        ("influence", {"rows": [0], "coordinates": 2, "causes": [], "deviations": {}}),
    ],
)
def test_damaged_observations_are_named(tracer, entry, value):
    data = json.loads(tracer.solve(tracer.observations(np.random.default_rng(6))).to_json())
    data["raw_data"][entry] = value
    with pytest.raises(DataError, match="raw_data"):
        Result.from_dict(data)


def test_too_many_influences_are_left_out_of_the_file():
    many = Influence(np.arange(2), 1, {"ECC": np.zeros((MOST_INFLUENCES // 2 + 1, 2))})
    assert not many.kept
    assert "influence" not in RawData(("a", "b"), influence=many).to_dict()


@pytest.mark.slow
def test_compare_reads_the_file_of_several_evaluations(tmp_path, warm):
    out = tmp_path / "ways.json"
    table = EXAMPLES / "balls.csv"
    sound = ["solve", str(table), "--setup", str(EXAMPLES / "ball_plate.yaml")]
    steps = sorted({int(line.split(",")[1]) for line in table.read_text().splitlines()[1:]})
    fewer = ",".join(map(str, steps[:-1]))
    solved = warm.run("rotcal", *sound, "--balls", "all", "--balls", fewer, "-o", out)
    assert solved.returncode in (0, 1), solved.stderr
    compared = warm.run("rotcal", "compare", out, "--json")
    assert compared.returncode in (0, 1), compared.stderr
    (pair,) = json.loads(compared.stdout)["pairs"]
    assert [pair["first"].rpartition(": ")[2], pair["second"].rpartition(": ")[2]] == [
        "all data",
        f"balls=[{fewer}]",
    ]
    assert any("same observations" in note for note in pair["notes"])
    alone = warm.run("rotcal", "export", out, "--to", "csv", "--out", tmp_path)
    assert alone.returncode == 3
    assert "holds 2 evaluations of the same data" in alone.stderr


@pytest.mark.parametrize(
    "changes",
    [("solver.variant=station",), ("solver.datum=free",), ("solver.length_std_m=2.0e-7",)],
)
def test_evaluations_of_the_same_data_gain_nothing(tracer, changes):
    """Whatever they estimate of the same noise: the surest stands for all of them."""
    every = tracer.observations(np.random.default_rng(7))
    first, second = tracer.solve(every), tracer.solve(every, *changes)
    found = combine([CombinationInput.of(*e) for e in (("a", first), ("b", second))])
    keep = np.eye(len(first.angles)) - 1.0 / len(first.angles)
    sure = min(
        (np.sqrt((keep @ r.covariance["ECC"] @ keep).diagonal()) for r in (first, second)),
        key=np.mean,
    )
    assert found.result.std["ECC"] == pytest.approx(found.groups[0].factor * sure, rel=1e-6)
    assert found.groups[0].dof == len(first.angles) - 1  # that they agree is tested as ever


def test_evaluations_of_the_same_circles_are_combined_from_their_files(tmp_path):
    """A file rounds what readings do to a result: to 1e-8, not to a damaged covariance."""
    world = CircleWorld(3)
    readings, found = world.read(THREE), []
    for sigma in (NOISE, 1.25 * NOISE):
        one = prepare(
            changed(stated_circles(THREE).configuration, [f"solver.sigma_arcsec={sigma}"])
        )
        path = tmp_path / f"{sigma}.json"
        path.write_text(solved_circles(one, readings).to_json())
        found.append(CombinationInput.of(path.stem, rc.read_result(path)))
    both = combine(found)
    assert both.result.std["ECC"] == pytest.approx(combine(found[:1]).result.std["ECC"], rel=1e-3)


def test_evaluations_of_the_same_data_weigh_as_much_as_the_surest_of_them(tracer):
    rng = np.random.default_rng(8)
    every, others = tracer.observations(rng), tracer.observations(rng)
    same = [tracer.solve(every), tracer.solve(every, "solver.datum=free")]
    again = tracer.solve(others, "solver.length_std_m=1.3e-7")
    names = [CombinationInput.of(*e) for e in zip("abc", (*same, again), strict=True)]
    three = combine(names, "none").result
    two = combine([names[0], names[2]], "none").result
    assert three.std["ECC"] == pytest.approx(two.std["ECC"], rel=1e-9)
    assert three.deviations["ECC"] == pytest.approx(two.deviations["ECC"], abs=1e-15)
