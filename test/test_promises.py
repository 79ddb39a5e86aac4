"""What docs/compatibility.json promises is there; scripts/promises.py finds what is not."""

import json
import runpy
from pathlib import Path

import pytest
from test_package import with_all

ROOT = Path(__file__).parents[1]
PROMISES = runpy.run_path(str(ROOT / "scripts" / "promises.py"))
broken = PROMISES["broken"]


@with_all
def test_what_was_promised_is_there():
    found, promised = PROMISES["promises"](), json.loads(PROMISES["RECORD"].read_text())
    if any(message["hash"] is None for message in found["messages"].values()):
        del promised["messages"]  # without rotcal_msgs
    lines = list(broken(promised, found))
    assert not lines, "\n".join([*lines, "docs/compatibility.md says what may change when"])


@pytest.mark.parametrize(
    ("found", "line"),
    [
        ({"verbs": {"solve": ["--json", "bag"]}, "exit codes": {"BagError": 2}}, None),
        (
            {"verbs": {"solve": ["--json"]}, "exit codes": {"BagError": 2}},
            "verbs: solve: bag is gone",
        ),
        ({"verbs": {}, "exit codes": {"BagError": 2}}, "verbs: solve is gone"),
        (
            {"verbs": {"solve": ["bag", "--new", "--json"]}, "exit codes": {"BagError": 3}},
            "exit codes: BagError was 2, and is 3",
        ),
    ],
)
def test_what_goes_or_changes_is_named_and_what_comes_is_not(found, line):
    promised = {"verbs": {"solve": ["--json", "bag"]}, "exit codes": {"BagError": 2}}
    assert list(broken(promised, {**found, "new": {}})) == ([] if line is None else [line])


def test_the_code_of_the_nodes_names_the_topics_of_a_recorded_cell():
    rows = json.loads(PROMISES["RECORD"].read_text())["topics"]
    metadata = (ROOT / "test" / "golden" / "tracer" / "bag" / "metadata.yaml").read_text()
    recorded = {
        line.rpartition("/cell/")[2]
        for line in metadata.splitlines()
        if line.strip().startswith("name: /cell/") and line.count("/") == 2
    }
    assert len(recorded) > 10
    assert recorded - set(rows) == set()
