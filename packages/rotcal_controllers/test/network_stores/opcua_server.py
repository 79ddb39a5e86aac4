"""An OPC UA server (asyncua) that shows the files of a folder, and fails when it is asked to.

usage: opcua_server.py SETUP.json

Every line on standard input starts the server anew, in a process of its own, and `ready PID`
comes back. SETUP names ``port``, ``folder`` of the files, ``certificate``, ``key``,
``trusted`` folder of clients, ``user``, ``password``, and ``fault``: a file with how many calls of
methods go well before one is met by ``kill``, ``cut`` (the connections, once) or ``gone`` (for
good), and whether ``before`` the call or ``after`` its work; ``before`` a Write, half is done.
With the name of a method behind it, calls of this method alone count.
"""

import asyncio
import json
import os
import signal
import sys
from pathlib import Path

from asyncua import Server, ua
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.crypto.truststore import TrustStore
from asyncua.crypto.validator import CertificateValidator, CertificateValidatorOptions
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

TYPES = ua.VariantType


class Fault:
    """What has to go wrong, as the file says it at this moment."""

    def __init__(self, path, server):
        self.path, self.server = Path(path), server
        self.now = None

    def count(self, called):
        """Count a call of a method; sets what is to happen during this one."""
        self.now = None
        if not self.path.exists():
            return
        left, kind, when, *method = self.path.read_text().split()
        if method and method != [called]:
            return
        if int(left) == 0:
            self.now = kind, when
            if kind != "gone":
                self.path.unlink()
        else:
            self.path.write_text(" ".join([str(int(left) - 1), kind, when, *method]))

    def strike(self, when):
        if self.now is None or self.now[1] != when:
            return
        if self.now[0] == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        binary = self.server.bserver
        if self.now[0] == "gone":
            binary._server.close()
        for client in list(binary.clients):
            client.transport.abort()
        raise ConnectionError(self.now)


class Files:
    """FileDirectoryType over a folder: no move replaces a file, as OPC 10000-20 has it."""

    def __init__(self, server, root, fault, space):
        self.server, self.root, self.fault, self.space = server, root, fault, space
        self.nodes, self.open_files, self.last_handle = {}, {}, 0

    async def install(self):
        objects = self.server.nodes.objects
        machine = await objects.add_object(self.space, "Machine")
        name = ua.QualifiedName("FileSystem", 0)
        self.directory = await machine.add_object(ua.NodeId("files", self.space), name)
        for method, inputs, outputs in [
            (self.CreateFile, [TYPES.String, TYPES.Boolean], [TYPES.NodeId, TYPES.UInt32]),
            (self.Delete, [TYPES.NodeId], []),
            (self.MoveOrCopy, [TYPES.NodeId, TYPES.NodeId, TYPES.Boolean, TYPES.String],
             [TYPES.NodeId]),
        ]:  # fmt: skip
            await self.method(self.directory, "files", method, inputs, outputs)

    async def method(self, node, key, function, inputs, outputs):
        async def call(_parent, *arguments):
            self.fault.count(function.__name__)
            if function.__name__ != "Write":
                self.fault.strike("before")
            values = await function(*([node] * (key != "files")), *(a.Value for a in arguments))
            self.fault.strike("after")
            if isinstance(values, ua.StatusCode):
                return values
            return [ua.Variant(v, t) for v, t in zip(values, outputs, strict=True)]

        name = function.__name__
        node_id = ua.NodeId(f"{key}/{name}", self.space)
        await node.add_method(node_id, ua.QualifiedName(name, 0), call, inputs, outputs)

    def size_of(self, name):
        """The size of a file, or what a file beside that of the faults says of all."""
        said = self.fault.path.with_name("size_of_all")
        return int(said.read_text()) if said.exists() else (self.root / name).stat().st_size

    async def show(self, name):
        """Make the node of a file."""
        node_id = ua.NodeId(f"file {self.last_handle} {name}", self.space)
        self.last_handle += 1
        node = await self.directory.add_object(node_id, ua.QualifiedName(name, self.space))
        self.nodes[node.nodeid] = node, name
        size = await node.add_property(
            ua.NodeId(f"{node_id.Identifier}/Size", self.space), ua.QualifiedName("Size", 0),
            self.size_of(name), TYPES.UInt64,
        )  # fmt: skip
        node.size = size
        key = node_id.Identifier
        handle = TYPES.UInt32
        for method, inputs, outputs in [
            (self.Open, [TYPES.Byte], [handle]),
            (self.Close, [handle], []),
            (self.Read, [handle, TYPES.Int32], [TYPES.ByteString]),
            (self.Write, [handle, TYPES.ByteString], []),
        ]:
            await self.method(node, key, method, inputs, outputs)
        return node

    async def CreateFile(self, name, _open):  # noqa: N802
        path = self.root / name
        if path.exists():
            return ua.StatusCode(ua.StatusCodes.BadBrowseNameDuplicated)
        path.touch()
        return (await self.show(name)).nodeid, 0

    async def Delete(self, node_id):  # noqa: N802
        node, name = self.nodes.pop(node_id)
        (self.root / name).unlink()
        await node.delete(recursive=True)
        return []

    async def MoveOrCopy(self, node_id, _target, _copy, new_name):  # noqa: N802
        if (self.root / new_name).exists():
            return ua.StatusCode(ua.StatusCodes.BadBrowseNameDuplicated)
        node, name = self.nodes.pop(node_id)
        (self.root / name).rename(self.root / new_name)
        await node.delete(recursive=True)
        return [(await self.show(new_name)).nodeid]

    async def Open(self, node, mode):  # noqa: N802
        path = self.root / self.nodes[node.nodeid][1]
        self.last_handle += 1
        # Unbuffered: what a killed server has taken is on the disk.
        stream = path.open("wb" if mode & 4 else "rb", buffering=0)
        self.open_files[self.last_handle] = stream
        return [self.last_handle]

    async def Close(self, node, handle):  # noqa: N802
        self.open_files.pop(handle).close()
        path = self.root / self.nodes[node.nodeid][1]
        await node.size.write_value(self.size_of(path.name), TYPES.UInt64)
        return []

    async def Read(self, _node, handle, length):  # noqa: N802
        return [self.open_files[handle].read(min(length, 1000))]

    async def Write(self, _node, handle, data):  # noqa: N802
        half = len(data) // 2
        self.open_files[handle].write(data[:half])
        self.fault.strike("before")
        self.open_files[handle].write(data[half:])
        return []


async def prepare(setup):
    class Users:
        def get_user(self, _server, username=None, password=None, certificate=None):
            by_name = (username, password) == (setup["user"], setup["password"])
            known = by_name or certificate == user_certificate
            return User(role=UserRole.Admin) if known else None

    pem = Path(setup["user_certificate"]).read_bytes()
    user_certificate = x509.load_pem_x509_certificate(pem).public_bytes(Encoding.DER)
    server = Server(user_manager=Users())
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{setup['port']}")
    server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
    server.set_identity_tokens([ua.UserNameIdentityToken, ua.X509IdentityToken])
    await server.load_certificate(setup["certificate"])
    await server.load_private_key(setup["key"])
    trusted = TrustStore([Path(setup["trusted"])], [])
    await trusted.load()
    options = CertificateValidatorOptions.TRUSTED | CertificateValidatorOptions.PEER_CLIENT
    server.set_certificate_validator(CertificateValidator(options, trusted))
    space = await server.register_namespace("urn:test:files")
    files = Files(server, Path(setup["folder"]), Fault(setup["fault"], server), space)
    await files.install()
    return server, files


async def serve(server, files):
    for path in files.root.iterdir():
        await files.show(path.name)
    async with server:
        print("ready", os.getpid(), flush=True)  # noqa: T201
        await asyncio.Event().wait()


def main():
    setup = json.loads(Path(sys.argv[1]).read_text())
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    server, files = asyncio.run(prepare(setup))
    for _line in sys.stdin:
        if os.fork() == 0:  # as a new server, without the seconds that its preparation takes
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            asyncio.run(serve(server, files))


if __name__ == "__main__":
    main()
