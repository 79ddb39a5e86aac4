"""Lengths that count vacuum wavelengths in air that changes, and the truth behind them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rotcal_ros as rc
from rotcal_ros.evaluation.power import PowerBench
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.methods.air import BY_INSTRUMENT, with_common
from rotcal_ros.methods.calibration import prepare, prepare_to_measure
from rotcal_ros.methods.configuration import changed, read_configuration

DATA = Path(__file__).parents[2] / "examples" / "data"
RAW = [
    "simulation.air={published: true, vacuum_lengths: true, pressure_swing_pa: 1000.0, "
    "noise_pa: 0.0}",
    "simulation.temperature.length_um_per_m_k=0",
    "simulation.temperature.dead_distance_um_per_k=0",
    "capture.pressure_expected=true",
    "capture.humidity_expected=true",
]
CIDDOR = "air={refraction: ciddor, vacuum_wavelength_nm: 632.8, dead_path_m: 0.4}"


def configured(name, *changes):
    return changed(read_configuration(DATA / f"{name}.yaml"), [*RAW, *changes])


@pytest.fixture(scope="module", params=["tracer", "tracer_six"])
def measured(request):
    """The name of a method's sample and raw observations of it."""
    return request.param, rc.simulate_observations(configured(request.param, CIDDOR))


@pytest.mark.slow
def test_corrected_lengths_give_the_truth_and_raw_ones_do_not(measured):
    name, observations = measured
    corrected = configured(name, CIDDOR)
    result = rc.solve(observations, corrected)
    truth = rc.simulated_truth(corrected)
    assert result.verdict == "ok"
    for component, values in result.deviations.items():
        error = np.abs(values - truth[component])
        assert error.max() < 4.0 * result.std[component].max()
    raw = rc.solve(observations, configured(name))
    assert raw.verdict != "ok"


@pytest.mark.slow
def test_corrected_lengths_are_those_of_a_cell_without_air():
    """The same cell, once in air and once with an instrument that needs no correction."""
    air = configured("tracer", CIDDOR)
    vacuum = configured("tracer", "simulation.air.vacuum_lengths=false")
    raw = rc.simulate_observations(air)
    inside = prepare(air).refraction.corrected(raw)
    outside = rc.simulate_observations(vacuum)
    change = np.array([a.mean[0] - b.mean[0] for a, b in zip(inside, outside, strict=True)])
    # A sensor is read 5 s before the step, in which the pressure changes by 30 Pa at most.
    assert np.ptp(change) < 1.5 * 30 * 2.7e-9 * 1.0
    untouched = np.array([a.mean[0] - b.mean[0] for a, b in zip(raw, outside, strict=True)])
    assert np.ptp(untouched) > 50e-6


@pytest.mark.slow
def test_the_circumstances_say_either_way(measured):
    name, observations = measured
    said = rc.solve(observations, configured(name, CIDDOR)).circumstances
    assert said.refraction.startswith("Ciddor (1996) with 632.8 nm in vacuum")
    assert "standard uncertainty" in said.refraction
    assert said.pressure_pa.highest - said.pressure_pa.lowest > 500.0
    assert said.humidity.mean == 0.5
    assert prepare(configured(name)).refraction.describe(observations) == BY_INSTRUMENT
    plate = prepare(read_configuration(DATA / "ball_plate.yaml"))
    assert plate.refraction.describe(()) == Circumstances().refraction == ""


def test_values_that_are_given_serve_where_none_is_captured(measured):
    name, observations = measured
    silent = [replace(o, pressure_pa=None, humidity=None) for o in observations]
    with pytest.raises(DataError, match=r"pressure_pa.*air_pressure.*air\.pressure_pa"):
        rc.solve(silent, configured(name, CIDDOR))
    given = configured(name, CIDDOR, "air.pressure_pa=101325.0", "air.humidity=0.5")
    corrected = prepare(given).refraction.corrected(silent)
    assert len(corrected) == len(silent)
    own = prepare(given).refraction.corrected(observations)
    assert own == prepare(configured(name, CIDDOR)).refraction.corrected(observations)


def test_air_that_nobody_will_tell_is_refused_before_anything_moves():
    deaf = configured("tracer", CIDDOR, "capture.pressure_expected=false")
    with pytest.raises(ConfigurationError, match=r"capture\.pressure_expected"):
        prepare_to_measure(deaf)
    prepare_to_measure(configured("tracer", CIDDOR))


def test_an_error_common_to_all_is_fully_correlated():
    result = rc.read_result(DATA / "result_ball_plate.json")
    shift = np.linspace(0.0, 1e-6, len(result.angles))
    moved = replace(result, deviations={n: v + shift for n, v in result.deviations.items()})
    widened = with_common(result, moved)
    for name in result.components:
        added = widened.covariance[name] - result.covariance[name]
        assert added == pytest.approx(np.outer(shift, shift), rel=1e-6, abs=1e-18)
        assert widened.std[name] == pytest.approx(np.hypot(result.std[name], shift), rel=1e-12)


@pytest.mark.slow
def test_an_uncertain_index_makes_the_result_more_uncertain(measured):
    name, observations = measured
    sure = rc.solve(observations, configured(name, CIDDOR, "air.temperature_std_k=0"))
    unsure = rc.solve(observations, configured(name, CIDDOR, "air.temperature_std_k=5.0"))
    assert unsure.deviations["ECC"].tolist() == sure.deviations["ECC"].tolist()
    assert any(np.any(unsure.std[n] > sure.std[n]) for n in sure.components)
    assert all(np.all(unsure.std[n] >= 0.999999 * sure.std[n]) for n in sure.components)


@pytest.mark.parametrize("name", ["tracer", "tracer_six"])
def test_what_is_predicted_are_distances_already(name):
    """Their uncertainty is that of a cell whose instrument corrects; no air is asked for."""
    plain = prepare(read_configuration(DATA / f"{name}.yaml"))
    other = prepare(changed(read_configuration(DATA / f"{name}.yaml"), [CIDDOR]))
    expected = plain.solve(plain.nominal_observations())
    found = other.of_distances.solve(other.nominal_observations())
    assert (found.verdict, found.std.keys()) == ("ok", expected.std.keys())
    for component, values in expected.std.items():
        assert found.std[component].tolist() == values.tolist()


def test_the_verbs_that_predict_ask_for_no_air():
    corrected = changed(read_configuration(DATA / "tracer.yaml"), [CIDDOR])
    found = rc.uncertainty(corrected, trials=100, workers=1)
    assert found.result.verdict == "ok"
    assert PowerBench(prepare(corrected), 1).plain(0).verdict == "ok"


def test_only_what_the_correction_cannot_do_without_is_required():
    def required(name, *changes):
        calibration = prepare(configured(name, *changes))
        return calibration.refraction.required(calibration.configuration.capture)

    assert required("tracer") == frozenset()
    assert required("tracer", CIDDOR) == {"temperature", "pressure", "humidity"}
    assert required("tracer", CIDDOR, "air.humidity=0.5") == {"temperature", "pressure"}
