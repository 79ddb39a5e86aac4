"""The dataset of results: whole parts, whatever ends the call; what is broken comes again."""

import os
import stat

import numpy as np
import pytest

pytest.importorskip("pyarrow")
import pyarrow.parquet as parquet

from rotcal_ros.extensions.fleet.batch_solving import BagOutcome
from rotcal_ros.extensions.fleet.results_dataset import ResultsDataset, parts
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.results import Result


def outcome(name, key="k", ecc=(0.0, 1e-6, 3e-6)):
    n = len(ecc)
    result = Result(
        method="ball_plate",
        angles=np.arange(n) * 0.5,
        deviations={"ECC": np.array(ecc)},
        std={"ECC": np.full(n, 1e-7)},
        covariance={"ECC": np.eye(n) * 1e-14},
        sigma0=1.0,
        dof=3,
        n_observations=9,
    )
    return BagOutcome(
        f"/bags/table/{name}", key, start_ns=1_700_000_000 * 10**9, result=result.to_dict()
    )


def rows(folder):
    return parquet.read_table(folder).to_pylist()


def write(folder, *outcomes):
    return write_all(folder, outcomes)


def write_all(folder, outcomes):
    with ResultsDataset(folder) as dataset:
        for one in outcomes:
            dataset.add(one)
    return dataset


def test_one_row_per_bag_angle_and_component(tmp_path):
    folder = tmp_path / "results.parquet"
    write(folder, outcome("a"), BagOutcome("/bags/table/bad", "", error="torn"))
    good, bad = rows(folder)[:3], rows(folder)[3:]
    assert [(r["component"], r["angle_rad"], r["deviation"], r["std"]) for r in good] == [
        ("ECC", 0.0, 0.0, 1e-7), ("ECC", 0.5, 1e-6, 1e-7), ("ECC", 1.0, 3e-6, 1e-7)
    ]  # fmt: skip
    assert [(r["source"], r["table"], r["error"], r["component"]) for r in bad] == [
        ("/bags/table/bad", "table", "torn", None)
    ]


def test_a_second_call_adds_what_is_new_and_drops_what_no_longer_holds(tmp_path):
    bad = BagOutcome("/bags/table/c", "", error="torn")
    write(tmp_path, outcome("a"), outcome("b"), bad)
    before = parts(tmp_path)
    write(tmp_path, outcome("a"), outcome("b", key="changed", ecc=(0.0, 5e-6)), outcome("d"))
    found = {(r["source"][-1], r["key"]) for r in rows(tmp_path)}
    assert found == {("a", "k"), ("b", "changed"), ("d", "k")}
    assert len(rows(tmp_path)) == 3 + 2 + 3
    write(tmp_path, outcome("a"), outcome("b", key="changed", ecc=(0.0, 5e-6)), outcome("d"))
    assert len(parts(tmp_path)) == len(before) + 1  # nothing new, no new part


def test_an_interrupted_call_keeps_what_it_did_and_what_was_there(tmp_path):
    write(tmp_path, outcome("a"), outcome("b"))

    def until_interrupted():
        yield from (outcome("b", key="changed"), outcome("c"))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_all(tmp_path, until_interrupted())
    found = {(r["source"][-1], r["key"]) for r in rows(tmp_path)}
    assert found == {("a", "k"), ("b", "changed"), ("c", "k")}


@pytest.mark.parametrize("harm", ["cut", "flipped", "empty"])
def test_a_broken_part_is_told_and_written_again(tmp_path, harm):
    write(tmp_path, outcome("a"))
    (part,) = parts(tmp_path)
    data = bytearray(part.read_bytes())
    if harm == "flipped":
        data[40] ^= 0x10  # in the first page
    part.write_bytes({"cut": data[: len(data) // 2], "empty": b""}.get(harm, data))
    (tmp_path / ".part-x.parquet-half").mkdir()
    assert write(tmp_path, outcome("a")).broken == 1
    assert len(rows(tmp_path)) == 3
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_parts_are_readable_as_the_umask_says(tmp_path):
    before = os.umask(0o027)
    try:
        write(tmp_path, outcome("a"))
    finally:
        os.umask(before)
    (part,) = parts(tmp_path)
    assert stat.S_IMODE(part.stat().st_mode) == 0o640


def test_two_calls_do_not_write_at_the_same_time(tmp_path):
    with ResultsDataset(tmp_path), pytest.raises(BagError, match="still writes"):
        ResultsDataset(tmp_path)


def test_a_name_that_is_no_text_is_escaped(tmp_path):
    write(tmp_path, outcome("caf\udce9"))
    assert {r["source"] for r in rows(tmp_path)} == {"/bags/table/caf\\udce9"}
