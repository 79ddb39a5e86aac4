"""The templates of all pages, with one look."""

from __future__ import annotations

from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from rotcal_ros import __version__
from rotcal_ros.figures.inline import inline
from rotcal_ros.foundation.escapes import printable_lines


def render(template: str, **values: Any) -> str:
    """Return the page, every value escaped; a name that the template lacks a value for raises."""
    template_file = _environment().get_template(f"{template}.html.j2")
    return template_file.render(values, version=__version__)


@cache
def _environment() -> Environment:
    """Return what compiles each template once."""
    environment = Environment(
        loader=PackageLoader("rotcal_ros.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_visible,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"drawn": _drawn, "quoted": _quoted, "capitalize_first": _sentence}
    return environment


def _visible(value: Any) -> Any:
    """Return a value with its texts printable; what is markup already stays."""
    return printable_lines(value) if type(value) is str else value


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _drawn(svg: str, name: str) -> Markup:
    """Return a figure of ours as it stands in a page."""
    return Markup(inline(svg, name))


def _quoted(text: str) -> Markup:
    """Return any text for between the quotes of a style sheet, nothing in it being syntax."""
    return Markup("".join(c if c.isalnum() or c == " " else f"\\{ord(c):x} " for c in text))
