"""The adapter as a node, the controllers that it orders, and what a check hears for it."""
