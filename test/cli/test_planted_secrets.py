"""A secret in a URL, planted wherever one can stand, is refused and in nothing that is left."""

import io
import json
from contextlib import redirect_stderr, redirect_stdout
from itertools import cycle
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

from rotcal_ros.cli.main import rotcal
from rotcal_ros.compensation.controllers import controller_names, make_controller
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import declarations
from rotcal_ros.methods.configuration import (
    parse_configuration,
    raw_groups,
    read_configuration,
    settings_classes,
)
from rotcal_ros.methods.method import find_method, method_names

DATA = Path(__file__).parents[2] / "examples" / "data"
PLATE = DATA / "ball_plate.yaml"  # without a plate there is no ball plate
SECRET = "SeCr3tPlanted"
URL = f"postgresql://me:{SECRET}@host/db"
URLS = [URL, f"opc.tcp://host?pass%77ord={SECRET}", f"s3://key:{SECRET}%2F@bucket"]
TEXTS = [
    (method, f"{group}.{one.name}", one.is_list)
    for method in method_names()
    for group, cls in settings_classes(find_method(method)).items()
    for one in declarations(cls)
    if one.kind is str
]
COMMON = set.intersection(
    *({name for m, name, _ in TEXTS if m == method} for method in method_names())
)


def groups_of(path):
    return raw_groups(path.read_text(), str(path))[1]


def test_every_group_with_texts_is_among_them():
    groups = {name.partition(".")[0] for _, name, _ in TEXTS}
    assert groups >= {"bridge", "identity", "topics", "planner", "cell", "page"}


@pytest.mark.parametrize("method", method_names())
def test_no_setting_takes_a_url_with_a_secret(method):
    """Settings of all methods are tried with one of them, each with the next kind of URL."""
    common = set() if method == method_names()[0] else COMMON
    tried = [(name, is_list) for m, name, is_list in TEXTS if m == method and name not in common]
    for (name, is_list), url in zip(tried, cycle(URLS), strict=False):
        *groups, last = name.split(".")
        settings = groups_of(PLATE) if method == "ball_plate" else {}
        place = settings
        for group in groups:
            place = place.setdefault(group, {})
        place[last] = [url] if is_list else url
        text = yaml.safe_dump({**settings, "method": method})
        with pytest.raises(ConfigurationError, match="a URL with a secret in it") as raised:
            parse_configuration(text, "my.yaml")
        assert name in str(raised.value)
        assert SECRET not in str(raised.value)


@pytest.mark.parametrize("name", controller_names())
def test_no_controller_takes_one(name):
    for one in declarations(type(make_controller(name))):
        with pytest.raises(ConfigurationError) as raised:
            make_controller(name, {one.name: URL})
        assert SECRET not in str(raised.value)


def test_a_comment_of_a_configuration_goes_into_bags_too(tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text(f"method: tracer\n# history: {URL}\n")
    with pytest.raises(ConfigurationError, match=r"own\.yaml, line 2: a URL with a secret"):
        read_configuration(path)


RESULT, SETUP = str(DATA / "result_ball_plate.json"), str(DATA / "tracer.yaml")
COMMANDS = [
    ["history", "--database", URL],
    ["history", "add", RESULT, "--database", URL],
    ["history", "show", "12", "--set", f"history.database={URL}"],
    ["history", "due", "--json", "--set", f"history.promise={URL}"],
    ["history", "--json"],
    ["history", "page", "-o", "park"],
    ["doctor", "--machine-ini", URL],
    ["doctor", URL],
    ["run", SETUP, "--set", f"history.database={URL}"],
    ["run", SETUP, "--set", f"plan.no_such={URL}"],
    ["run", SETUP, "--set", f"{URL}"],
    ["run", "own.yaml"],
    ["solve", str(DATA / "tracer"), "--setup", SETUP, "--set", f"identity.{URL}=1"],
    ["solve", URL],
    ["solve", str(DATA), "--setup", "own.yaml", "--json"],
    ["settings", "tracer", "--set", URL],
    ["export", RESULT, "--to", "linuxcnc", "-o", "made", "--machine-ini", URL],
    ["export", RESULT, "--to", URL, "-o", "made"],
    ["export", RESULT, "--to", "csv", "-o", "made", "--set", URL],
    ["reprocess", f"s3://key:{SECRET}@bucket", "--setup", SETUP],
    ["reprocess", "bags.txt", "--setup", SETUP],
    ["reprocess", "nothing", "--setup", SETUP, "--scheduler", f"tcp://me:{SECRET}@host:1"],
    ["reprocess", "nothing", "--setup", SETUP, "--history", URL],
    ["plan", "check", "12", "--from-history", URL],
    *(["history", "page", "-o", url] for url in URLS),
    ["export", RESULT, "--to", "linuxcnc", "--replace", "-o", URL],
    ["export", RESULT, "--to", "linuxcnc", "--replace", "-o", f"me:{SECRET}@host"],
    ["report", RESULT, "-o", URL],
    ["combine", RESULT, RESULT, f"--output={URL}"],
    ["history", "export", URL],
    [URL],
]


@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: " ".join(words)[:40])
def test_no_command_shows_or_keeps_one(tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROTCAL_HISTORY", URL)
    monkeypatch.setattr("rotcal_ros.cli.doctor.run_checks", lambda _output: iter(()))
    planted = {"own.yaml": f"method: tracer\nidentity: {{item: '{URL}'}}\n", "bags.txt": URL}
    for name, text in planted.items():
        Path(name).write_text(text)
    told = io.StringIO()
    with redirect_stdout(told), redirect_stderr(told):
        done = CliRunner().invoke(rotcal, words)
    shown = told.getvalue() + done.output + done.stderr + repr(done.exception)
    assert done.exit_code, shown
    assert SECRET not in shown
    for path in tmp_path.rglob("*"):
        assert SECRET not in str(path)
        if path.is_file() and path.name not in planted:
            assert SECRET.encode() not in path.read_bytes()
    if "--json" in words and done.stdout:
        json.loads(done.stdout)
