"""What holds of every reading: one line of an error, nothing unseen, no lie."""

from __future__ import annotations

from contextlib import suppress
from typing import Any


class LieError(AssertionError):
    """Something was called sound that an independent reader reads otherwise."""


class suppress_rotcal(suppress):  # noqa: N801  reads like contextlib's
    """Let an expected error pass, if it is one line."""

    def __init__(self) -> None:
        from rotcal_ros.foundation.errors import RotcalError

        super().__init__(RotcalError)

    def __exit__(self, kind: Any, error: Any, trace: Any) -> bool:
        if super().__exit__(kind, error, trace):
            require_one_line(error)
            return True
        return False


def require_one_line(error: BaseException) -> None:
    """Raise AssertionError where a RotcalError says more than a line, or nothing."""
    text = str(error)
    if not text or "\n" in text or len(text) > 2000 or "Error(" in text:
        raise AssertionError(f"no sentence for a person: {text[:300]!r}")


def require_visible(text: str) -> None:
    from rotcal_ros.foundation.escapes import printable_lines

    unseen = sorted(set(text) - set(printable_lines(text)))
    assert not unseen, f"shown as they are: {unseen!r}"
