"""The settings of the recorder: group ``recorder`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass

from rotcal_ros.bags.writer_settings import WriterSettings
from rotcal_ros.foundation.settings import group, setting


@dataclass(frozen=True)
class RecorderSettings:
    """Where and how a cell is recorded."""

    folder: str = setting(
        "~/.ros/rotcal", doc="folder below which every calibration gets its session folder"
    )
    session: str = setting(
        "", doc="name of the session folder; empty: UTC time and the start of the plan's hash"
    )
    run: int = setting(
        0,
        doc="run of an interrupted session that this one is; 0 begins a session, later runs "
        "continue its bag in a new file",
        minimum=0,
        maximum=1_000_000,
    )
    queue_bytes: int = setting(
        67_108_864,
        doc="bytes waiting for the disk at most; beyond that messages are lost and counted",
        minimum=65_536,
    )
    silence_s: float = setting(
        30.0,
        doc="s without a message after which tracer_length, joint_states or what is known "
        "of the air counts as silent",
        minimum=0.1,
        maximum=3600.0,
    )
    writer: WriterSettings = group(WriterSettings)
