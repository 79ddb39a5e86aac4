"""Bags on S3: sessions of several files, nothing fetched twice; a real server on loopback."""

import os
import re
import socket
import subprocess
import sys
import threading
import time

import pytest
from fleet_bags import configuration_text, write_bag

from rotcal_history.fleet.bag_search import find_bags
from rotcal_history.fleet.batch_solving import BagJob, solve_bag
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.methods.configuration import parse_configuration

pytest.importorskip("fsspec")
pytest.importorskip("moto.server")
CONFIGURATION = parse_configuration(configuration_text())


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """A server of S3 in a process of its own; its log has one line per request."""
    log = tmp_path_factory.mktemp("moto") / "log"
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    process = subprocess.Popen(command, stdout=log.open("w"), stderr=subprocess.STDOUT)
    deadline = time.monotonic() + load_scaled_timeout(60)
    while True:
        try:
            socket.create_connection(("127.0.0.1", port)).close()
            break
        except OSError:
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{port}")
        environment.setenv("AWS_ACCESS_KEY_ID", "nobody")
        environment.setenv("AWS_SECRET_ACCESS_KEY", "nothing")
        environment.setenv("AWS_DEFAULT_REGION", "us-east-1")
        bucket().create_dir("cell")
        yield log
    process.terminate()
    process.wait(10)


def bucket():
    from pyarrow.fs import S3FileSystem

    address = os.environ["AWS_ENDPOINT_URL"]
    return S3FileSystem(endpoint_override=address, allow_bucket_creation=True)


def upload(folder, prefix):
    for file in sorted(path for path in folder.rglob("*") if path.is_file()):
        with bucket().open_output_stream(f"cell/{prefix}/{file.relative_to(folder)}") as to:
            to.write(file.read_bytes())


@pytest.mark.slow
@pytest.mark.usefixtures("server")
def test_a_prefix_a_pattern_and_a_file_name_bags(tmp_path):
    for seed in (1, 2):
        upload(write_bag(tmp_path / f"run_{seed}", seed), f"found/run_{seed}")
    runs = ("s3://cell/found/run_1", "s3://cell/found/run_2")
    assert find_bags(["s3://cell/found"]) == runs
    assert find_bags(["s3://cell/found/"]) == runs
    assert find_bags(["s3://cell/found/run_*"]) == runs
    files = tuple(f"{run}/bag_0.mcap" for run in runs)
    assert find_bags(["s3://cell/found/*/*.mcap"]) == files
    assert find_bags([files[0]]) == files[:1]
    with pytest.raises(BagError, match="names no bag"):
        find_bags(["s3://cell/nothing"])


def gets_after(log, seen, within_s=20.0):
    """Return the codes of what was got after ``seen`` characters.

    The server writes them late, and in colours where it takes its log for a terminal.
    """
    end = time.monotonic() + within_s
    found = []
    while not found and time.monotonic() < end:
        plain = re.sub(r"\x1b\[\d*m", "", log.read_text()[seen:])
        found = re.findall(r'"GET /cell/once/\S+ HTTP/1.1" (\d+)', plain)
        threading.Event().wait(0.0 if found else 0.05)
    return found


@pytest.mark.slow
def test_a_remote_session_is_fetched_once_and_equals_the_local_one(server, tmp_path):
    log = server
    bag = write_bag(tmp_path / "table" / "run", 3)
    upload(bag, "once")
    job = BagJob("s3://cell/once", CONFIGURATION, str(tmp_path / "remote"))
    local = solve_bag(BagJob(str(bag), CONFIGURATION, str(tmp_path / "local")))
    first = solve_bag(job)
    assert not first.error
    assert first.result == local.result
    seen = len(log.read_text())
    again = solve_bag(job)
    assert again.cached
    assert again.result == first.result
    assert set(gets_after(log, seen)) == {"206"}  # the end alone
    upload(write_bag(tmp_path / "other", 4), "once")
    assert not solve_bag(job).cached


@pytest.mark.usefixtures("server")
def test_a_remote_session_of_several_files_is_solved_whole(tmp_path):
    bag = write_bag(tmp_path / "table" / "run", 5, files=2)
    assert len(list(bag.glob("*.mcap"))) == 2
    upload(bag, "session")
    (session,) = find_bags(["s3://cell/session"])
    remote = solve_bag(BagJob(session, CONFIGURATION, str(tmp_path / "remote")))
    whole = write_bag(tmp_path / "table" / "whole", 5)
    local = solve_bag(BagJob(str(whole), CONFIGURATION, str(tmp_path / "local")))
    assert not remote.error
    assert remote.result == local.result


@pytest.mark.slow
def test_a_place_that_does_not_answer_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "nobody")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "nothing")
    with pytest.raises(BagError, match="cannot read s3://cell/bags"):
        find_bags(["s3://cell/bags"])
