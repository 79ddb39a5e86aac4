"""The node of the history."""
