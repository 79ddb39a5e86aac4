"""Whole bags in the readers of others: each opens them and understands every message."""

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

from aids import on_node
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from rotcal_ros.bags.reader import bag_files, check_files
from rotcal_ros.foundation.machine_load import load_scaled_timeout

PROGRAM = Path(__file__).parent / "bags" / "node" / "read_bag.mjs"
CONVERT = Path(sys.executable).with_name("rosbags-convert")


def by_rosbags(path):
    """Return how many messages of each topic rosbags deserialises from a folder or a file."""
    found = Counter()
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
            found[connection.topic] += 1
    return found


def by_mcap_ros2(file):
    """Return how many messages of each topic mcap-ros2-support decodes, asked for all."""
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()], validate_crcs=True)
        return Counter(found.channel.topic for found in reader.iter_decoded_messages())


def on_node_js(path):
    """Return the messages of a file by topic, as @mcap/core and Foxglove's packages read them."""
    command = ["node", str(on_node(PROGRAM)), str(path)]
    read = subprocess.run(
        command, check=True, timeout=load_scaled_timeout(120), capture_output=True, text=True
    )
    found = {}
    for line in read.stdout.splitlines():
        message = json.loads(line)
        found.setdefault(message["topic"], []).append(message["value"])
    return found


def converted(bag, folder):
    """Return how many messages of each topic are in what rosbags-convert makes of a bag."""
    made = subprocess.run(
        [CONVERT, "--src", bag, "--dst", folder], capture_output=True, text=True, check=False
    )
    assert made.returncode == 0, made.stdout + made.stderr
    return by_rosbags(folder)


def read_by_all(bag, folder):
    """Check that all readers find in a whole ``bag`` what it holds; ``folder`` is for a copy."""
    files = bag_files(bag)
    counts = [
        Counter({n: t.messages for n, t in verdict.topics.items() if t.messages})
        for verdict in check_files(files)
    ]
    assert by_rosbags(bag) == converted(bag, folder) == sum(counts, Counter())
    for file, count in zip(files, counts, strict=True):
        assert by_rosbags(file) == by_mcap_ros2(file) == count
        assert {n: len(values) for n, values in on_node_js(file).items()} == count
