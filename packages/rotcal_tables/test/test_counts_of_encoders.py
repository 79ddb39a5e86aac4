"""Commanded and actual angles, or counts of an encoder, that wrap: deviations, or a question."""

import numpy as np
import pytest

from rotcal_ros.foundation.errors import ConfigurationError, UndecidedError
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.recordings.inputs import MeasurementInput

N = 360_000
"""Counts of a turn: one is 3.6 arcsec."""
COMMANDED = np.arange(0.0, 360.0, 10.0)
TRUTH = 40.0 * np.sin(np.deg2rad(COMMANDED) + 0.4) + 15.0 * np.cos(2 * np.deg2rad(COMMANDED))
"""Deviations of the table, arcsec."""
U = "solver.u_arcsec=1"


def counted(turn=N, zero=0.0, deviations=TRUTH, commanded=COMMANDED):
    """Return what an encoder with a ``zero`` (deg) has counted, a whole number, not wrapped."""
    return np.rint((commanded + deviations / 3600.0 + zero) / 360.0 * turn).astype(np.int64)


def wrapped(counts, bits, signed=True):
    size = 1 << bits
    return (counts + size // 2) % size - size // 2 if signed else counts % size


def solved(folder, actual, *changes, head="commanded [deg],encoder [counts]", angles=COMMANDED):
    (path := folder / "t.csv").write_text(
        head + "\n" + "".join(f"{float(a):g},{c}\n" for a, c in zip(angles, actual, strict=True))
    )
    return MeasurementInput(path, changes=(U, *changes)).read().solve()


def ecc(result):
    return result.deviations["ECC"] / ARCSEC


def question(folder, actual, *changes, **more):
    with pytest.raises(UndecidedError) as asked:
        solved(folder, actual, *changes, **more)
    return asked.value.question.setting, [value for value, _ in asked.value.question.answers]


TURN = f"sheet.counts_per_turn={N}"
HALF = 1.8 + 1e-6
"""Half a count, arcsec."""


def test_counts_that_wrap_at_a_turn_are_deviations_once_it_is_said_how_many_make_one(tmp_path):
    counts = counted() % N
    assert counts[0] == 8  # the table stands 30.6 arcsec too far
    setting, offered = question(tmp_path, counts)
    assert setting == "sheet.counts_per_turn"
    assert offered[0] == str(N)
    result = solved(tmp_path, counts, TURN)
    assert np.abs(ecc(result) - TRUTH).max() <= HALF
    # a count is a rectangle of 3.6 arcsec
    assert result.std["ECC"] / ARCSEC == pytest.approx(np.hypot(1.0, 3.6 / np.sqrt(12.0)))
    below = counted(deviations=TRUTH - 60.0) % N  # at 0 it has not come to its zero
    assert below[0] > N - 100
    assert np.abs(ecc(solved(tmp_path, below, TURN)) - TRUTH + 60.0).max() <= HALF


def test_an_encoder_that_counts_down_is_offered_with_its_sign(tmp_path):
    counts = -counted() % N
    assert question(tmp_path, counts) == ("sheet.counts_per_turn", [str(-N)])
    result = solved(tmp_path, counts, f"sheet.counts_per_turn={-N}")
    assert np.abs(ecc(result) - TRUTH).max() <= HALF


@pytest.mark.parametrize(("bits", "signed"), [(16, True), (16, False), (24, True), (32, True)])
@pytest.mark.parametrize("turn", [N, 40_000])
def test_a_counter_that_wraps_elsewhere_is_asked_and_unwrapped(tmp_path, bits, signed, turn):
    end = 1 << bits >> signed
    begin = (end - turn // 2) / turn * 360.0  # it wraps in this turn, and may do so again
    counts = wrapped(counted(turn, begin), bits, signed)
    stated = f"sheet.counts_per_turn={turn}", "sheet.zero=first"
    setting, offered = question(tmp_path, counts, *stated)
    assert (setting, offered[0]) == ("sheet.counter", str(bits))
    found = ecc(solved(tmp_path, counts, *stated, f"sheet.counter={bits}"))
    truth = TRUTH - TRUTH[0]
    assert np.abs(found - truth).max() <= 2.0 * 648_000 / turn + 1e-6


def test_another_zero_of_the_encoder_is_asked_and_never_taken_off_in_silence(tmp_path):
    counts = counted(zero=123.4) % N
    assert question(tmp_path, counts, TURN) == ("sheet.zero", ["first", "table"])
    found = ecc(solved(tmp_path, counts, TURN, "sheet.zero=first"))
    assert np.abs(found - (TRUTH - TRUTH[0])).max() <= 2.0 * HALF
    near = counted(zero=8.0) % N
    assert question(tmp_path, near, TURN)[0] == "sheet.zero"
    stands = ecc(solved(tmp_path, near, TURN, "sheet.zero=table"))
    assert np.abs(stands - TRUTH - 8.0 * 3600.0).max() <= HALF


def test_counts_of_a_turn_that_leave_a_trend_are_refused_with_those_that_do_not(tmp_path):
    counts = counted() % N
    setting, offered = question(tmp_path, counts, "sheet.counts_per_turn=365000")
    assert (setting, offered[0]) == ("sheet.counts_per_turn", str(N))
    grown = counted(deviations=0.5 * TRUTH) % N  # a turn of deviations is no trend
    assert np.abs(ecc(solved(tmp_path, grown, TURN)) - 0.5 * TRUTH).max() <= HALF


def test_steps_of_a_motor_beside_counts_of_its_encoder(tmp_path):
    steps, encoder = np.arange(0, 3200, 100), 16_384
    at = steps * 360.0 / 3200
    truth = 300.0 * np.sin(np.deg2rad(3.0 * at))
    counts = counted(encoder, 0.0, truth, at) % encoder
    head = "commanded [steps],encoder [counts]"
    asked = {"head": head.replace("steps", "counts"), "angles": steps}
    assert question(tmp_path, counts, **asked) == ("sheet.counts_per_turn", ["3200", "3100"])
    assert question(tmp_path, counts, "sheet.commanded_counts=3200", **asked) == (
        "sheet.counts_per_turn", ["16384", "16400"],
    )  # fmt: skip
    stated = "sheet.commanded_counts=3200", "sheet.counts_per_turn=16384"
    found = ecc(solved(tmp_path, counts, *stated, **asked))
    assert np.abs(found - truth).max() <= 648_000 / encoder


def test_angles_of_a_read_out_that_wraps_beside_commanded_ones(tmp_path):
    actual = np.round((COMMANDED + TRUTH / 3600.0 - 0.02) % 360.0, 4)
    assert actual[0] > 359.9
    closing = [*(f"{a:.4f}" for a in actual), f"{actual[0]:.4f}"]
    for last in (360.0, 0.0):
        result = solved(
            tmp_path, closing, head="commanded [deg],actual [deg]", angles=[*COMMANDED, last]
        )
        assert result.angles[:36] / DEGREE == pytest.approx(COMMANDED)
        assert np.abs(ecc(result)[:36] - TRUTH + 72.0).max() <= 0.19


def test_repeats_show_the_noise_and_half_a_count_stays(tmp_path):
    rng, rows = np.random.default_rng(3), []
    for run in range(5):
        noisy = counted(deviations=TRUTH + rng.normal(0.0, 8.0, len(TRUTH))) % N
        rows += [f"{a:g},{run},{c}" for a, c in zip(COMMANDED, noisy, strict=True)]
    (path := tmp_path / "t.csv").write_text(
        "commanded [deg],run,encoder [counts]\n" + "\n".join(rows) + "\n"
    )
    result = MeasurementInput(path, changes=(TURN,)).read().solve()
    noise = np.hypot(8.0, 3.6 / np.sqrt(12.0))
    assert result.runs.repeatability_std / ARCSEC == pytest.approx(noise, rel=0.12)
    u = np.hypot(noise / np.sqrt(5.0), 3.6 / np.sqrt(12.0))
    assert result.std["ECC"] / ARCSEC == pytest.approx(u, rel=0.12)


def test_numbers_too_large_for_angles_are_offered_as_counts(tmp_path):
    setting, offered = question(tmp_path, counted() % N, head="commanded [deg],actual")
    assert setting == "sheet.angle_unit"
    assert offered[0] == "counts"
    found = solved(
        tmp_path, counted() % N, "sheet.angle_unit=counts", TURN, head="commanded [deg],actual"
    )
    assert np.abs(ecc(found) - TRUTH).max() <= HALF


def test_uncertainties_in_counts_have_no_sign_where_the_encoder_counts_down(tmp_path):
    cells = [f"{c},0.5" for c in -counted() % N]
    head = "commanded [deg],encoder [counts],standard uncertainty [counts]"
    result = solved(tmp_path, cells, f"sheet.counts_per_turn={-N}", head=head)
    assert np.abs(ecc(result) - TRUTH).max() <= HALF
    assert result.std["ECC"] / ARCSEC == pytest.approx(np.hypot(1.8, 3.6 / np.sqrt(12.0)))


def test_a_counter_of_the_motor_begins_anew_after_any_counts(tmp_path):
    """A geared motor's encoder counts to 4000, seven times between two rows."""
    turn = 288_000
    counts = counted(turn) % 4000
    assert question(tmp_path, counts, f"sheet.counts_per_turn={turn}") == ("sheet.counter", ["N"])
    stated = f"sheet.counts_per_turn={turn}", "sheet.counter=4000"
    assert np.abs(ecc(solved(tmp_path, counts, *stated)) - TRUTH).max() <= 648_000 / turn
    with pytest.raises(ConfigurationError, match="expected the bits of the counter"):
        solved(tmp_path, counts, stated[0], "sheet.counter=4000s")


def test_counts_of_a_turn_that_are_off_by_less_than_the_deviations_are_seen_where_it_closes(
    tmp_path,
):
    turn, angles = 65_536, np.arange(0.0, 361.0, 30.0)
    truth = 400.0 * np.sin(np.deg2rad(angles) + 1.0) - 200.0
    counts = counted(turn, 0.0, truth, angles)
    good = solved(tmp_path, counts, f"sheet.counts_per_turn={turn}", angles=angles)
    assert good.verdict == "ok"
    assert np.abs(ecc(good) - truth).max() <= 648_000 / turn
    off = solved(tmp_path, counts, "sheet.counts_per_turn=65530", angles=angles)
    assert off.verdict == "suspect"
    assert "do not close: at 0 and 360 deg" in off.warnings[0]  # by 6 counts of 19.8 arcsec
    assert "differ by 118.7 arcsec" in off.warnings[0]
    assert off.warnings[1] == "or a turn has 65536 counts"


def test_where_no_angle_comes_again_after_a_turn_the_verdict_names_the_counts(tmp_path):
    result = solved(tmp_path, counted() % N, TURN)
    scale = next(p for p in result.protections if p.effect == "scale")
    assert scale.treatment == "not protected"
    assert "360000 counts are stated for a turn: one more is 3.6 arcsec at its end" in scale.why
    assert "scale" in result.verdict_line
