"""What the shell offers for a parameter when Tab is pressed; loads nothing that takes time.

Switched on by one line in the shell's own configuration: docs/command_line.md.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import click
from click.shell_completion import CompletionItem

from rotcal_ros.foundation import plugins

FOLDER: Final = "config"
"""Where configurations are usually kept."""
SUFFIX: Final = ".yaml"


def configurations(
    _context: click.Context, _parameter: click.Parameter, typed: str
) -> list[CompletionItem]:
    """Offer the configurations that begin with ``typed``; without any, the shell's own files."""
    folder = Path(typed) if typed.endswith("/") else Path(typed).parent
    begin = "" if typed.endswith("/") else Path(typed).name
    here = [path for path in _seen(folder) if path.name.startswith(begin)]
    found = [str(path) for path in here if path.suffix == SUFFIX and path.is_file()]
    if folder == Path() and FOLDER.startswith(typed):
        found += [str(path) for path in _seen(Path(FOLDER)) if path.suffix == SUFFIX]
    return [CompletionItem(path) for path in found] or [CompletionItem(typed, type="file")]


def controller_names(
    _context: click.Context, _parameter: click.Parameter, typed: str
) -> list[CompletionItem]:
    """Offer the controllers that files can be written for."""
    return _beginning(plugins.names(plugins.CONTROLLERS), typed)


def formats(
    _context: click.Context, _parameter: click.Parameter, typed: str
) -> list[CompletionItem]:
    """Offer the controllers, and the form that no controller reads but every program can."""
    return _beginning((*plugins.names(plugins.CONTROLLERS), "volumetric"), typed)


def method_names(
    _context: click.Context, _parameter: click.Parameter, typed: str
) -> list[CompletionItem]:
    """Offer the measuring methods."""
    return _beginning(plugins.names(plugins.METHODS), typed)


def _beginning(names: tuple[str, ...], typed: str) -> list[CompletionItem]:
    return [CompletionItem(name) for name in names if name.startswith(typed)]


def _seen(folder: Path) -> list[Path]:
    """Return what is in a folder and not hidden; nothing where it may not be read."""
    try:
        return sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except OSError:
        return []
