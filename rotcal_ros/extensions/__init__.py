"""What a calibration can do without: one folder each, found by the entry points in setup.py."""
