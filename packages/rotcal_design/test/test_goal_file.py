"""The file of a goal is read as strictly as a configuration."""

import pytest

from rotcal_design.goal import goal_settings
from rotcal_ros.foundation.errors import ConfigurationError


def test_what_is_given_twice_or_means_something_else_is_refused(tmp_path):
    goal = tmp_path / "goal.yaml"
    goal.write_text("need_arcsec: 1\nneed_arcsec: 2\n")
    with pytest.raises(ConfigurationError, match=r"goal.yaml: line 2: need_arcsec is given a sec"):
        goal_settings(None, goal, [])
    with pytest.raises(ConfigurationError, match="1_0 is 10"):
        goal_settings(None, None, ["need_arcsec=1_0"])
