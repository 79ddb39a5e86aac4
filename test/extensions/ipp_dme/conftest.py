"""Servers that answer by a script, ended with their test."""

import pytest
from wire import ScriptedServer


@pytest.fixture
def serve():
    servers = []

    def make(*harm, **answers):
        servers.append(ScriptedServer(*harm, answers=answers))
        return servers[-1]

    yield make
    for server in servers:
        server.close()
