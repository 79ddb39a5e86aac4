"""Laser tracker and plane mirror: everything that this method brings."""
