"""Many bags at once: found, solved on all cores or a cluster, kept as a dataset, and shown."""

from rotcal_ros.foundation.plugins import Verb

VERB = Verb(
    "Solve many bags with one configuration, on all cores or a cluster.",
    f"{__name__}.verbs",
    "solve",
)
