"""``rotcal dme``: the simulated cell behind I++ DME, for clients of others and for ours."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import click

from rotcal_ipp_dme.server import DmeServer
from rotcal_ros.cli.console import path_type
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.methods.configuration import read_configuration


@click.group()
def command() -> None:
    """Speak I++ DME (VDMA 8722) for a simulated measuring machine with a rotary table."""


@command.command()
@click.argument("configuration", type=path_type)
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option(
    "--port",
    type=click.IntRange(0, 65_535),
    help="Port to listen on, if it is not that of the group dme; 0: any free one.",
)
@click.option(
    "--version", default="1.4.3", show_default=True, help="Version that GetDMEVersion() states."
)
def serve(configuration: Path, host: str, port: int | None, version: str) -> None:
    """Serve the simulated cell of CONFIGURATION until interrupted, without ROS.

    One client at a time drives the machine and its table by TCP. There is no password: listen on
    addresses other than this machine's own only in a network that you trust.
    """
    read = read_configuration(configuration)
    if not read.simulated:
        raise ConfigurationError(
            f"{configuration} has no group simulation: nothing to serve; add one"
        )
    cell = read.method.simulated_cell(read.simulation, time.time_ns())
    server = DmeServer(cell, host, read.group("dme").port if port is None else port, version)

    def listening() -> None:
        click.echo(f"I++ DME {version} at {host}:{server.port}, interrupt with Ctrl-C")

    asyncio.run(server.serve(listening))
