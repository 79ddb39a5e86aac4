"""Laser tracer on the table, reflector on the probe: the multi-station method."""
