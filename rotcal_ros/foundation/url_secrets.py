"""Secrets in URLs: found, so that nobody writes them down, and masked in what is shown.

A configuration is copied into every bag, session and report, and a command line into logs. So a
URL may name a user, but never carry a password, a token or a key: a file or the environment does.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final
from urllib.parse import unquote

MASK: Final = "***"
_SCHEME: Final = r"[A-Za-z][\w+.-]+:/+"
"""With one slash, too, to which a path shortens two."""
_URL: Final = re.compile(rf"({_SCHEME})(\S*)")
_BARE: Final = re.compile(r"(?<![\w/@:.%])((?!mailto:)[A-Za-z][\w.+-]*:)([^\s/@:'\"]+)(?=@\w)")
"""User and password where :// was forgotten."""
_PASSWORD: Final = re.compile(r"([^/?#:@]*:)(.+)@", re.DOTALL)
"""User and password behind :// as libraries find them, which take even a slash into the latter."""
_PORT_AND_QUERY: Final = re.compile(r"[^/?#:@]*:\d+(/[^?#@]*)?[?#]")
"""Host and port, with an @ in the query at most."""
_IN_QUERY: Final = re.compile(r"([?&;#])([^=&;#?\s]+)=([^&;#\s]+)")
_KEY_FILE: Final = "sslkey"
"""What PostgreSQL calls the file of a key; other spellings are none of its options."""
_PAIR: Final = re.compile(
    r"\b(\w*(?:password|passwd|passphrase|secret|token|pwd)\s*=\s*)"
    rf"(?!{re.escape(MASK)})('[^']*'|[^\s;&]+)",
    re.IGNORECASE,
)
"""A pair of a connection string, ``host=HOST password=WORD``, as PostgreSQL and ODBC have them."""
_SECRET: Final = re.compile(
    r"(?!.*file$)"
    r"(.*(password|passwd|passphrase|secret|token|signature|credential).*|.*key|pass|pwd?|sig|auth)"
)
"""Names in a query that stand for secrets, in lower case without hyphens and underscores."""


def has_secret(text: str) -> bool:
    """Return whether a URL or connection string in ``text`` has a password, a token or a key.

    >>> has_secret("postgresql://me@host/db"), has_secret("postgresql://me:pw@host/db")
    (False, True)
    """
    url = re.match(rf"\s*{_SCHEME}", text)
    # A text that is a URL as a whole may have blanks in its password.
    as_whole = url is not None and _rest_masked(text[url.end() :]) != text[url.end() :]
    return as_whole or mask_secrets(text) != text


def mask_secrets(text: str) -> str:
    """Return ``text`` with *** for what is secret in URLs and connection strings, else as it is.

    >>> mask_secrets("no answer: s3://key:pw@host/bag?x-amz-signature=1f&part=2")
    'no answer: s3://key:***@host/bag?x-amz-signature=***&part=2'
    """
    if ":/" in text:
        text = _URL.sub(lambda url: url[1] + _rest_masked(url[2]), text)
    text = _BARE.sub(rf"\1{MASK}", _PAIR.sub(rf"\1{MASK}", text))
    if ":/" in text:
        return text
    if "%" in text and ":/" in (decoded := unquote(text)) and mask_secrets(decoded) != decoded:
        return MASK  # a URL that is encoded as a whole
    return text


def find_secrets(value: Any, place: str) -> Iterator[str]:
    """Yield the places, each as ``place.name``, of nested settings that hold such a URL."""
    if isinstance(value, str) and has_secret(value):
        yield place
    elif isinstance(value, Mapping):
        for name, inner in value.items():
            yield from find_secrets(name, f"a name in {place}")
            yield from find_secrets(inner, f"{place}.{mask_secrets(str(name))}")
    elif isinstance(value, Sequence) and not isinstance(value, str | bytes):
        for number, inner in enumerate(value):
            yield from find_secrets(inner, f"{place}[{number}]")


def secret_error_text(place: str) -> str:
    """Return the error for a URL with a secret at ``place``, which does not repeat it."""
    return (
        f"{place}: a URL with a secret in it, such as a password: it would be copied into bags, "
        "reports and logs. Leave it out there; a file or the environment gives it (PGPASSFILE or "
        "PGPASSWORD for a history, opcua.password_from for OPC UA, AWS_* for s3)"
    )


def _rest_masked(rest: str) -> str:
    """Return what follows :// in a URL, with its secrets masked."""
    if (found := _PASSWORD.match(rest)) and not _PORT_AND_QUERY.match(rest):
        rest = f"{found[1]}{MASK}{rest[found.end(2) :]}"
    authority = re.split(r"[/?#]", rest, maxsplit=1)[0]
    user, at, host = unquote(authority).rpartition("@")
    if at and user.partition(":")[2] not in ("", MASK):  # an encoded colon
        rest = f"{user.partition(':')[0]}:{MASK}@{host}{rest[len(authority) :]}"
    return _IN_QUERY.sub(_pair_masked, rest)


def _pair_masked(pair: re.Match[str]) -> str:
    """Return a pair of a query, masked if its name stands for a secret, or it holds such a URL."""
    name, value = (unquote(unquote(text)) for text in pair.groups()[1:])
    plain = re.sub(r"[\W_]", "", name.lower())
    secret = name.lower() != _KEY_FILE and _SECRET.fullmatch(plain)
    return f"{pair[1]}{pair[2]}={MASK}" if secret or has_secret(value) else pair[0]
