"""The player: a recorded bag, published again for nodes and viewers."""
