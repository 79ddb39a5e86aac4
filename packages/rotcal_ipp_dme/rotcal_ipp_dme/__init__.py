"""I++ DME (VDMA 8722): a measuring machine with its rotary table over one TCP session."""

from rotcal_ros.foundation.plugins import GroupNode, Verb

VERB = Verb("Serve the simulated cell to clients of I++ DME.", f"{__name__}.verbs", "bag")
NODE = GroupNode("dme_adapter", roles=("table", "probe"), instead_of=("simulation",), polled=True)
"""The adapter; ``rotcal dme serve`` plays a simulated machine for it, which needs no node."""
