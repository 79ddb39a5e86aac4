"""Laser tracer, multi-station: everything that this method brings."""
