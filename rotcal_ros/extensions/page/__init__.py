"""Pages in a browser, without ROS: of a running calibration, and of somebody's table."""

from rotcal_ros.foundation.plugins import Verb

VERB = Verb("Open a page on which a table of numbers is solved.", f"{__name__}.verbs", "solve")
"""``rotcal web``: the page for people who do not use the command line."""
