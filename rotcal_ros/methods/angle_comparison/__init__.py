"""Comparison of two circles: the table beside a polygon, an indexing table or another encoder."""
