"""Taking up an interrupted plan: planner and solver read the same continuation file."""

from __future__ import annotations

from pathlib import Path

from rclpy.node import Node

from rotcal_ros.catalogue.continuation import Continuation
from rotcal_ros.errors import DataError


def read_continuation(node: Node) -> Continuation | None:
    """Declare ``continuation_file`` and return what it holds; None when it is not given."""
    path = node.declare_parameter("continuation_file", "").value
    if not path:
        return None
    try:
        return Continuation.from_json(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(f"cannot read the continuation {path}: {error}") from error
