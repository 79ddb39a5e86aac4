"""The command line of the player."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path


def read_arguments(argv: Sequence[str]) -> Namespace:
    """Return what the player is asked for; the process ends where that is nothing it knows."""
    parser = ArgumentParser(prog="player")
    parser.add_argument("bag", type=Path)
    parser.add_argument("--rate", type=float, default=1.0)
    parser.add_argument("--clock", action="store_true")
    parser.add_argument("--all", dest="everything", action="store_true")
    parser.add_argument("--no-finish", action="store_true")
    parser.add_argument("--wait-for", dest="nodes", action="append", default=[])
    parser.add_argument("--watcher", dest="watchers", action="append", default=[])
    parser.add_argument("--result", type=Path)
    return parser.parse_args(argv)
