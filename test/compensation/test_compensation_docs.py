from pathlib import Path

import pytest

from rotcal_ros.compensation.controllers import CONTROLLERS, make_settings

DOCS = Path(__file__).parents[2] / "docs" / "compensation.md"


@pytest.mark.parametrize("name", CONTROLLERS)
def test_docs_say_what_the_program_says(name):
    """Sign, wrap, resolution, source and what is not verified, word by word."""
    text = " ".join(DOCS.read_text().split())
    kind = CONTROLLERS[name]
    assert f"### {kind.title} (`{name}`)" in text
    for fact in (kind.sign, kind.wrap, kind.unit, kind.source):
        assert fact in text
    for open_question in kind.unverified(make_settings(name, {})):
        assert open_question in text
