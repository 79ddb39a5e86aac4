"""Between a DME client and its server: notes what the client orders, and answers in its place."""

import re
import socket
from threading import Thread

ERROR = '{tag} &\r\n{tag} ! Error(3, 1006, "PtMeas", "Surface not found")\r\n{tag} %\r\n'
NEVER_DONE = "{tag} &\r\n"


class Relay:
    """Listens at ``port``; ``orders`` holds the methods of all clients, in their order.

    ``answers`` are given once each, to the next order of a method: method -> lines.
    """

    def __init__(self, server_port):
        self._server_port, self._open = server_port, []
        self.orders, self.answers, self.clients = [], {}, 0
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        Thread(target=self._listen, daemon=True).start()

    def close(self):
        for connection in (self._listener, *self._open):
            connection.close()

    def _listen(self):
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            self.clients += 1
            server = socket.create_connection(("127.0.0.1", self._server_port))
            self._open += [client, server]
            Thread(target=self._to_server, args=(client, server), daemon=True).start()
            Thread(target=self._to_client, args=(client, server), daemon=True).start()

    def _to_server(self, client, server):
        try:
            for line in client.makefile("rb"):
                tag, method = re.match(r"(\w{5}) (\w+)", line.decode()).groups()
                answer = self.answers.pop(method, None)
                self.orders.append(method)
                if answer is None:
                    server.sendall(line)
                else:
                    client.sendall(answer.format(tag=tag).encode())
            server.shutdown(socket.SHUT_WR)
        except OSError:
            return

    def _to_client(self, client, server):
        try:
            while received := server.recv(65536):
                client.sendall(received)
            client.shutdown(socket.SHUT_WR)
        except OSError:
            return
