"""The interface for Python: the functions behind the names of ``rotcal_ros``.

They are thin: each takes and returns SI, and calls the package that does the work.
"""
