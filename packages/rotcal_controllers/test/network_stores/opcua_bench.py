"""Certificates, servers and settings for the tests of OPC UA."""

import contextlib
import datetime
import json
import os
import signal
import socket
import socketserver
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from rotcal_ros.foundation.machine_load import load_scaled_timeout

START_S = 120.0
PASSWORD = "turn the table"


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def make_certificate(folder, name, server):
    """Write NAME.pem and NAME_key.pem (self-signed, after OPC 10000-6, 6.2.2)."""
    key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now = datetime.datetime.now(datetime.timezone.utc)
    names = [x509.UniformResourceIdentifier(f"urn:test:{name}"), x509.DNSName("localhost")]
    usage = {
        name: name in ("digital_signature", "content_commitment", "key_encipherment",
                       "data_encipherment", "key_cert_sign")
        for name in ("digital_signature", "content_commitment", "key_encipherment",
                     "data_encipherment", "key_agreement", "key_cert_sign", "crl_sign",
                     "encipher_only", "decipher_only")
    }  # fmt: skip
    purpose = ExtendedKeyUsageOID.SERVER_AUTH if server else ExtendedKeyUsageOID.CLIENT_AUTH
    public = key.public_key()
    certificate = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=30))
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.KeyUsage(**usage), critical=True)
        .add_extension(x509.ExtendedKeyUsage([purpose]), critical=False)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(public), critical=False)
        .sign(key, hashes.SHA256())
    )
    (folder / f"{name}.pem").write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    path = folder / f"{name}_key.pem"
    path.write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )
    )
    path.chmod(0o600)


def make_certificates(folder):
    """Of a server, a client, a person, and another server and client that nobody knows."""
    for name in ("server", "bridge", "person", "foreign", "stray"):
        make_certificate(folder, name, server=name in ("server", "foreign"))
    trusted = folder / "trusted"
    trusted.mkdir()
    (trusted / "bridge.pem").write_bytes((folder / "bridge.pem").read_bytes())
    (folder / "password").write_text(PASSWORD + "\n")
    (folder / "password").chmod(0o600)


class Watchdog(threading.Timer):
    """Ends a process that does not get ready."""

    def __init__(self, process):
        super().__init__(START_S, process.kill)

    def __enter__(self):
        self.start()

    def __exit__(self, *_):
        self.cancel()


@dataclass
class Server:
    """A server with the folder of files that it shows; ``directory`` is their node."""

    work: Path
    command: list
    directory: str

    def __post_init__(self):
        self.port = free_port()
        self.folder, self.fault = self.work / "files", self.work / "fault"
        self.folder.mkdir()
        setup = {
            "port": self.port,
            "folder": str(self.folder),
            "fault": str(self.fault),
            "certificate": str(self.work / "server.pem"),
            "key": str(self.work / "server_key.pem"),
            "trusted": str(self.work / "trusted"),
            "user": "operator",
            "password": PASSWORD,
            "user_certificate": str(self.work / "person.pem"),
            "fixed": ["c_csv.csv"],
        }
        (self.work / "setup.json").write_text(json.dumps(setup))
        self.log = (self.work / "log").open("ab")
        self.process = self.pid = None

    def start(self):
        """Start it (anew), and wait until it listens."""
        self.stop()
        self.fault.unlink(missing_ok=True)
        self.say_size(None)
        if self.process is None or self.process.poll() is not None:
            self.process = subprocess.Popen(
                [*self.command, str(self.work / "setup.json")],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.log,
            )  # fmt: skip
        self.process.stdin.write(b"start\n")
        self.process.stdin.flush()
        with Watchdog(self.process):
            lines = iter(self.process.stdout.readline, b"")
            words = next((line.split() for line in lines if line.startswith(b"ready ")), None)
        assert words, (self.work / "log").read_text()[-3000:]
        self.pid = int(words[1])

    def stop(self):
        """Kill it, when it runs, and wait until it is gone."""
        if self.pid is None:
            return
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGKILL)
        if self.pid == self.process.pid:
            self.process.wait()
        while Path(f"/proc/{self.pid}").exists():
            time.sleep(0.01)
        self.pid = None

    def end(self):
        self.stop()
        self.process.terminate()
        self.process.wait(load_scaled_timeout(30))
        self.process.stdin.close()
        self.process.stdout.close()
        self.log.close()

    def fail(self, calls, kind, when, method=""):
        """Fail after ``calls`` calls of methods, or of one of them."""
        self.fault.write_text(f"{calls} {kind} {when} {method}")

    def say_size(self, size):
        """Let the server show this size for every file; None: the true one."""
        said = self.fault.with_name("size_of_all")
        said.unlink(missing_ok=True)
        if size is not None:
            said.write_text(str(size))

    def settings(self, **changes):
        """Return the values of ``bridge.opcua``."""
        return {
            "endpoint": f"opc.tcp://127.0.0.1:{self.port}",
            "directory": self.directory,
            "user": "operator",
            "password_from": f"file:{self.work / 'password'}",
            "certificate": str(self.work / "bridge.pem"),
            "private_key": str(self.work / "bridge_key.pem"),
            "server_certificate": str(self.work / "server.pem"),
            **changes,
        }

    def clear(self):
        for path in self.folder.iterdir():
            path.unlink()

    def files(self):
        return {path.name: path.read_text() for path in self.folder.iterdir()}


def python_server(work):
    command = [sys.executable, str(Path(__file__).with_name("opcua_server.py"))]
    return Server(work, command, "2:Machine/FileSystem")


@contextlib.contextmanager
def silent_port():
    """Yield a port that takes connections and never says anything."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener.getsockname()[1]


class Tap(socketserver.ThreadingTCPServer):
    """Passes on what goes to and from ``port``, and shows it."""

    daemon_threads = True

    def __init__(self, port, show):
        super().__init__(("127.0.0.1", 0), None)
        self.port, self.target, self.show = self.server_address[1], port, show
        threading.Thread(target=self.serve_forever, daemon=True).start()

    def finish_request(self, request, _address):
        with socket.create_connection(("127.0.0.1", self.target)) as other:
            back = threading.Thread(target=self._pass_on, args=(other, request), daemon=True)
            back.start()
            self._pass_on(request, other)
            back.join()

    def _pass_on(self, source, sink):
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                self.show(data)
                sink.sendall(data)
        with contextlib.suppress(OSError):
            sink.shutdown(socket.SHUT_RDWR)

    def __exit__(self, *arguments):
        self.shutdown()
        super().__exit__(*arguments)


@contextlib.contextmanager
def serving(folder):
    """Run our own server, with certificates in ``folder``, as long as the block lasts."""
    make_certificates(folder)
    server = python_server(folder)
    server.start()
    try:
        yield server
    finally:
        server.end()
