"""Laser tracker and plane mirror: everything that belongs to this method."""
