"""Many bags at once: found, solved on all cores or a cluster, for the history of all tables."""

from rotcal_ros.foundation.plugins import Verb

VERB = Verb(
    "Solve many bags with one configuration, on all cores or a cluster.",
    f"{__name__}.verbs",
    "bag",
)
