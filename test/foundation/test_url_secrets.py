"""Secrets in URLs: found in every form in which libraries take them, and never where none is."""

import pytest

from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.untrusted import require_no_secret
from rotcal_ros.foundation.url_secrets import find_secrets, has_secret, mask_secrets

SECRET = "SeCr3t"
CARRYING = [
    f"postgresql://me:{SECRET}@host/db",
    f"POSTGRESQL+psycopg://:{SECRET}@host",
    f"postgresql://me:p@{SECRET}@host/db",
    f"postgresql://me:p/{SECRET}@host/db",
    f"postgresql://me:12/{SECRET}@host/db",
    f"postgresql://me:p?{SECRET}#@host/db",
    f"postgresql:/me:{SECRET}@host/db",  # as paths are written
    f"postgresql://me:{SECRET}%40@host/db",
    f"postgresql://me%3A{SECRET}@host/db",
    f"postgresql://host/db?user=me&password={SECRET}",
    f"postgresql://host/db?pass%77ord={SECRET}",
    f"postgresql://host/db?SSL_Password={SECRET}",
    f"https://host/bag.mcap?X-Amz-Signature={SECRET}&part=1",
    f"https://host/bag.mcap?sv=1;sig={SECRET}",
    f"https://host/bag.mcap#access_token={SECRET}",
    f"https://host/?next=postgresql%3A%2F%2Fme%3A{SECRET}%40host",
    f"postgresql%3A%2F%2Fme%3A{SECRET}%40host%2Fdb",
    f"opc.tcp://me:{SECRET}@host:4840/path",
    f"s3://AKIA:{SECRET}@bucket/key",
    f"see http://host:8080/?key={SECRET} for more",
    f"postgresql://host/db?ssl_key={SECRET}",
    f"host=127.0.0.1 port=5432 password={SECRET}",
    f"host=db PASSWORD = 'a {SECRET}' user=me",
    f"me:{SECRET}@host/db",
    f"Server=db;Uid=me;Pwd={SECRET};",
]
FREE_OF_IT = [
    "history.db",
    "C:/history@work.db",
    "mailto:me@host",
    "me@host:folder/history.db",
    "100 % of 3://",
    "postgresql://me@host/db",
    "postgresql://me@/db?host=/run/pg&passfile=/home/me/.pgpass&sslkey=/etc/key.pem",
    "postgresql://host:5432/db?application_name=a@b",
    "postgresql://me:***@host/db",
    "opc.tcp://host:4840/path",
    "s3://bucket/folder@2/bag.mcap",
    "https://host/a%3Ab%40c",
    "http://[::1]:8080/",
    "host=127.0.0.1 user=me passfile=/home/me/.pgpass",
    "opcua.password_from=/run/secrets/opcua",
    "host=db password=***",
]


@pytest.mark.parametrize("text", CARRYING)
def test_a_secret_is_found_refused_and_masked(text):
    assert has_secret(text)
    assert SECRET not in mask_secrets(text)
    assert not has_secret(mask_secrets(text))
    assert SECRET not in str(DataError(f"{text!r} was found", f"log of {text}"))
    assert SECRET not in DataError("", f"log of {text}").log
    with pytest.raises(ConfigurationError, match=r"^here: a URL with a secret") as raised:
        require_no_secret(text, "here")
    assert SECRET not in str(raised.value)
    assert list(find_secrets({"a": [{"b": text}], text: 1}, "x")) == ["x.a[0].b", "a name in x"]


@pytest.mark.parametrize("text", FREE_OF_IT)
def test_a_text_without_one_stays_as_it_is(text):
    assert not has_secret(text)
    assert mask_secrets(text) == text


def test_a_library_takes_blanks_into_a_password():
    assert has_secret(f"postgresql://me:a {SECRET}@host/db")
