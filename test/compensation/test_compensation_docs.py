from pathlib import Path

import pytest

from rotcal_ros.compensation.controllers import controller_names, make_controller
from rotcal_ros.foundation.settings import declarations

DOCS = Path(__file__).parents[2] / "docs" / "controllers.md"


@pytest.mark.parametrize("name", controller_names())
def test_docs_say_what_the_program_says(name):
    """Sign, wrap, resolution, source and what is not verified, word by word."""
    text = " ".join(DOCS.read_text().split())
    controller = make_controller(name)
    facts = controller.facts
    assert f"## {facts.title} (`{name}`)" in text
    for fact in (facts.sign, facts.wrap, facts.unit, facts.source, facts.verified_on):
        assert fact in text
    section = text.split(f"(`{name}`)")[1].split(" ## ")[0]
    for declared in declarations(type(controller)):
        assert f"`{declared.name}` = " in section
        assert declared.info.description in section
    for open_question in controller.unverified:
        assert open_question in text
