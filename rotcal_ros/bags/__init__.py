"""Bags: writing MCAP safely, reading it tolerantly, replaying it."""
