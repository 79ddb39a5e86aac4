"""OPC UA: a controller's files behind a server, over an encrypted channel to the known server.

Every access has a connection of its own, which ends with it: what a cut line leaves behind belongs
to a session that the server knows to be dead. Source: OPC 10000-4 (sessions), 10000-7
(Basic256Sha256), 10000-20 (files).

The files of one directory of an OPC UA server: FileType and FileDirectoryType.

Where the server can create, move and delete, a table is sent under another name, read back, and
then renamed: under its own name it is complete or absent. On a server that only shows files it is
written in place, and read back. Source: OPC 10000-20.
"""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Final, TypeVar, cast

from asyncua import ua
from asyncua.client.client import Client
from asyncua.client.ua_file_transfer import UaDirectory, UaFile
from asyncua.common.node import Node
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from asyncua.crypto.uacrypto import load_certificate
from asyncua.ua.uaerrors import BadBrowseNameDuplicated
from cryptography.x509 import SubjectAlternativeName, UniformResourceIdentifier

from rotcal_controllers.network_stores.settings import OpcUaSettings, read_secret
from rotcal_controllers.network_stores.store import NetworkStore
from rotcal_ros.compensation.controller import Controller
from rotcal_ros.compensation.controller_store import ENCODING
from rotcal_ros.foundation.errors import ConfigurationError, ControllerError, RotcalError

T = TypeVar("T")

GOODBYE_S: Final = 1.0
"""s, for the end of a session: a server that is gone does not answer to it."""

logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # errors are raised, and reported once


class OpcUaLink:
    """A link to the files of one directory of an OPC UA server; ``timeout_s`` for each access."""

    def __init__(self, settings: OpcUaSettings, timeout_s: float) -> None:
        self._settings, self._timeout_s = settings, timeout_s
        self.address = f"{settings.endpoint} {settings.directory}"

    def read(self, names: list[str]) -> dict[str, str]:
        """Return those of the files that exist; an empty file holds no table."""

        async def transfer(folder: ServerFolder) -> dict[str, str]:
            found = {name: await folder.read(name) for name in names}
            return {name: data.decode(ENCODING) for name, data in found.items() if data}

        return self._run(transfer, "read")

    def write(self, tables: Mapping[str, str | None]) -> None:
        """Replace the files; none gets its name before all are on the server and read back."""
        contents = {n: None if t is None else t.encode(ENCODING) for n, t in tables.items()}
        self._run(lambda folder: folder.replace(contents), "write")

    def _run(self, transfer: Callable[[ServerFolder], Awaitable[T]], what: str) -> T:
        """Return what ``transfer`` returns, in a session that ends with it."""

        async def session() -> T:
            async with self._connected() as client:
                return await transfer(await ServerFolder.find(client, self._settings.directory))

        try:
            # A loop of its own: the caller is a thread without one.
            return asyncio.run(asyncio.wait_for(session(), self._timeout_s))
        except RotcalError:
            raise
        except asyncio.TimeoutError as error:
            why = f"not done within {self._timeout_s:g} s; check opcua.endpoint and the network"
            raise ControllerError(f"{self.address}: cannot {what}: {why}") from error
        except Exception as error:
            # Whatever the library raises: the feed has to put the old table back.
            why = f"{str(error).strip() or type(error).__name__}; look at the server's log"
            raise ControllerError(f"{self.address}: cannot {what}: {why}") from error

    @asynccontextmanager
    async def _connected(self) -> AsyncIterator[Client]:
        """Yield a client with a session of the user, encrypted, with the known server only."""
        settings = self._settings
        # The library's own probe, with a time limit of its interval, would cut a slow server off.
        client = Client(
            settings.endpoint, timeout=self._timeout_s, watchdog_intervall=self._timeout_s
        )
        client.application_uri = await _application_uri(Path(settings.certificate))
        if settings.user:
            client.set_user(settings.user)
            client.set_password(read_secret(settings.password_from, "opcua.password_from"))
        if settings.user_certificate:
            await client.load_client_certificate(settings.user_certificate)
            await client.load_private_key(Path(settings.user_key))
        await client.set_security(
            SecurityPolicyBasic256Sha256,
            certificate=settings.certificate,
            private_key=settings.private_key,
            # A server that does not hold the key of this very certificate gets no channel.
            server_certificate=settings.server_certificate,
        )
        try:
            await client.connect()
            yield client
        finally:
            with suppress(Exception):
                await asyncio.wait_for(client.disconnect(), GOODBYE_S)


async def _application_uri(certificate: Path) -> str:
    """Return the application URI of the bridge, which its certificate states (OPC 10000-6)."""
    names = (await load_certificate(certificate)).extensions
    uris = names.get_extension_for_class(SubjectAlternativeName).value.get_values_for_type(
        UniformResourceIdentifier
    )
    if not uris:
        raise ConfigurationError(
            f"opcua.certificate: {certificate} states no application URI; make one that does"
        )
    return str(uris[0])


NODE_ID: Final = re.compile(r"(ns=\d+;)?[isgb]=.+")
CHUNK_BYTES: Final = 8192
"""Bytes of one write: below the smallest message that a server must take."""
OVERWRITE: Final = ua.OpenFileMode.Write | ua.OpenFileMode.EraseExisting
READING: Final = ua.Variant(ua.OpenFileMode.Read.value, ua.VariantType.Byte)
PART: Final = ua.Variant(CHUNK_BYTES, ua.VariantType.Int32)
CHANGING: Final = {"CreateFile", "Delete", "MoveOrCopy"}
NEW: Final = "new_"
OLD: Final = "old_"
"""Before a name, so that its extension stays: some controls take certain extensions only."""


class ServerFolder:
    """A directory of the server; ``changing``: whether it can create, move and delete files."""

    def __init__(self, client: Client, node: Node, changing: bool) -> None:
        self._client, self._node, self._changing = client, node, changing
        self._directory = UaDirectory(node)

    @classmethod
    async def find(cls, client: Client, where: str) -> ServerFolder:
        """Return the directory at ``where``, a node id or a browse path below Objects."""
        if NODE_ID.fullmatch(where):
            node = client.get_node(where)
        else:
            node = await client.nodes.objects.get_child(where.split("/"))
        methods = await node.get_children_descriptions(nodeclassmask=ua.NodeClass.Method)
        return cls(client, node, {str(method.BrowseName.Name) for method in methods} >= CHANGING)

    async def read(self, name: str) -> bytes | None:
        """Return the content of a file, None if there is none."""
        node_id = await self._file(name)
        return None if node_id is None else await self._read(node_id)

    async def replace(self, files: Mapping[str, bytes | None]) -> None:
        """Replace the files; None removes one (or empties it if nothing can be deleted)."""
        if not self._changing:
            for name, data in files.items():
                await self._write_in_place(name, data)
            return
        for name, data in files.items():
            await self._delete(NEW + name)
            if data is not None:
                await self._send(NEW + name, data)
        for name, data in files.items():
            if data is None:
                await self._delete(name)
            else:
                await self._give_name(name)
            await self._delete(OLD + name)

    async def _send(self, name: str, data: bytes) -> None:
        """Make the file and check that it holds ``data``.

        Under this name it is not in force yet.
        """
        await self._directory.create_file(name, request_file_open=False)
        node_id = await self._file(name)
        if node_id is None:
            raise ControllerError(
                f"the server did not create the file {name}; check what it lets opcua.user do"
            )
        await self._write(node_id, data)
        if await self._read(node_id) != data:
            raise ControllerError(f"read back, {name} differs from what was sent: not in force")

    async def _give_name(self, name: str) -> None:
        """Replace the old file by the one that was sent."""
        try:
            await self._move(NEW + name, name)
        except BadBrowseNameDuplicated:  # by the standard a move replaces nothing
            await self._delete(OLD + name)
            await self._move(name, OLD + name)
            await self._move(NEW + name, name)

    async def _move(self, name: str, new_name: str) -> None:
        node_id = await self._file(name)
        if node_id is None:
            raise ControllerError(
                f"the file {name} has gone from the server; find out who removes it"
            )
        await self._directory.move_or_copy(node_id, self._node.nodeid, False, new_name)

    async def _delete(self, name: str) -> None:
        node_id = await self._file(name)
        if node_id is not None:
            await self._directory.delete(node_id)

    async def _write_in_place(self, name: str, data: bytes | None) -> None:
        node_id = await self._file(name)
        if node_id is None:
            if data is None:
                return
            raise ControllerError(
                f"there is no file {name}, and the server does not allow creating one; make it "
                "there"
            )
        await self._write(node_id, data or b"")

    async def _read(self, node_id: ua.NodeId) -> bytes:
        """Read until nothing more comes.

        The size that a server reports does not prove the content of the file, least of all 0.
        """
        file, data = self._client.get_node(node_id), b""
        handle = await file.call_method("0:Open", READING)
        handle = ua.Variant(handle, ua.VariantType.UInt32)
        try:
            while part := await file.call_method("0:Read", handle, PART):
                data += part
        finally:
            await file.call_method("0:Close", handle)
        return data

    async def _write(self, node_id: ua.NodeId, data: bytes) -> None:
        mode = cast(ua.OpenFileMode, OVERWRITE)
        async with UaFile(self._client.get_node(node_id), mode) as file:
            for start in range(0, len(data), CHUNK_BYTES):
                await file.write(data[start : start + CHUNK_BYTES])

    async def _file(self, name: str) -> ua.NodeId | None:
        """Return the node of the file ``name``."""
        found = [
            child.NodeId
            for child in await self._node.get_children_descriptions(
                nodeclassmask=ua.NodeClass.Object
            )
            if child.BrowseName.Name == name
        ]
        if len(found) > 1:
            raise ControllerError(
                f"the server shows {len(found)} files of the name {name}; leave one of them"
            )
        return cast(ua.NodeId, found[0]) if found else None


def opcua_store(
    settings: OpcUaSettings, folder: Path, timeout_s: float, _controller: Controller
) -> NetworkStore:
    """Return the store of a controller behind an OPC UA server; its records are in ``folder``."""
    return NetworkStore(OpcUaLink(settings, timeout_s), folder, timeout_s)
