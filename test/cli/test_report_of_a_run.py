"""The report at the end of a run, and of a verification, is in the language that was asked for."""

from contextlib import nullcontext
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation.language import SPOKEN


@pytest.fixture
def asked(monkeypatch):
    """The languages in which something was written; nothing starts and nothing is measured."""
    found = []

    def write(*_arguments, **_options):
        found.append(SPOKEN.get().code)
        return {}

    sessions = "rotcal_ros.sessions."
    session = SimpleNamespace(run_log=None, folder=None)
    for name, instead in {
        sessions + "processes.require_ros": lambda: None,
        sessions + "processes.page_can_be_served": lambda: False,
        sessions + "session.prepare_session": lambda *_, **__: session,
        sessions + "attaching.Viewers": MagicMock(),
        sessions + "lasting_output.lasting_output": lambda _: nullcontext(),
        sessions + "running.calibrate": lambda *_, **__: {},
        sessions + "products.session_goal_standing": lambda _: None,
        sessions + "products.write_products": write,
        sessions + "verification.begin_verification": lambda *_, **__: None,
        "rotcal_ros.cli.run.print_outcome": lambda *_, **__: 0,
        "rotcal_ros.cli.run.replace": lambda kept, **_: kept,
        "rotcal_ros.cli.verify._verify": lambda *_: write() or 0,
    }.items():
        monkeypatch.setattr(name, instead)
    return found


@pytest.mark.parametrize("verb", ["run", "verify"])
def test_it_is_english_unless_asked_otherwise(asked, verb):
    for words in ([], ["--language", "de"], ["--language", "en"]):
        rotcal.main([verb, "cell.yaml", *words], standalone_mode=False)
    assert asked == ["en", "de", "en"]
    assert SPOKEN.get().code == "en"
