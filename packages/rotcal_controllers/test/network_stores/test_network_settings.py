"""Settings of controllers behind a network: what is missing is named, a secret never repeated."""

import sys
from pathlib import Path

import pytest

from rotcal_controllers.network_stores.settings import AdsSettings, OpcUaSettings, read_secret
from rotcal_ros.compensation.bridge_settings import BridgeSettings
from rotcal_ros.compensation.feed import Feed
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.methods.configuration import changed, read_configuration

CONFIGURATION = Path(__file__).parents[4] / "config" / "tracer_demo.yaml"
OPCUA = {
    "endpoint": "opc.tcp://10.0.0.5:4840",
    "directory": "2:Machine/FileSystem",
    "certificate": "bridge.pem",
    "private_key": "bridge_key.pem",
    "server_certificate": "server.pem",
}
ADS = {"net_id": "5.12.34.56.1.1", "host": "10.0.0.6"}


def opcua(**changes):
    return BridgeSettings(
        transport="opcua", controller_folder="/x", opcua=OpcUaSettings(**OPCUA | changes)
    )


def test_a_configuration_is_refused_at_its_start_not_when_a_table_arrives():
    configuration = read_configuration(CONFIGURATION)
    with pytest.raises(ConfigurationError, match=r"opcua needs opcua\.endpoint, opcua\.directory"):
        changed(configuration, ["bridge.transport=opcua"])
    with pytest.raises(ConfigurationError, match=r"ads needs ads\.net_id, ads\.host"):
        changed(configuration, ["bridge.transport=ads"])
    with pytest.raises(ConfigurationError, match="'ftp' is none of folder, ads, opcua"):
        changed(configuration, ["bridge.transport=ftp"])
    given = [f"bridge.ads.{name}={value}" for name, value in ADS.items()]
    with pytest.raises(ConfigurationError, match="needs controller_folder"):
        changed(configuration, ["bridge.transport=ads", *given])
    good = changed(configuration, ["bridge.transport=ads", "bridge.controller_folder=/x", *given])
    assert good.bridge.ads == AdsSettings(**ADS)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"server_certificate": ""}, r"opcua needs opcua\.server_certificate$"),
        ({"user": "me"}, r"opcua needs opcua\.password_from$"),
        ({"user_certificate": "me.pem"}, r"opcua needs opcua\.user_key$"),
        ({"endpoint": "http://10.0.0.5"}, r"expected opc\.tcp://HOST:PORT"),
        (
            {"user": "me", "password_from": "env:A", "user_certificate": "b", "user_key": "c"},
            "give only one of them",
        ),
    ],
)
def test_what_is_missing_is_named(changes, words):
    with pytest.raises(ConfigurationError, match=words):
        opcua(**changes)


@pytest.mark.parametrize(
    "changes",
    [
        {"endpoint": "opc.tcp://me:pass-word@10.0.0.5:4840"},
        {"user": "me", "password_from": "pass-word"},
        {"user": "me", "password_from": "text:pass-word"},
    ],
)
def test_a_password_in_the_configuration_is_refused_and_not_repeated(changes):
    with pytest.raises(ConfigurationError, match="expected") as caught:
        opcua(**changes)
    assert "pass-word" not in str(caught.value)


def test_a_net_id_has_six_numbers():
    with pytest.raises(ConfigurationError, match="expected six numbers"):
        AdsSettings(**ADS | {"net_id": "10.0.0.6"}).check()


def test_where_a_secret_is(tmp_path, monkeypatch):
    monkeypatch.setenv("SECRET_OF_TEST", " a b ")
    assert read_secret("env:SECRET_OF_TEST", "x") == " a b "
    path = tmp_path / "secret"
    path.write_text("a:b \n")
    path.chmod(0o600)
    assert read_secret(f"file:{path}", "x") == "a:b "
    path.chmod(0o640)
    with pytest.raises(ConfigurationError, match=f"x: others may read {path}: run chmod 600"):
        read_secret(f"file:{path}", "x")
    with pytest.raises(ConfigurationError, match=r"cannot read .*: No such file"):
        read_secret(f"file:{path}s", "x")
    with pytest.raises(ConfigurationError, match="no variable NOT_THERE_AT_ALL"):
        read_secret("env:NOT_THERE_AT_ALL", "x")


@pytest.mark.parametrize(("transport", "package"), [("opcua", "asyncua"), ("ads", "pyads")])
def test_a_client_that_is_not_installed_is_named_with_its_extra(transport, package, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    for name in [
        n for n in sys.modules if n.startswith(f"rotcal_controllers.network_stores.{transport}_")
    ]:
        monkeypatch.delitem(sys.modules, name)
    settings = BridgeSettings(
        transport=transport,
        controller_folder="/x",
        opcua=OpcUaSettings(**OPCUA),
        ads=AdsSettings(**ADS),
    )
    words = (
        rf"{transport} needs the package {package}: pip install "
        rf"'rotcal_controllers\[{transport}\]'"
    )
    with pytest.raises(ConfigurationError, match=words):
        Feed(settings, "C", lambda: 0)
