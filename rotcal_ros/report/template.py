"""The templates of all pages, with one look, and figures inside a page.

A figure in a file of its own keeps its colours. Within a page it has a name for screen readers and
uses the custom properties ``--figure-...``, which the page sets for its dark scheme.
"""

from __future__ import annotations

import re
from functools import cache, partial
from html import escape
from typing import Any, Final

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from rotcal_ros import __version__
from rotcal_ros.foundation.escapes import printable, printable_lines
from rotcal_ros.foundation.language import SPOKEN, Language, Phrase, language
from rotcal_ros.methods.figures import style

_OWN: Final = "rotcal_ros.report"


def render(template: str, *, package: str = _OWN, **values: Any) -> str:
    """Return the page with every value escaped; a name without a value raises.

    The template lies in the folder ``templates`` of ``package``, and may include the style
    and the parts of all pages, which are here.
    """
    template_file = _environment(package, SPOKEN.get().code).get_template(f"{template}.html.j2")
    return template_file.render(values, version=__version__)


@cache
def _environment(package: str, code: str) -> Environment:
    """Return the environment that compiles each template of a package once for a language."""
    spoken = language(code)
    environment = Environment(
        loader=ChoiceLoader(
            [PackageLoader(name, "templates") for name in dict.fromkeys((package, _OWN))]
        ),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=partial(_visible, spoken),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["t"] = spoken
    environment.filters |= {
        "drawn": partial(_drawn, spoken),
        "quoted": partial(_quoted, spoken),
        "capitalize_first": partial(_sentence, spoken),
        "foreign": partial(_foreign, spoken),
    }
    return environment


def _visible(spoken: Language, value: Any) -> Any:
    """Return a value with its texts printable, phrases translated; markup stays as it is."""
    return printable_lines(spoken.say(value)) if type(value) in (str, Phrase) else value


def _sentence(spoken: Language, text: str) -> str:
    text = spoken.say(text)
    return text[:1].upper() + text[1:]


def _foreign(spoken: Language, text: Any) -> Markup:
    """Return the attribute of an element whose text, one of ours, no catalogue knows."""
    unknown = isinstance(text, Phrase) and " " in text and not spoken.has_translation(text)
    return Markup(' lang="en"' * unknown)


def _drawn(spoken: Language, svg: str, name: str) -> Markup:
    """Return a figure of ours as it stands in a page."""
    return Markup(inline_svg(svg, spoken.say(name)))


def _quoted(spoken: Language, text: str) -> Markup:
    """Return any text for use between the quotes of a style sheet, without syntax in it."""
    text = spoken.say(text)
    return Markup("".join(c if c.isalnum() or c == " " else f"\\{ord(c):x} " for c in text))


PROPERTIES: Final = {
    style.INK: "ink",
    style.BLUE: "blue",
    style.ORANGE: "orange",
    style.GREEN: "green",
    style.RED: "red",
    style.GREY: "grey",
    style.MISSING: "missing",
    style.GRID: "grid",
    style.PAPER: "paper",
}
"""The colours of our figures and the custom properties that replace them."""

_COLOUR: Final = re.compile("|".join(PROPERTIES))


def inline_svg(svg: str, name: str) -> str:
    """Return ``svg`` with a name for screen readers and the colours of its page."""
    attributes = f'<svg role="img" aria-label="{escape(printable(name))}" '
    coloured = _COLOUR.sub(lambda found: f"var(--figure-{PROPERTIES[found[0]]}, {found[0]})", svg)
    return coloured.replace("<svg ", attributes, 1)
