"""The report as a certificate: ISO/IEC 17025:2017, 7.8.2.1 and 7.8.4.1, item by item."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from certified_samples import CIRCUMSTANCES, Clauses, report, result, text_of

from rotcal_ros.evaluation.marks import why_withheld
from rotcal_ros.evaluation.verification import Positioning, Verification
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.report.page import render_report
from rotcal_ros.report.verification import verification_section

COMMON = {
    "7.8.2.1 a": "Calibration report of a rotary table",  # a title
    "7.8.2.1 b": "Length Laboratory, Street 1, Town, DE, lab@example.org",  # name and address
    "7.8.2.1 c": "hall 3",  # where it was done
    "7.8.2.1 d": "K-2026-17",  # unique identification, and a clear end
    "7.8.2.1 e": "Customer Ltd, Road 2, City",  # the customer
    "7.8.2.1 f": "Laser tracer, multi-station",  # the method
    "7.8.2.1 g": "rotary table, Maker, T 400, no. 0815",  # the item, unambiguous
    "7.8.2.1 h": "2026-03-01",  # date of receipt
    "7.8.2.1 i": "2026-03-03 08:00 to 10:00 UTC",  # date of performance
    "7.8.2.1 j": "2026-03-04",  # date of issue
    "7.8.2.1 k": "50 steps planned or offered, 48 used, 2 skipped, 3 retried",  # sampling
    "7.8.2.1 l": "relate only to the item calibrated",
    "7.8.2.1 m": "ECC lies between −6.00 and 0.00 arcsec",  # results with units
    "7.8.2.1 n": "2 of 50 steps were skipped",  # deviations from the method
    "7.8.2.1 o": "not stated",  # who authorises: nothing knows
    "7.8.2.1 p": "not stated",  # external providers
}
CALIBRATION = {
    "7.8.4.1 a": "expanded uncertainty",
    "7.8.4.1 b": "temperature 20.12 °C (19.90 to 20.30); air pressure 1013.2 hPa (1013.0 to "
    "1013.5); relative humidity 45 % (40 to 50)",
    "7.8.4.1 c": "certificates of: tracer",
    "7.8.4.1 d": "No adjustment or repair",
    "7.8.4.1 e": "ECC is within the tolerance ±10 arcsec",
    "7.8.4.1 f": "nothing moves",  # opinions: what could be wrong
}


@pytest.fixture(scope="module")
def whole():
    """The page of a result of which everything is known."""
    return render_report(report())


@pytest.fixture(scope="module")
def bare():
    """The page of a result of which nothing is known but the numbers."""
    return render_report(report(result(circumstances=Circumstances(), protections=()), issued=""))


def test_the_time_of_a_simulated_clock_is_called_so(whole):
    """It runs faster than ours, and the report ended after it was written."""
    simulated = result(circumstances=replace(CIRCUMSTANCES, simulated=True))
    assert "10:00 UTC, simulated time" in text_of(render_report(report(simulated)))
    assert "simulated time" not in text_of(whole)


@pytest.mark.parametrize(("clause", "words"), [*COMMON.items(), *CALIBRATION.items()])
def test_every_item_of_the_standard_is_on_the_page(whole, clause, words):
    texts = [" ".join(text.split()) for text in Clauses(whole).texts[clause]]
    assert any(words in text for text in texts), texts


@pytest.mark.parametrize("clause", [*COMMON, *CALIBRATION])
def test_what_is_not_known_is_said_to_be(bare, clause):
    texts = Clauses(bare).texts[clause]
    assert all(text.strip() for text in texts)
    unknown = {f"7.8.2.1 {letter}" for letter in "bceghijnop"} | {"7.8.4.1 b", "7.8.4.1 c"}
    if clause in unknown:
        assert any("not stated" in text for text in texts)


@pytest.mark.usefixtures("without_figures")
def test_before_and_after_adjustment_stand_in_the_report_that_has_both():
    run = Positioning(np.arange(3.0), np.array([0.0, 30.0, 5.0]) * ARCSEC, np.full(3, ARCSEC))
    section = verification_section(Verification(run, replace(run, deviation=run.std), 0.0))
    texts = Clauses(render_report(report(extra=[section]))).texts["7.8.4.1 d"]
    assert any("Measured, compensated, measured again" in text for text in texts)
    assert any("See “Before and after compensation”" in text for text in texts)


def test_page_one_says_the_result_with_two_digits_of_u(whole):
    """u = 0.4 arcsec, U = 0.80; at 90 degrees -6 arcsec, and 0 by definition at the first."""
    page, shown = whole, text_of(whole)
    assert "ECC lies between −6.00 and 0.00 arcsec, a range of 6.00 arcsec, with U ≤ 0.80" in shown
    assert "It does not cover" not in shown
    row = r'<tr><th scope="row">90</th><td>−6.00</td><td>0.80</td></tr>'
    assert len(re.findall(row, page)) == 1
    assert '<tr><th scope="row">0</th><td>0</td><td>0</td></tr>' in page
    assert "ECC counts from the first angle and is 0 there by definition." in shown
    assert "SIMULATED" not in page.replace("simulated", "")


def test_number_and_fingerprint_are_those_of_the_result(whole, bare):
    first, second = whole, bare
    digests = [re.search(r"This result</dt><dd class=\"mono\">SHA-256 (\w{64})", p)[1]
               for p in (first, second)]  # fmt: skip
    assert digests[0] != digests[1]
    assert f'content: "No. K\\2d 2026\\2d 17 · SHA-256 {digests[0][:16]}…"' in first
    assert re.search(r"No\. RC-[0-9A-F]{10}<", bare)


@pytest.mark.usefixtures("without_figures")
def test_a_number_cannot_break_out_of_the_style_sheet():
    evil = replace(CIRCUMSTANCES.identity, certificate_number='"}</style><b>$x$')
    page = render_report(report(result(circumstances=replace(CIRCUMSTANCES, identity=evil))))
    assert "</style><b>" not in page
    assert 'content: "No. \\22 \\7d \\3c ' in page


@pytest.mark.usefixtures("without_figures")
def test_a_simulation_is_never_taken_for_a_calibration():
    page = render_report(report(result(circumstances=replace(CIRCUMSTANCES, simulated=True))))
    assert "<strong>SIMULATED</strong> This is no calibration of a real table." in page
    assert '<body class="simulated">' in page
    assert '@top-right { content: "SIMULATED: no calibration of a real table"' in page
    assert "Traceability: None: a simulation was measured" in text_of(page)


DOUBTFUL = ("the stations leave their circle by 7 times what is expected",)


@pytest.mark.slow
@pytest.mark.parametrize("verdict", ["suspect", "failed"])
def test_a_result_in_doubt_shows_it_in_the_number_itself(whole, verdict):
    doubtful = result(verdict=verdict, warnings=DOUBTFUL)
    page = render_report(report(doubtful))
    shown = text_of(page)
    assert f"U: not stated, because the verdict is {verdict}: {DOUBTFUL[0]}." in shown
    assert "a range of 6.00 arcsec; U is not stated." in shown
    assert "No statement of conformity, because U is not stated." in shown
    assert '<tr><th scope="row">90</th><td>−6.00</td><td>–</td></tr>' in page
    assert "with U ≤" not in shown
    assert doubtful.to_dict()["std"]["ECC"][3] == pytest.approx(0.4 * ARCSEC)
    hatched, plain = (p.count("<pattern") for p in (page, whole))
    assert (hatched > 0, plain) == (True, 0)


@pytest.mark.slow
def test_a_band_far_from_the_injected_truth_is_not_valid():
    """The table with a radial harmonic: U 1.2 arcsec beside an error of 8, verdict ok."""
    angles = np.deg2rad(np.arange(12) * 30.0)
    error = 4.0 * ARCSEC * (np.cos(angles) - 1.0)
    std = np.full(12, 0.6 * ARCSEC)
    std[0] = 0.0
    wrong = result(deviations={"ECC": error}, std={"ECC": std})
    truth = {"angles_rad": angles.tolist(), "deviations": {"ECC": [0.0] * 12}}
    reason = why_withheld(wrong, truth)
    assert "ECC at 180 degrees is 8 arcsec off" in reason
    assert "6.7 times its U of 1.2 arcsec" in reason
    assert "U: not stated, because ECC at 180" in text_of(
        render_report(report(wrong, truth=truth))
    )
    honest = {**truth, "deviations": {"ECC": (error + std).tolist()}}
    assert why_withheld(wrong, honest) is None
    assert why_withheld(wrong) is None


@pytest.mark.usefixtures("without_figures")
def test_what_u_does_not_cover_is_said_beside_it():
    from rotcal_ros.foundation.protection import Protection

    bare = result(protections=(Protection("knock", "not protected", "nothing sees it"),))
    assert "It does not cover: knock." in text_of(render_report(report(bare)))


def test_rejected_and_skipped_are_counted_truly(whole, bare):
    assert "1 rejected by the solver, 0 during the capture" in text_of(whole)
    assert "24 observations, 1 rejected by the solver" in text_of(bare)


def test_the_budget_adds_up_and_says_what_corrects_the_air(whole):
    """0.6 and 0.8 of u = 0.40: 36 and 64 % of the variance."""
    page = whole
    for cells in (("0.24", "36 %"), ("0.32", "64 %"), ("0.40", "100 %")):
        assert "".join(f"<td>{cell}</td>" for cell in cells) in page
    assert '<th scope="row">Expanded uncertainty U (k = 2)</th><td>0.80</td>' in page
    assert "refraction of the air: corrected by the tracer" in text_of(page)


def test_instruments_stand_with_serial_numbers_and_dates(whole):
    cells = ("Tracers LT", "99", "2026-01-15", "C-1")
    assert '<th scope="row">Tracer</th>' + "".join(f"<td>{c}</td>" for c in cells) in whole
    assert '<th scope="row">Thermometer</th><td>not stated</td><td>7</td>' in whole


def test_a_result_read_back_gives_the_same_page(whole):
    again = Result.from_dict(json.loads(result().to_json()))
    assert render_report(report(again)) == whole


@pytest.mark.usefixtures("without_figures")
def test_details_are_told_in_words_and_long_arrays_left_out():
    plane = {"tilt_rad": 2e-6, "unit_normal": [0.0, 0.0, 1.0], "all_heights": [0.5] * 9}
    page = text_of(render_report(report(result(details={"fitted_plane": plane}))))
    assert "fitted plane" in page
    assert "tilt rad 2e-06; unit normal (0, 0, 1)" in page
    assert "all heights" not in page
