"""Lines of JSON on standard output, for the program that started this one."""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from typing import Any


def say(event: str, **values: Any) -> None:
    """Print one line; the reader may be gone already."""
    with suppress(BrokenPipeError):
        sys.stdout.write(json.dumps({"event": event, **values}) + "\n")
        sys.stdout.flush()
