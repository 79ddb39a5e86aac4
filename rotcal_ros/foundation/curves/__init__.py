"""Deviation curves: as measured, and continued between the measured angles."""
