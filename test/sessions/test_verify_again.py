"""``rotcal verify --again``: what is left is added to the table, and the sum is measured.

The simulated axis is asked for its true angle; lengths and their noise are made here.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.session_folder import SessionFolder
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import changed, prepare, read_configuration
from rotcal_ros.methods.simulation.table import true_runs
from rotcal_ros.recordings.result_sources import ResultSource, read_source
from rotcal_ros.report.verification import verification_section
from rotcal_ros.sessions import verification
from rotcal_ros.sessions.session import Session

DEMO = Path(__file__).parents[2] / "config" / "verify_demo.yaml"
QUIET = (
    "simulation.table.repeatability_arcsec=0.0",
    "plan.order=targets_per_station",
    "plan.box_points=[3, 2, 2]",
)
PLAY = ("plan.bidirectional=true", "simulation.table.backlash_arcsec=6.0")
LENGTH_STD = 3e-8


def lengths(calibration, seed, plant=None):
    """What the tracer reads on the simulated axis with the table that it has now."""
    settings, plan = plant or calibration.configuration.simulation, calibration.plan
    angles, rng = np.array(plan.distinct_angles), np.random.default_rng(100 + seed)
    off = dict(zip((Approach.POSITIVE, Approach.NEGATIVE), true_runs(settings, angles, 1),
                   strict=True))  # fmt: skip
    mount = np.array(settings.tracer.mount_m)
    for step, seen in zip(plan.steps, calibration.nominal_observations(), strict=True):
        turn = step.table_angle + off[step.approach][angles == step.table_angle, 0][0]
        c, s = np.cos(turn), np.sin(turn)
        station = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ mount
        length = np.linalg.norm(step.position - station) - settings.tracer.dead_distance_m
        yield replace(seen, mean=(float(length + LENGTH_STD * rng.standard_normal()),))


@pytest.fixture
def rounds(monkeypatch):
    """Measure without ROS; the configurations of all rounds by their names."""
    found = {}

    def measure(configuration, folder, changes, _whole):
        made = prepare(changed(read_configuration(configuration), changes))
        folder.mkdir(parents=True, exist_ok=True)
        found[folder.name] = made.configuration
        empty = not made.configuration.simulation.table.compensation.angles_deg
        result = made.solve(lengths(made, len(found)), ["none" if empty else "unknown"])
        assert result.verdict == "ok", result.warnings
        return verification.FinishedSession(
            Session(made, SessionFolder(folder)), ResultSource(result, {})
        )

    monkeypatch.setattr(verification, "_measure", measure)
    monkeypatch.setattr(verification, "require_ros", lambda: None)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("more", [(), PLAY])
def test_the_second_round_is_not_worse_than_the_first(tmp_path, rounds, more):
    folder = tmp_path / "out"
    changes = (*QUIET, *more)
    verification.begin_verification(
        DEMO, folder, changes, verification.VerificationRequest(again=True)
    )
    found, _ = verification.run_verification(folder)
    assert list(rounds) == ["out", "after", "again"]
    assert [made.simulation.run for made in rounds.values()] == [0, 1, 2]  # noise of its own
    assert found.verdict == "ok"
    assert found.simulated
    std = max(np.max(found.after.std), np.max(found.again.std))
    assert found.after.systematic < found.before.systematic / 30
    assert found.again.systematic <= found.after.systematic + 4 * std
    # the axis itself, between the measured angles too
    first, second, third = (found.iso[name].systematic for name in ("before", "after", "again"))
    assert second < first / 30
    assert third <= second + 4 * std
    if more:
        assert np.all(np.abs(found.iso["again"].mean_reversal) < 0.5 * ARCSEC)
    # measured on the table in force, added to this very one
    (added,) = (folder / "compensation_added").glob("*.provenance.json")
    side = json.loads(added.read_text())
    in_force = rounds["after"].cell.table_in_force
    assert len(in_force) == 64
    assert side["in_force"].startswith(f"adds to the table {in_force}")
    assert rounds["again"].cell.table_in_force == side["contents_sha256"]
    data = json.loads((folder / "verification.json").read_text())
    assert data["again"]["systematic_E_arcsec"] == pytest.approx(
        found.again.systematic / ARCSEC, rel=1e-12
    )


# A cell that is real by its configuration, and whose axis a simulation turns.


class RealCell:
    """The axis of the demonstration, and a control that a person loads with LinuxCNC's rows."""

    def __init__(self, root):
        self.root, self.rounds, self.rows = root, {}, None
        data = yaml.safe_load(DEMO.read_text())
        groups = data["/**"]["ros__parameters"]
        del groups["simulation"]
        groups["cell"] = {**groups.get("cell", {}), "table_in_force": "none"}
        groups["identity"] = {"serial": "4711"}
        self.configuration = root / "real.yaml"
        self.configuration.write_text(yaml.safe_dump(data))

    def load(self, files, gain=1.0):
        """What a person does: the trims of the .comp file, deg, go into the control."""
        (comp,) = (path for path in files if path.suffix == ".comp")
        self.rows = np.loadtxt(comp) * (1.0, gain, gain)

    def plant(self):
        """The simulated axis with the control's rows."""
        rows = []
        if self.rows is not None:
            names = ("angles_deg", "forward_arcsec", "reverse_arcsec")
            columns = self.rows.T * np.array([[1.0], [3600.0], [3600.0]])
            rows = [
                f"simulation.table.compensation.{name}={column.tolist()}"
                for name, column in zip(names, columns, strict=True)
            ]
        return changed(read_configuration(DEMO), (QUIET[0], *rows)).simulation

    def measure(self, configuration, folder, changes, _whole):
        result_file = SessionFolder(folder).result
        made = prepare(changed(read_configuration(configuration), changes))
        if folder.name not in self.rounds:
            folder.mkdir(parents=True, exist_ok=True)
            result = made.solve(lengths(made, len(self.rounds), self.plant()))
            assert result.verdict == "ok", result.warnings
            result_file.write_text(result.to_json())
            self.rounds[folder.name] = made.configuration
        session = Session(made, SessionFolder(folder))
        return verification.FinishedSession(session, read_source(result_file))


@pytest.fixture
def real(tmp_path, monkeypatch):
    cell = RealCell(tmp_path)
    monkeypatch.setattr(verification, "_measure", cell.measure)
    monkeypatch.setattr(verification, "require_ros", lambda: None)
    return cell


def begun(real, **request):
    folder = real.root / "out"
    asked = verification.VerificationRequest(controllers=("linuxcnc",), **request)
    verification.begin_verification(real.configuration, folder, QUIET[1:], asked)
    return folder


def test_a_real_cell_is_measured_again_once_a_person_has_loaded_the_table(real):
    folder = begun(real)
    asked = []
    assert verification.run_verification(folder, lambda _, files: asked.append(files)) is None
    assert list(real.rounds) == ["out"]  # nothing is measured before the word
    assert verification.run_verification(folder) is None
    assert [path.name for path in asked[0]] == ["c_linuxcnc.comp", "c_linuxcnc.ini"]
    assert all(path.is_file() for path in asked[0])
    real.load(asked[0])
    verification.confirm_loaded(folder)
    found, written = verification.run_verification(folder)
    assert written == ("linuxcnc",)
    assert found.verdict == "ok"
    assert not found.simulated
    assert not found.iso  # nobody knows its true angle
    assert found.after.systematic < found.before.systematic / 30
    assert abs(found.effect.factor) < 0.02
    side = json.loads((folder / "compensation" / "c_linuxcnc.provenance.json").read_text())
    assert side["serial"] == "4711"
    assert real.rounds["after"].cell.table_in_force == side["contents_sha256"]
    with pytest.raises(ConfigurationError, match="no table waiting to be loaded"):
        verification.confirm_loaded(folder)


@pytest.mark.parametrize(
    ("gain", "factor", "words"),
    [(0.0, 1.0, "inactive, or on the wrong axis"), (-1.0, 2.0, "sign is wrong")],
)
def test_a_table_that_a_control_uses_wrongly_is_named_and_not_added_to(real, gain, factor, words):
    folder = begun(real, again=True)

    def loaded(_folder, files):
        real.load(files, gain)
        return True

    found, _ = verification.run_verification(folder, loaded)
    assert list(real.rounds) == ["out", "after"]
    assert found.verdict == "failed"
    assert abs(found.effect.factor - factor) < 4.0 * found.effect.std + 0.01
    assert words in found.fault
    data = json.loads((folder / "verification.json").read_text())
    assert words in data["effect"]["words"]
    assert words in verification_section(found)[1]
    assert not (folder / "compensation_added").exists()


@pytest.mark.slow
def test_the_word_counts_once_for_each_table(real):
    folder = begun(real, again=True)
    assert verification.run_verification(folder) is None
    real.load(sorted((folder / "compensation").iterdir()))
    verification.confirm_loaded(folder)
    assert verification.run_verification(folder) is None  # the sum waits for a word of its own
    assert list(real.rounds) == ["out", "after"]
    real.load(sorted((folder / "compensation_added").iterdir()))
    verification.confirm_loaded(folder)
    found, _ = verification.run_verification(folder)
    assert found.verdict == "ok"
    assert found.again.systematic <= found.after.systematic + 4 * np.max(found.again.std)


def test_a_real_cell_has_to_say_what_is_in_force_and_who_takes_the_table(real):
    with pytest.raises(ConfigurationError, match="Name it: --to linuxcnc"):
        verification.begin_verification(
            real.configuration, real.root / "a", QUIET[1:], verification.VerificationRequest()
        )
    unknown = (*QUIET[1:], "cell.table_in_force=unknown")
    request = verification.VerificationRequest(controllers=("linuxcnc",))
    with pytest.raises(ConfigurationError, match="begins with no table in force"):
        verification.begin_verification(real.configuration, real.root / "a", unknown, request)
    assert not (real.root / "a").exists()
    folder = begun(real)
    with pytest.raises(ConfigurationError, match="no table waiting"):
        verification.confirm_loaded(folder)
