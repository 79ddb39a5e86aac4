"""The policy asked again: the same choices from the same observations, and where they differ."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chances import LONG

from rotcal_ros.foundation.errors import ConfigurationError, PlanError
from rotcal_ros.foundation.observations import ATTEMPTS_PER_RUN
from rotcal_ros.methods import changed, prepare, prepare_to_measure, read_configuration
from rotcal_ros.methods.continuation import continued
from rotcal_ros.planning.choices import StepOutcome
from rotcal_ros.recordings.recorded_setup import RecordedChoice, policy_differences

DEMO = Path(__file__).parents[2] / "config" / "tracer_paper.yaml"
SHORT = (
    "plan.table_positions=5",
    "plan.box_points=[3, 2, 2]",
    "solver.length_std_m=2.0e-7",
    "planner.policy=until_goal",
    "planner.goal_arcsec=11.0",
)
GIVEN_UP = 3
SECOND_NS = 1_000_000_000


def calibration(*changes):
    return prepare(changed(read_configuration(DEMO), (*SHORT, *changes)))


@pytest.fixture(scope="module")
def cell():
    """Return the calibration and an accepted observation of every step."""
    posed = calibration()
    return posed, {o.step: o for o in posed.measured({}, seed=3).observations}


def run_of(posed, seen, continuation, most=1000, zero_m=0.0):
    """Return choices and observations of one run; the step that is chosen third is given up.

    ``zero_m``: by how much the zero of all lengths has moved since the first run.
    """
    policy, choices, observed = posed.policy(continuation), [], []
    first = continuation.run * ATTEMPTS_PER_RUN
    while len(choices) < most:
        choice = policy.choose()
        times = sum(c.choice.step == choice.step for c in choices)
        attempt = first + GIVEN_UP * times
        choices.append(RecordedChoice(continuation.run, len(choices), attempt, choice))
        if choice.step is None:
            break
        accepted = len(choices) != 3
        here = seen[choice.step]
        observations = [
            replace(
                here,
                attempt=attempt + n,
                run=continuation.run,
                accepted=accepted,
                mean=(here.mean[0] - zero_m,),
                window_end_ns=SECOND_NS * (1000 * continuation.run + len(choices)),
            )
            for n in range(1 if accepted else GIVEN_UP)
        ]
        observed += observations
        policy.note(StepOutcome(choice.step, observations[0] if accepted else None))
    return choices, observed


def test_the_policy_makes_the_choices_of_the_bag_again(cell):
    posed, seen = cell
    choices, observed = run_of(posed, seen, posed.first_run())
    assert choices[-1].choice.reason.startswith("goal reached")
    assert "failed in every attempt" in choices[3].choice.reason
    assert len(choices) < len(posed.plan.steps)
    assert policy_differences(posed, choices, observed) == ()


def test_an_interrupted_run_and_the_one_that_continues_it_are_made_again(cell):
    posed, seen = cell
    choices, observed = run_of(posed, seen, posed.first_run(), most=12)
    rest = continued(
        posed.plan, posed.configuration.plan_id, 1, observed, max_attempts=GIVEN_UP, join_steps=8
    )
    more, further = run_of(posed, seen, rest)
    assert more[0].choice.reason == "completed step, measured again to join the runs"
    assert more[-1].choice.step is None
    assert policy_differences(posed, [*choices, *more], [*observed, *further]) == ()


@pytest.mark.slow
@pytest.mark.parametrize("zero", ["per_station", "per_segment"])
def test_a_run_interrupted_at_any_step_ends_as_if_it_had_not_been(zero):
    posed = calibration(f"solver.zero={zero}")
    seen = {o.step: o for o in posed.measured({}, seed=3).observations}
    whole, _ = run_of(posed, seen, posed.first_run())
    goal = whole[-1].choice.standing.goal
    every = range(len(whole))
    for most in every if LONG else sorted({0, 1, 4, *every[9::12], every[-1]}):
        choices, observed = run_of(posed, seen, posed.first_run(), most=most)
        rest = continued(
            posed.plan, posed.configuration.plan_id, 1, observed,
            max_attempts=GIVEN_UP, join_steps=8,
        )  # fmt: skip
        more, further = run_of(posed, seen, rest, zero_m=2e-5)
        end = more[-1].choice
        assert end.reason.startswith("goal reached: U "), most
        assert end.standing.uncertainty <= goal
        assert policy_differences(posed, [*choices, *more], [*observed, *further]) == ()
        done = {o.step for o in observed if o.accepted}
        joined = {o.step for o in further if o.step in done}
        assert len(joined) == (min(8, len(done)) if len(more) > 1 else 0), most
        solved = posed.solve([*observed, *further])
        error = solved.deviations["ECC"]  # of a table without any
        assert np.all(np.abs(error - error[0]) <= 5.0 * solved.std["ECC"] + 1e-12), most


def test_another_observation_leads_to_another_choice(cell):
    posed, seen = cell
    choices, observed = run_of(posed, seen, posed.first_run())
    wrong = choices[10].choice.step  # whichever length is the first suspect then
    other = [replace(o, mean=(o.mean[0] + 2e-5,)) if o.step == wrong else o for o in observed]
    (text,) = policy_differences(posed, choices, other)
    assert text.startswith("run 0, choice ")
    assert "from the recorded observations the policy chooses step" in text
    noise = [float(number) for number in re.findall(r"noise ([\d.]+) times", text)]
    assert "is suspect (" in text or noise[1] > 2.0 * noise[0]


def test_a_choice_that_is_missing_is_named(cell):
    posed, seen = cell
    choices, observed = run_of(posed, seen, posed.first_run())
    (text,) = policy_differences(posed, choices[:5] + choices[6:], observed)
    assert text.startswith("run 0, choice 5: ")


def test_a_list_needs_no_asking(cell):
    posed, seen = cell
    listed = calibration("planner.policy=as_listed")
    choices, observed = run_of(posed, seen, posed.first_run())
    assert policy_differences(listed, choices[3:], observed) == ()


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ("planner.goal_arcsec=0.0", ConfigurationError, "needs a goal"),
        ("planner.goal_arcsec=0.1", PlanError, "out of reach: all 60 steps"),
        ("solver.datum=free", ConfigurationError, "datum must be 'prior'"),
        ("plan.tracer_m=[0.1]", ConfigurationError, "where the tracer stands"),
    ],
)
def test_what_cannot_be_followed_is_refused_before_anything_moves(change, error, words):
    with pytest.raises(error, match=words):
        prepare_to_measure(changed(read_configuration(DEMO), (*SHORT, change)))


def test_a_first_step_and_another_method_are_refused():
    posed = calibration()
    with pytest.raises(PlanError, match="rotcal run --resume"):
        posed.policy(posed.first_run(7))
    plate = read_configuration(DEMO.with_name("ball_plate_demo.yaml"))
    with pytest.raises(ConfigurationError, match="has no policy until_goal"):
        prepare_to_measure(changed(plate, ("planner.policy=until_goal",)))
