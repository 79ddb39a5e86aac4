"""The adapter as a node, the controllers that it commands, and its check before it runs."""
