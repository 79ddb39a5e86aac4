"""Serving the page from a thread of its own."""

from __future__ import annotations

import socket
from ipaddress import IPv6Address, ip_address
from pathlib import Path
from threading import Thread
from typing import Final

import uvicorn

from rotcal_ros.compensation.secret import Secret
from rotcal_ros.extensions.page.app import Actions, make_app
from rotcal_ros.extensions.page.board import Board
from rotcal_ros.extensions.page.settings import LOOPBACK, PageSettings
from rotcal_ros.foundation.errors import ConfigurationError

CLOSING_S: Final = 2
"""Time for viewers to hear the end."""
MOST_VIEWERS: Final = 64


class PageServer:
    """Serves a board from its construction on; ``address`` is what a browser opens.

    Raises ConfigurationError when the port is taken or the password cannot be read.
    """

    def __init__(self, settings: PageSettings, board: Board, actions: Actions) -> None:
        password = Secret(Path(settings.password_file)) if settings.password_file else None
        host = LOOPBACK if settings.host == "localhost" else settings.host
        listening = _listen(host, settings.port)
        port = listening.getsockname()[1]
        self.address = f"http://{_name(host)}:{port}"
        self._board = board
        self._server = uvicorn.Server(
            uvicorn.Config(
                make_app(board, actions, host, password),
                log_level="warning",
                lifespan="off",
                limit_concurrency=MOST_VIEWERS,
                timeout_graceful_shutdown=CLOSING_S,
                server_header=False,
            )
        )
        self._thread = Thread(
            target=self._server.run, args=([listening],), name="page", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Tell all viewers that the cell has been switched off, and end."""
        self._board.show(ended=True)
        self._server.should_exit = True

    @property
    def closed(self) -> bool:
        """Whether the server has ended."""
        return not self._thread.is_alive()


def _name(host: str) -> str:
    """Return a host's name for a browser; for all interfaces it is the machine's name."""
    if ip_address(host).is_unspecified:
        return socket.gethostname()
    return f"[{host}]" if ":" in host else host


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if isinstance(ip_address(host), IPv6Address) else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
        listening.listen()
    except OSError as error:
        listening.close()
        raise ConfigurationError(
            f"the page cannot be served on {host}, port {port}: {error.strerror}; choose another "
            "page.port, or 0 for any free one"
        ) from error
    return listening
