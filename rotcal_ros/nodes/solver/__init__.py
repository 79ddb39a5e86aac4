"""The solver node: computes deviations and the compensation table from observations."""
