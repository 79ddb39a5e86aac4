"""The language of trust: words, order, and what the verdict line names."""

from __future__ import annotations

import numpy as np
import pytest

from rotcal_ros.foundation.protection import (
    Effect,
    Protection,
    Treatment,
    ordered,
    split_verdict_line,
)
from rotcal_ros.foundation.results import Result


def result(*protections: Protection) -> Result:
    angles = np.arange(3.0)
    zero = {"ECC": np.zeros(3)}
    return Result(
        "any", angles, zero, zero, {}, sigma0=1.0, dof=3, n_observations=9,
        protections=protections,
    )  # fmt: skip


def test_the_verdict_line_names_what_is_not_protected_in_the_fixed_order() -> None:
    bare = Protection("gauge", "not protected", "no closure")
    late = Protection("drift", "tested", "closure", error=2.1)
    early = Protection("knock", "tested", "jump test", error=2.0)
    allowed = Protection("tilt", "bounded", "stated", error=9.0)
    found = result(bare, late, early, allowed)
    assert found.unprotected == ("drift", "gauge")
    assert found.verdict_line == "ok. Not tested for: drift, gauge"
    assert result(early, allowed).verdict_line == "ok"
    assert found.verdict_words == "ok"
    assert found.not_tested == "drift, gauge"
    assert "Not tested for: drift and similar effects" in result().verdict_line


def test_both_lines_come_apart_again() -> None:
    assert split_verdict_line("ok (SIMULATED). Not tested for: drift, tilt") == (
        "ok (SIMULATED)", "Not tested for: drift, tilt"
    )  # fmt: skip
    assert split_verdict_line("suspect") == ("suspect", "")


def test_protections_survive_a_file_and_a_file_may_have_none() -> None:
    given = (
        Protection("drift", "estimated", "per axis", 0.3),
        Protection("scale", "harmless", "a larger circle of both"),
    )
    data = result(*given).to_dict()
    assert Result.from_dict(data).protections == given
    assert Result.from_dict(result().to_dict()).protections == ()


def test_the_machine_readable_form_tells_people_the_same() -> None:
    data = result(Protection("tilt", "not protected", "no level")).to_dict()
    assert data["verdict"] == "ok"
    assert data["verdict_line"] == "ok. Not tested for: tilt"
    assert data["not_protected"] == ["tilt"]


@pytest.mark.parametrize(("effect", "treatment"), [("drif", "tested"), ("drift", "hoped")])
def test_other_words_are_refused(effect: Effect, treatment: Treatment) -> None:
    with pytest.raises(ValueError, match="expected one of"):
        Protection(effect, treatment, "")


def test_an_effect_stated_twice_is_refused() -> None:
    drift = Protection("drift", "tested", "")
    with pytest.raises(ValueError, match="twice"):
        ordered([drift, drift])
