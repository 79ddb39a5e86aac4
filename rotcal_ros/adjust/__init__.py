"""The engine of adjustment: what residuals say of groups of observations, for any method.

A method hands over a :class:`~.model.Model` and gets all from :func:`~.engine.adjust`: start,
noise, causes, verdict (docs/engine.md).
"""
