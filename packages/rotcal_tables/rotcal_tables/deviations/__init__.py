"""Deviations that somebody has already: a table of angles and deviations becomes a result."""
