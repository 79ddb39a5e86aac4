"""The simulated cell: table, probe, tracer and temperature as plain physics."""
