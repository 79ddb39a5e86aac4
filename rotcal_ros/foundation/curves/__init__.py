"""Deviation curves: as they were measured, and continued between the measured angles."""
