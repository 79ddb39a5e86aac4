"""Finds message types by name, and checks whether a recorded one is the installed one."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, Final

from ament_index_python.packages import get_package_share_directory

from rotcal_ros.foundation.errors import BagError


def importable_type(type_name: str, type_hash: str) -> type:
    """Return the class of a recorded message type; BagError if the type differs here.

    ``type_hash`` is that of the recorded definition, empty if it is not known.
    """
    found, here = message_type(type_name), installed_hash(type_name)
    if type_hash and here and type_hash != here:
        raise BagError(
            f"message type {type_name} is defined differently here and in the bag: "
            "source the version with which it was recorded"
        )
    return found


def message_type(type_name: str) -> type:
    """Return the class of a message type (``pkg/msg/Name``); BagError if there is none."""
    package, kind, name = [*type_name.split("/"), "", ""][:3]
    try:
        found: type = getattr(import_module(f"{package}.{kind}"), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise BagError(
            f"message type {type_name} is not installed here ({error}): install its package, or "
            "source the workspace that holds it"
        ) from error
    return found


def numeric_fields(message: Any) -> Iterator[str]:
    """Yield the dotted names of the numbers of a message."""
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            yield from (f"{name}.{inner}" for inner in numeric_fields(value))
        elif isinstance(value, int | float):
            yield name


_VERSION: Final = re.compile(r"<version>\s*([^<\s]+)\s*</version>")
_SHOWN: Final = len("RIHS01_") + 8
"""Characters of a hash that are shown."""
ONE_VERSION: Final = (
    "build your node and rotcal_ros with one version of the messages, and source that one in both "
    "shells"
)


def version_mismatch(type_name: str, type_hash: str) -> str | None:
    """Return in words that a type is defined otherwise elsewhere, by its hash there; None: not.

    What has no hash, there or here, is not judged.
    """
    here = installed_hash(type_name)
    if here is None or not type_hash.startswith("RIHS") or type_hash == here:
        return None
    package = type_name.partition("/")[0]
    return (
        f"another version of {type_name}: {type_hash[:_SHOWN]} there, {here[:_SHOWN]} of "
        f"{package} {installed_version(package)} here"
    )


def installed_version(package: str) -> str:
    """Return the version of an installed package of messages, "?" if it is not known."""
    try:
        found = _VERSION.search((share_folder(package) / "package.xml").read_text())
    except (LookupError, OSError):
        return "?"
    return found[1] if found else "?"


@cache
def installed_hash(type_name: str) -> str | None:
    """Return the hash of a type's definition as it is installed; None if it is not known."""
    package, kind, name = [*type_name.split("/"), "", ""][:3]
    try:
        described = share_folder(package) / kind / f"{name}.json"
        hashes = json.loads(described.read_text())["type_hashes"] if described.exists() else ()
    except (LookupError, OSError):  # it is not installed, or no ROS environment is set
        return None
    return next((h["hash_string"] for h in hashes if h["type_name"] == type_name), None)


def share_folder(package: str) -> Path:
    """Return where an installed package keeps its message definitions; LookupError: nowhere."""
    return Path(get_package_share_directory(package))
