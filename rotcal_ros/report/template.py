"""The templates of all pages, with one look."""

from __future__ import annotations

from jinja2 import Environment, PackageLoader, StrictUndefined


def environment() -> Environment:
    """Return the environment that escapes what it is given and refuses unknown names."""
    return Environment(
        loader=PackageLoader("rotcal_ros.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
