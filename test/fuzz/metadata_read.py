"""Fuzzed by itself: rosbag2's metadata.yaml beside a sound bag, in its versions."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from zlib import crc32

import bags_harmed as bags
import yaml
from properties import LieError, suppress_rotcal

BAG = "bag_0.mcap"


@cache
def _bag() -> bytes:
    return next(iter(bags.mcap_seeds()))


def descriptions() -> Iterable[bytes]:
    """Yield what describes the bag, as version 9, 5 and 3 of rosbag2 write it."""
    from rotcal_ros.bags.repair import reindex

    with TemporaryDirectory() as folder:
        (Path(folder) / BAG).write_bytes(_bag())
        text = reindex(Path(folder)).path.read_text()
    yield text.encode()
    for version in (5, 3):
        data = yaml.safe_load(text)
        known = data["rosbag2_bagfile_information"]
        known["version"] = version
        del known["custom_data"], known["ros_distro"]
        if version < 5:
            del known["files"]
            known["relative_file_paths"] = [f"bag/{BAG}"]
        yield yaml.safe_dump(data, sort_keys=False).encode()


def read_description(path: Path) -> None:
    """Check, describe, read and reindex the bag that ``path`` lies beside."""
    from rotcal_ros.bags.reader import bag_files, check_files
    from rotcal_ros.bags.repair import reindex
    from rotcal_ros.bags.session_verdict import judge_session
    from rotcal_ros.recordings.summary import summarise_bag

    (path.parent / BAG).write_bytes(_bag())
    with suppress_rotcal():
        json.dumps(summarise_bag(path.parent).to_dict())
    if crc32(path.read_bytes()) % 8 == 0:  # solving takes longer, and looks as describing does
        with suppress_rotcal():
            _read(path.parent)
    again = path.parent / "again"
    try:
        again.mkdir()
        for name in (path.name, BAG):
            shutil.copy(path.parent / name, again)
        reindex(again)
        judged = judge_session(again, check_files(bag_files(again)))
        if judged.differing:
            raise LieError(f"reindexed, and yet: {judged.differing[0]}")
    finally:
        shutil.rmtree(again, ignore_errors=True)
        (path.parent / BAG).unlink()


@cache
def _setup() -> Any:
    from rotcal_ros.methods.configuration import read_configuration

    return read_configuration(bags.DATA / "tracer.yaml")


def _read(folder: Path) -> None:
    from rotcal_ros.recordings.replay import read_recording

    read_recording(folder, configuration=_setup()).warnings()
