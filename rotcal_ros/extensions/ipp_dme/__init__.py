"""I++ DME (VDMA 8722): a measuring machine with its rotary table over one TCP session."""

from rotcal_ros.foundation.plugins import Verb

VERB = Verb("Serve the simulated cell to clients of I++ DME.", f"{__name__}.verbs", "bag")
