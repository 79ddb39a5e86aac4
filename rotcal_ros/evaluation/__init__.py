"""Checks whether results are true: ISO 230-2, comparison, Monte Carlo, harmonics."""
