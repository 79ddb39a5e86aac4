"""Whether a machine is at work, asked of a program that can tell."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence

from rotcal_ros.errors import ControllerError


def work_of(command: Sequence[str], timeout_s: float) -> str:
    """Return what the machine is doing in words, empty when it rests or nobody can tell.

    ``command`` ends with exit code 0 when the machine rests, and with 1 and a line that says why
    when it does not; an empty command: nobody can tell. Raises ControllerError when there is no
    answer within ``timeout_s`` or any other one: what is not known is no rest.
    """
    if not command:
        return ""
    name = " ".join(command)
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=timeout_s, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ControllerError(
            f"it is not known whether the machine is at work ({name}: {error}): nothing was "
            "changed"
        ) from error
    last = (done.stdout.strip() or done.stderr.strip()).rpartition("\n")[2]
    if done.returncode not in (0, 1):
        raise ControllerError(
            f"it is not known whether the machine is at work ({name} ended with code "
            f"{done.returncode}: {last}): nothing was changed"
        )
    return (last or f"{name} says so") if done.returncode else ""
