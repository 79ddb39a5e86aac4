"""OPC UA: a controller's files behind a server, over an encrypted channel to the known server.

Every access has a connection of its own, which ends with it: what a cut line leaves behind is
known to the server as a session that has died. Source: OPC 10000-4 (sessions), 10000-7
(Basic256Sha256), 10000-20 (files).
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Final, TypeVar

from asyncua.client.client import Client
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from asyncua.crypto.uacrypto import load_certificate
from cryptography.x509 import SubjectAlternativeName, UniformResourceIdentifier

from rotcal_ros.compensation.controller_store import ENCODING
from rotcal_ros.compensation.network_settings import OpcUaSettings, secret
from rotcal_ros.compensation.opcua_files import ServerFolder
from rotcal_ros.errors import ConfigurationError, ControllerError, RotcalError

T = TypeVar("T")

GOODBYE_S: Final = 1.0
"""s, for the end of a session: a server that is gone does not answer to it."""

logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # what matters is raised, and told once


class OpcUaLink:
    """A link to the files of one directory of an OPC UA server; ``timeout_s`` for each access."""

    def __init__(self, settings: OpcUaSettings, timeout_s: float) -> None:
        self._settings, self._timeout_s = settings, timeout_s
        self.address = f"{settings.endpoint} {settings.directory}"

    def read(self, names: list[str]) -> dict[str, str]:
        """Return those of the files that there are; an empty file holds no table."""

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
            return asyncio.run(asyncio.wait_for(session(), self._timeout_s))
        except RotcalError:
            raise
        except asyncio.TimeoutError as error:
            why = f"not done within {self._timeout_s:g} s"
            raise ControllerError(f"{self.address}: cannot {what}: {why}") from error
        except Exception as error:
            # Whatever the library raises: the feed has to put the old table back.
            why = str(error).strip() or type(error).__name__
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
            client.set_password(secret(settings.password_from, "opcua.password_from"))
        if settings.user_certificate:
            await client.load_client_certificate(settings.user_certificate)
            await client.load_private_key(Path(settings.user_key))
        await client.set_security(
            SecurityPolicyBasic256Sha256,
            certificate=settings.certificate,
            private_key=settings.private_key,
            # A server that has not the key of this very certificate gets no channel.
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
        raise ConfigurationError(f"opcua.certificate: {certificate} states no application URI")
    return str(uris[0])
