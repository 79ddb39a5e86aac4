"""A table of numbers, solved on a page in a browser."""

from rotcal_ros.foundation.plugins import Verb

VERB = Verb("Open a page on which a table of numbers is solved.", f"{__name__}.verbs", "solve")
"""``rotcal web``: the page for people who do not use the command line."""
PAIRS = Verb(
    "Write commanded and actual angles of a bag as a table.", f"{__name__}.pair_verb", "solve"
)
"""``rotcal pairs``: deviations that a bag holds already."""
