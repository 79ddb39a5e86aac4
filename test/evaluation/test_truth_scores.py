"""Results against known truth: scores by hand, what a result may leave out, what is refused."""

import json

import numpy as np
import pytest

from rotcal_ros.evaluation.truth_scores import leaderboard, score_folder
from rotcal_ros.foundation.errors import BagError, DataError
from rotcal_ros.foundation.units import ARCSEC

ANGLES = np.radians([0.0, 90.0, 180.0, 270.0])
TRUE = ARCSEC * np.array([0.0, 3.0, -1.0, 2.0])


def write_case(folder, effect="none", **results):
    folder.mkdir(parents=True, exist_ok=True)
    truth = {
        "method": "tracer_multistation",
        "angles_rad": ANGLES.tolist(),
        "deviations": {"ECC": TRUE.tolist()},
        "effect": effect,
    }
    (folder / "truth.json").write_text(json.dumps(truth))
    for name, result in results.items():
        (folder / f"result_{name}.json").write_text(json.dumps(result))
    return folder


def result(error_arcsec=(0.0, 0.0, 0.0, 0.0), std_arcsec=1.0, **also):
    ecc = TRUE + ARCSEC * np.array(error_arcsec)
    std = np.full(4, std_arcsec * ARCSEC)
    return {
        "angles_rad": ANGLES.tolist(),
        "deviations": {"ECC": ecc.tolist()},
        "std": {"ECC": std.tolist()},
        **also,
    }


def test_a_score_by_hand(tmp_path):
    # errors less their mean, 0.5: -0.5, 1.5, 0.5, -1.5 arcsec
    case = write_case(tmp_path / "a", mine=result((0.0, 2.0, 1.0, -1.0)))
    (score,) = score_folder(case)
    assert score.largest == pytest.approx(1.5 * ARCSEC)
    assert score.rms == pytest.approx(np.sqrt(1.25) * ARCSEC)
    # independent values: the mean of four takes a quarter of the variance off
    assert score.uncertainty == pytest.approx(2.0 * np.sqrt(0.75) * ARCSEC)
    assert (score.held, score.n, score.agree, score.misleads) == (4, 4, True, False)
    assert (score.case, score.entry, score.verdict) == ("a", "mine", "ok")


def test_an_offset_is_no_error(tmp_path):
    (score,) = score_folder(write_case(tmp_path, mine=result((7.0, 7.0, 7.0, 7.0))))
    assert score.largest < 1e-6 * ARCSEC


def test_who_says_ok_and_is_wrong_misleads_unless_the_effect_is_named(tmp_path):
    wrong = (0.0, 9.0, -9.0, 0.0)
    write_case(
        tmp_path,
        "drift",
        silent=result(wrong),
        named=result(wrong, verdict="ok", not_protected=["drift"]),
        other=result(wrong, verdict="ok", not_protected=["knock"]),
        suspect=result(wrong, verdict="suspect"),
        alarm=result(verdict="failed"),
    )
    scores = {score.entry: score for score in score_folder(tmp_path)}
    misleading = {entry for entry, score in scores.items() if score.misleads}
    assert misleading == {"silent", "other"}
    rows = {row.entry: row for row in leaderboard(scores.values())}
    counts = {name: (row.misleading, row.named, row.alarms) for name, row in rows.items()}
    assert counts == {
        "silent": (1, 0, 0), "named": (0, 1, 0), "other": (1, 0, 0), "suspect": (0, 0, 0),
        "alarm": (0, 0, 1),
    }  # fmt: skip
    assert "U is 1.73 arcsec, 2 of 4 intervals hold the truth; it says ok" in (
        scores["silent"].describe()
    )


def test_the_leaderboard_has_the_best_first_and_knows_what_is_plain(tmp_path):
    write_case(tmp_path / "a", good=result((0.0, 1.0, 0.0, -1.0)), poor=result((0, 3, 0, -3)))
    write_case(tmp_path / "b", "drift", good=result((0.0, 2.0, 0.0, -2.0), verdict="suspect"))
    first, second = leaderboard(score_folder(tmp_path))
    assert (first.entry, second.entry) == ("good", "poor")
    assert first.rms_plain == pytest.approx(np.sqrt(0.5))
    assert first.rms == pytest.approx(np.sqrt((0.5 + 2.0) / 2.0))
    assert (first.curves, first.ok, first.held, first.unit) == (2, 1, 1.0, "arcsec")
    assert second.held == 0.5


def test_an_angle_that_is_left_out_holds_nothing(tmp_path):
    short = result()
    for name in ("deviations", "std"):
        short[name]["ECC"].pop()
    short["angles_rad"].pop()
    (score,) = score_folder(write_case(tmp_path, mine=short))
    assert (score.held, score.n) == (3, 4)


def test_what_turns_with_the_table_is_taken_off_both(tmp_path):
    case = write_case(tmp_path)
    angles = np.arange(8) * np.pi / 4
    zero = np.zeros(8).tolist()
    truth = {
        "method": "ball_plate",
        "angles_rad": angles.tolist(),
        "deviations": {"EXC": (1e-6 * np.cos(2 * angles)).tolist(), "EYC": zero},
    }
    turning = 5e-6 * np.exp(1j * angles)
    found = {
        "EXC": (1e-6 * np.cos(2 * angles) + turning.real).tolist(),
        "EYC": turning.imag.tolist(),
    }
    std = {name: [1e-7] * 8 for name in found}
    entry = {"angles_rad": angles.tolist(), "deviations": found, "std": std}
    (case / "truth.json").write_text(json.dumps(truth))
    (case / "result.json").write_text(json.dumps(entry))
    scores = score_folder(case)
    assert [score.component for score in scores] == ["EXC", "EYC"]
    assert max(score.largest for score in scores) < 1e-12


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"angles_rad": [0.0, 90.0, 180.0, 270.0]}, "are these degrees"),
        ({"angles_rad": ANGLES[::-1].tolist()}, "in their order"),
        ({"angles_rad": ANGLES[:3].tolist()}, "of the shape"),
        ({"deviations": {}}, "none in common"),
        ({"deviations": {"EXC": [0.0] * 4}}, "EXC is missing"),
        ({"deviations": {"EXC": [0.0] * 4}, "std": {"EXC": [0.0] * 4}}, "none in common"),
        ({"deviations": {"ECC": ["a"] * 4}}, "deviations.ECC: not an array of numbers"),
        ({"deviations": [1.0]}, "deviations"),
        ({"std": None}, "std"),
        ({"covariance": {"ECC": [1.0]}}, "covariance.ECC: expected finite numbers of the shape"),
        ({"verdict": "fine"}, "none of ok, suspect, failed"),
        ({"not_protected": 3}, "not_protected"),
    ],
)
def test_what_does_not_fit_is_refused_with_the_file(tmp_path, change, words):
    case = write_case(tmp_path, mine={**result(), **change})
    with pytest.raises(DataError, match=words) as error:
        score_folder(case)
    assert "result_mine.json" in str(error.value)


@pytest.mark.parametrize("entry", ["angles_rad", "deviations", "std"])
def test_what_is_missing_is_named(tmp_path, entry):
    given = {name: value for name, value in result().items() if name != entry}
    with pytest.raises(DataError, match=f"result_mine.json: the entry '{entry}' is missing"):
        score_folder(write_case(tmp_path, mine=given))


def test_a_folder_without_truth_or_results_is_refused(tmp_path):
    with pytest.raises(BagError, match=r"no truth\.json"):
        score_folder(tmp_path)
    with pytest.raises(DataError, match=r"put yours there as result_NAME\.json"):
        score_folder(write_case(tmp_path))
    (tmp_path / "result.json").write_text("{")
    with pytest.raises(BagError, match="is not JSON"):
        score_folder(tmp_path)
