"""Set-up files of plain tables: a whole configuration, or what a method takes instead."""

from __future__ import annotations

from pathlib import Path

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.untrusted import load_yaml, read_text, why
from rotcal_ros.methods.configuration import (
    Configuration,
    dump_configuration,
    parse_configuration,
    read_configuration,
)
from rotcal_ros.methods.method import find_method, method_names


def read_setup(path: Path) -> Configuration:
    """Return the configuration that a set-up file states.

    A file with ``method: NAME`` at the top is one too where the method knows what its other
    entries mean, as the ball plate does with those of a plate. Raises ConfigurationError.
    """
    try:
        document = load_yaml(read_text(path), str(path))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"cannot read the set-up {path}: {why(error)}") from error
    name = document.get("method") if isinstance(document, dict) else None
    short_setup = find_method(name).short_setup if name in method_names() else None
    if name is None or short_setup is None:
        return read_configuration(path)
    text = dump_configuration(name, short_setup(document, str(path)))
    return parse_configuration(text, str(path))
