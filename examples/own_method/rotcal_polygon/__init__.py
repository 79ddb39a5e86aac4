"""Optical polygon and autocollimator: a method for rotcal_ros that lives in its own package."""
