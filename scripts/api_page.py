"""Puts what each name of ``import rotcal_ros`` does into its page, for the site of `make docs`."""

from __future__ import annotations

import inspect

import rotcal_ros as rc

PLACE = "<!-- `make docs` puts what each of them does here -->"


def filled(page: str) -> str:
    """Return the page with the first sentence of every docstring; ValueError without the place."""
    if PLACE not in page:
        raise ValueError(f"api.md has no line {PLACE}")
    rows = ["| name | what it does |", "| --- | --- |"]
    for name in sorted(rc.__all__):
        value = getattr(rc, name)
        if not isinstance(value, float):
            words = (inspect.getdoc(value) or "").partition("\n\n")[0]
            rows.append(f"| `rc.{name}` | {' '.join(words.split()).replace('``', '`')} |")
    return page.replace(PLACE, "\n".join(rows))
