"""Texts of this page that come as data, for its catalogues."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from rotcal_ros.methods.method import method_names
from rotcal_tables.table_work import WorkRequest, advise_plan
from rotcal_tables.web import page_settings


def texts() -> Iterator[str]:
    """Yield what the page says of each setting that it asks for, and of instruments."""
    for method in method_names():
        for asked in page_settings(method):
            yield asked["meaning"][0]
    nothing_owned = WorkRequest(Path(), {}, "", options={"arguments": ()})
    yield from advise_plan(nothing_owned)["instruments"].values()
