"""Recordings: the observations of a bag or a table, captured again and solved again."""
