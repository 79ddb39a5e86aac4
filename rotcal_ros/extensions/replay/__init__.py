"""The player: a recorded bag, published again for nodes and viewers."""

from rotcal_ros.foundation.plugins import Verb

VERB = Verb("Publish a recorded bag again, for nodes and viewers.", f"{__name__}.verbs", "bag")
