"""Servers that answer by a script, and live cells, ended with their test."""

import sys
from pathlib import Path

import pytest
from wire import ScriptedServer

CORE = Path(__file__).parents[3] / "test"
sys.path += [str(CORE / f) for f in ("nodes", "nodes/check", "compensation", "cli", "fuzz")]

from live_cell import cell, rotcal  # noqa: E402, F401


@pytest.fixture
def serve():
    servers = []

    def make(*harm, **answers):
        servers.append(ScriptedServer(*harm, answers=answers))
        return servers[-1]

    yield make
    for server in servers:
        server.close()
