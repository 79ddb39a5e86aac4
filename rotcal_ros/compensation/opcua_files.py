"""The files of one directory of an OPC UA server: FileType and FileDirectoryType.

Where the server can create, move and delete, a table is sent under another name, read back, and
then renamed: under its own name it is whole or not there. A server that only shows files is
written in place; reading back tells what came of it. Source: OPC 10000-20.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final, cast

from asyncua import ua
from asyncua.client.client import Client
from asyncua.client.ua_file_transfer import UaDirectory, UaFile
from asyncua.common.node import Node
from asyncua.ua.uaerrors import BadBrowseNameDuplicated

from rotcal_ros.errors import ControllerError

NODE_ID: Final = re.compile(r"(ns=\d+;)?[isgb]=.+")
CHUNK_BYTES: Final = 8192
"""Of one write: below the smallest message that a server must take."""
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
        """Return what the file holds, None when there is none."""
        node_id = await self._file(name)
        return None if node_id is None else await self._read(node_id)

    async def replace(self, files: Mapping[str, bytes | None]) -> None:
        """Replace the files; None takes one away (where nothing can be deleted: empties it)."""
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
        """Make the file and see that it holds ``data``; it is in force under no name yet."""
        await self._directory.create_file(name, request_file_open=False)
        node_id = await self._file(name)
        if node_id is None:
            raise ControllerError(f"the server has not made the file {name}")
        await self._write(node_id, data)
        if await self._read(node_id) != data:
            raise ControllerError(f"read back, {name} differs from what was sent: not in force")

    async def _give_name(self, name: str) -> None:
        """Put the file that was sent in the place of the old one."""
        try:
            await self._move(NEW + name, name)
        except BadBrowseNameDuplicated:  # as the standard has it: a move replaces nothing
            await self._delete(OLD + name)
            await self._move(name, OLD + name)
            await self._move(NEW + name, name)

    async def _move(self, name: str, new_name: str) -> None:
        node_id = await self._file(name)
        if node_id is None:
            raise ControllerError(f"the file {name} has gone from the server")
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
            raise ControllerError(f"there is no file {name}, and the server lets nobody make one")
        await self._write(node_id, data or b"")

    async def _read(self, node_id: ua.NodeId) -> bytes:
        """Return what is read until nothing comes any more.

        What a server says of the size of a file is no proof of what it holds, 0 least of all.
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
            raise ControllerError(f"the server shows {len(found)} files of the name {name}")
        return cast(ua.NodeId, found[0]) if found else None
