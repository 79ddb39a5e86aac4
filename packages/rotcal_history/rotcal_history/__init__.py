"""The history of a machine park: all results of all tables, what has changed, when to measure."""

from rotcal_ros.foundation.plugins import Verb

VERB = Verb(
    "Keep the results of all tables: what has changed, what is due?",
    f"{__name__}.verbs",
    "combine",
)
