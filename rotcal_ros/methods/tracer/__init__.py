"""Laser tracer, multi-station: everything that belongs to this method."""
