"""Measuring plans: which table angle, which target, in which order."""
