"""Laser tracer at several places of the table: six deviations from lengths alone."""
