"""What is known of a bag without reading it, and kept outcomes that are broken."""

import os
import stat

import pytest
from fleet_bags import configuration_text, write_bag

from rotcal_history.fleet.batch_solving import TAIL_BYTES, BagJob, fingerprint, solve_bag
from rotcal_ros.methods.configuration import parse_configuration

CONFIGURATION = parse_configuration(configuration_text())


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "large.mcap"
    path.write_bytes(bytes(4 * TAIL_BYTES))
    return path


def changed(file, offset):
    """Change a byte and nothing else: size and time stay."""
    times = (file.stat().st_atime_ns, file.stat().st_mtime_ns)
    data = bytearray(file.read_bytes())
    data[offset] ^= 1
    file.write_bytes(data)
    os.utime(file, ns=times)


@pytest.mark.parametrize(
    ("whole", "offset", "notices"),
    [(False, -1, True), (False, -TAIL_BYTES, True), (False, 0, False), (True, 0, True)],
)
def test_a_changed_byte_is_noticed_at_the_end_or_when_all_are_read(file, whole, offset, notices):
    before = fingerprint(str(file), CONFIGURATION, whole=whole)
    assert fingerprint(str(file), CONFIGURATION, whole=whole) == before
    changed(file, offset)
    assert (fingerprint(str(file), CONFIGURATION, whole=whole) != before) == notices


def test_size_and_time_are_noticed_unless_all_bytes_are_read(file):
    cheap, whole = (fingerprint(str(file), CONFIGURATION, whole=w) for w in (False, True))
    os.utime(file, ns=(1, 1))
    assert fingerprint(str(file), CONFIGURATION) != cheap
    assert fingerprint(str(file), CONFIGURATION, whole=True) == whole
    times = (1, 1)
    file.write_bytes(bytes(5 * TAIL_BYTES))
    os.utime(file, ns=times)
    assert fingerprint(str(file), CONFIGURATION, whole=True) != whole


@pytest.mark.parametrize("harm", ["cut", "changed", "binary"])
def test_a_broken_entry_is_computed_again_and_mended(tmp_path, harm):
    bag = write_bag(tmp_path / "table" / "run", 1)
    job = BagJob(str(bag), CONFIGURATION, str(tmp_path / "cache"))
    before = os.umask(0o027)
    try:
        first = solve_bag(job)
    finally:
        os.umask(before)
    assert not first.error
    (entry,) = (tmp_path / "cache").glob("*/*.json")
    assert stat.S_IMODE(entry.stat().st_mode) == 0o640
    text = entry.read_text()
    number = f"{first.result['sigma0']!r}"
    broken = {"cut": text[:1000], "changed": text.replace(number, "1.25", 1)}
    entry.write_bytes(broken.get(harm, "\udcff").encode(errors="surrogateescape"))
    again = solve_bag(job)
    assert (again.healed, again.cached, again.result) == (True, False, first.result)
    third = solve_bag(job)
    assert (third.healed, third.cached, third.result) == (False, True, first.result)


@pytest.mark.slow
def test_a_copy_and_a_repaired_twin_are_the_same_session_and_another_day_is_not(tmp_path):
    from rotcal_ros.bags.repair import repair

    bag = write_bag(tmp_path / "table" / "run", 1)
    torn = tmp_path / "table" / "torn" / "bag_0.mcap"
    torn.parent.mkdir()
    data = (bag / "bag_0.mcap").read_bytes()
    torn.write_bytes(data[: len(data) * 9 // 10])
    repair(torn.parent, tmp_path / "table" / "repaired")
    other = write_bag(tmp_path / "table" / "other", 2)
    sessions = [
        solve_bag(BagJob(str(path), CONFIGURATION, str(tmp_path / "cache"))).session
        for path in (bag, torn.parent, tmp_path / "table" / "repaired", other)
    ]
    assert len(set(sessions[:3])) == 1
    assert sessions[3] not in ("", sessions[0])
