"""The settings of the bag writer: beside those of the recorder, group ``recorder``."""

from __future__ import annotations

from dataclasses import dataclass

from rotcal_ros.foundation.settings import setting


@dataclass(frozen=True)
class WriterSettings:
    """When chunks are closed and files are split."""

    sync_interval_s: float = setting(
        0.5,
        doc="s, longest time that data wait in memory before they are on disk",
        minimum=0.01,
        maximum=1.0,
    )
    chunk_bytes: int = setting(
        262144, doc="bytes, size at which a chunk is closed early", minimum=1024, maximum=67108864
    )
    split_bytes: int = setting(
        0, doc="bytes, size at which a new file is begun; 0: never", minimum=0
    )
    split_duration_s: float = setting(
        0.0, doc="s, recording time after which a new file is begun; 0: never", minimum=0.0
    )
    min_free_bytes: int = setting(
        67108864, doc="bytes of free disk below which recording stops in good order", minimum=0
    )
