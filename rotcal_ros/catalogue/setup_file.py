"""Set-up files of plain tables: a whole configuration, or just the file of a ball plate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from rotcal_ros.catalogue.ball_plate import NAME as BALL_PLATE
from rotcal_ros.configuration import (
    Configuration,
    dump_configuration,
    parse_configuration,
    read_configuration,
)
from rotcal_ros.errors import ConfigurationError
from rotcal_ros.methods.ball_plate.plate import parse_plate

SIGMA = "sigma_centre_m"


def read_setup(path: Path) -> Configuration:
    """Return the configuration that a set-up file states.

    A file with ``method: ball_plate`` and the entries of a plate at the top is one too; there
    ``sigma_centre_m`` states the standard deviation of a centre. Raises ConfigurationError.
    """
    document = _document(path)
    if not isinstance(document, dict) or document.get("method") != BALL_PLATE:
        return read_configuration(path)
    entries = {name: value for name, value in document.items() if name not in ("method", SIGMA)}
    parse_plate(entries, str(path))
    groups: dict[str, Any] = {"plan": {"plate": entries, "measure": "centre"}}
    if SIGMA in document:
        groups["solver"] = {SIGMA: document[SIGMA]}
    return parse_configuration(dump_configuration(BALL_PLATE, groups), str(path))


def _document(path: Path) -> Any:
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"cannot read the set-up {path}: {error}") from error
    except yaml.YAMLError as error:
        raise ConfigurationError(f"{path}: not valid YAML: {error}") from error
