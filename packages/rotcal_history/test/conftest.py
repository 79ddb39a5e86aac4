"""Databases for the tests of the history: a file, and a PostgreSQL server of their own."""

import os
import pwd
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

CORE = Path(__file__).parents[3] / "test"
sys.path += [str(CORE / f) for f in ("nodes", "compensation", "bags", "cli", "sessions", "report")]

from bag_samples import simulate  # noqa: E402
from live_cell import cell, rotcal  # noqa: E402, F401

pytest.importorskip("sqlalchemy")
pytest.importorskip("alembic")

REQUIRED = bool(os.environ.get("ROTCAL_REQUIRE_POSTGRESQL"))
UNPRIVILEGED = "nobody"


@pytest.fixture(scope="session")
def simulated_run():
    return simulate()


def programs():
    """Return the folder of PostgreSQL's programs; None: not installed."""
    places = sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
    found = shutil.which("initdb")
    places += [Path(found).parent] if found else []
    return next((place for place in places if (place / "postgres").exists()), None)


@pytest.fixture(scope="session")
def postgresql(tmp_path_factory):
    """Start a server that only listens to a socket in its folder; return the URL without a name.

    It refuses to run as root; root starts it as nobody.
    """
    place = programs()
    if place is None:
        if REQUIRED:
            pytest.fail("PostgreSQL is required here (ROTCAL_REQUIRE_POSTGRESQL): install it")
        pytest.skip("PostgreSQL is not installed: apt install postgresql")
    folder = Path("/tmp") / f"rotcal-pg-{os.getpid()}"  # a socket's path has to be short
    folder.mkdir(mode=0o700)
    options = {"stdout": subprocess.DEVNULL, "stderr": subprocess.STDOUT, "cwd": "/"}
    if os.geteuid() == 0:
        user = pwd.getpwnam(UNPRIVILEGED)
        os.chown(folder, user.pw_uid, user.pw_gid)
        options |= {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}
    data = folder / "data"
    initdb = [place / "initdb", "-D", data, "-A", "trust", "-U", "rotcal", "--no-sync"]
    subprocess.run(initdb, check=True, **options)
    settings = f"-k {folder} -c listen_addresses= -c fsync=on"
    control = [place / "pg_ctl", "-D", data, "-w", "-t", "300"]
    subprocess.run(
        [*control, "-o", settings, "-l", folder / "log", "start"], check=True, **options
    )
    yield f"postgresql://rotcal@/{{}}?host={folder}"
    subprocess.run([*control, "-m", "immediate", "stop"], check=True, **options)
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request, tmp_path):
    """Return a history's file or URL, empty and of its own."""
    if request.param == "sqlite":
        return str(tmp_path / "history.db")
    server = request.getfixturevalue("postgresql")
    import psycopg

    name = f"test_{abs(hash(request.node.nodeid)):x}"
    with psycopg.connect(server.format("postgres"), autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name}")
    return server.format(name)
