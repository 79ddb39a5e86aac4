"""The short form of ``make fuzz``: what was found once, and a few new cases of every target."""

import os

import pytest
from fuzzing import broken, corpus, run
from targets import TARGETS

SECONDS = float(os.environ.get("ROTCAL_FUZZ_SECONDS", "0"))
"""For each target; without it a few cases, always the same, however fast the machine is."""
CASES = 8


@pytest.mark.slow
@pytest.mark.parametrize("name", TARGETS)
def test_good_input_and_old_findings_are_read(name, tmp_path):
    for data in [*[*TARGETS[name].seeds()][:1], *corpus(name)]:
        finding = broken(TARGETS[name], data, tmp_path)
        assert finding is None, finding.trace


@pytest.mark.slow
@pytest.mark.parametrize("name", TARGETS)
def test_harmed_input_ends_in_a_value_or_in_one_sentence(name):
    most = 1 << 62 if SECONDS else 1 if name == "report" else CASES
    cases, findings = run(name, seed=1, seconds=SECONDS or 600.0, most=most)
    assert cases > 0
    assert not findings, "\n".join(f"{f.what}\n{f.trace}\n{f.data[:2000]!r}" for f in findings[:3])
