"""All files that the specification allows are read, called complete, and repaired without loss."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import mcap_matrix
import pytest
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.mcap_scan import McapScan
from rotcal_ros.bags.repair import repair

VARIANTS = list(mcap_matrix.matrix())
REPAIRED = VARIANTS if os.environ.get("ROTCAL_LONG_TESTS") else VARIANTS[::29]


def test_the_matrix_is_that_of_the_conformance_inputs() -> None:
    """Their names and bytes, by one hash over the hashes of all 416 published files."""
    digest = hashlib.sha256()
    for name, content, features in sorted(VARIANTS, key=lambda variant: variant[0]):
        data = mcap_matrix.mcap_file(content, features)
        digest.update(f"{name} {hashlib.sha256(data).hexdigest()}\n".encode())
    assert len(VARIANTS) == 416
    assert digest.hexdigest() == DIGEST


DIGEST = "eabcfbf8e6525dd4022cb979a3d1793443a31f427cc163be4ddb98e295cd8d01"


@pytest.mark.parametrize("padding", [mcap_matrix.PADDING, b"\0", bytes(100), b"\x05" + bytes(30)])
def test_every_variant_is_complete_and_holds_what_it_should(
    padding: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "variant.mcap"
    for name, content, features in VARIANTS:
        if padding != mcap_matrix.PADDING and "pad" not in features:
            continue
        path.write_bytes(mcap_matrix.mcap_file(content, features, padding))
        scan = McapScan(path, check_index=True)
        items = list(scan.items())
        messages = [
            mcap_matrix.Message(int(log), int(published), int(sequence), block.payload(row))
            for block in items
            if isinstance(block, Block)
            for row, (_, sequence, log, published) in enumerate(block.headers.tolist())
        ]
        attachments = tuple(
            (a.name, a.media_type, a.log_time, a.create_time, a.data)
            for a in items
            if isinstance(a, Attachment)
        )
        assert scan.verdict().describe() == "complete", name
        assert messages == list(content.messages), name
        assert attachments == content.attachments, name
        assert scan.metadata == content.metadata, name
        assert [c.topic for c in scan.channels.values()] == (
            [content.channel[0]] if content.channel else []
        ), name


@pytest.mark.parametrize("variant", REPAIRED, ids=lambda variant: variant[0])
def test_repair_loses_nothing(variant: tuple, tmp_path: Path) -> None:
    _, content, features = variant
    (tmp_path / "theirs.mcap").write_bytes(mcap_matrix.mcap_file(content, features))
    (after,) = repair(tmp_path / "theirs.mcap", tmp_path / "good").after
    with after.path.open("rb") as file:
        records = list(StreamReader(file, validate_crcs=True).records)
    found = {kind: [r for r in records if isinstance(r, kind)] for kind in (Message, Schema)}
    assert after.state == "complete"
    assert [
        mcap_matrix.Message(m.log_time, m.publish_time, m.sequence, m.data) for m in found[Message]
    ] == list(content.messages)
    if content.messages and content.schema:
        schema = found[Schema][0]
        assert (schema.name, schema.encoding, schema.data) == content.schema
    if content.messages and content.channel:
        channel = next(r for r in records if isinstance(r, Channel))
        assert (channel.topic, channel.message_encoding, channel.metadata) == content.channel
        assert (channel.schema_id == 0) == (content.schema is None)
    assert (
        tuple(
            (r.name, r.media_type, r.log_time, r.create_time, r.data)
            for r in records
            if isinstance(r, Attachment) and r.name == "myFile"
        )
        == content.attachments
    )
    assert {
        r.name: r.metadata for r in records if isinstance(r, Metadata) and r.name == "myMetadata"
    } == content.metadata
