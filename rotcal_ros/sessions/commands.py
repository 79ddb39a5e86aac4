"""The command lines of the node processes of a session."""

from __future__ import annotations

import json
import sys
from typing import Final

from rotcal_ros.foundation.node_names import NODES, VIEWERS, further_nodes
from rotcal_ros.foundation.plugins import node_module
from rotcal_ros.sessions.session import Session

CLIENT: Final = "client"


def node_names(session: Session) -> list[str]:
    """Return the nodes that a session starts.

    Those of every cell, those with a group, and those for people that were asked for.
    """
    further = further_nodes(session.configuration.given)
    return [*NODES, *further, *(VIEWERS[name] for name in session.shown_by)]


def node_command(session: Session, name: str) -> list[str]:
    """Return the command line of a node."""
    command = [*_start(session, node_module(name))]
    command += ["--params-file", str(session.folder.parameters)]
    if name == "recorder":
        # In quotes, so that a folder called 2024 does not become a number.
        command += ["-p", f"recorder.folder:={json.dumps(str(session.folder.path.parent))}"]
        command += ["-p", f"recorder.session:={json.dumps(session.folder.path.name)}"]
        if session.run:
            command += ["-p", f"recorder.run:={session.run}"]
    if name == "planner":
        command += ["-p", "restart_wait_s:=0.0"]  # these nodes are not started again
    if name in ("planner", "solver") and session.run:
        file = json.dumps(str(session.folder.continuation(session.run)))
        command += ["-p", f"continuation_file:={file}"]
    return command


def client_command(session: Session) -> list[str]:
    """Return the command line of the client that sends the goal."""
    file = json.dumps(str(session.folder.configuration))
    command = [*_start(session, f"rotcal_ros.nodes.{CLIENT}"), "-p", f"configuration_file:={file}"]
    if session.continuation is not None:
        command += ["-p", f"start_index:={session.continuation.start_index}"]
    return command


def _start(session: Session, module: str) -> list[str]:
    namespace = session.configuration.cell.namespace
    return [sys.executable, "-m", module, "--ros-args", "-r", f"__ns:={namespace}"]
