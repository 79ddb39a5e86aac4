"""The templates of all pages, with one look."""

from __future__ import annotations

from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from rotcal_ros import __version__


def render(template: str, **values: Any) -> str:
    """Return the page, every value escaped; a name that the template lacks a value for raises."""
    environment = Environment(
        loader=PackageLoader("rotcal_ros.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(f"{template}.html.j2").render(values, version=__version__)
