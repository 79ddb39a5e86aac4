"""The papers whose methods these are: their tables, figures and claims, computed again."""

from rotcal_ros.foundation.plugins import Verb

VERB = Verb("Compute a paper's tables, figures and claims again.", f"{__name__}.verbs", "compare")
