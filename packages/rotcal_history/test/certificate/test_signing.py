"""Signed certificates hold, and tampered ones do not."""

from datetime import date, datetime, timedelta, timezone

import pytest
from certified import certified
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from dcc_schema import read_schema
from lxml import etree

from rotcal_history.certificate.document import make_certificate, signed, verify
from rotcal_ros.foundation.errors import ConfigurationError, DataError


def identity_of(name):
    """Return a new key and its self-signed certificate, both PEM."""
    key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
    now = datetime.now(timezone.utc)
    signer = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=1))
        .sign(key, hashes.SHA256())
    )
    pem = serialization.Encoding.PEM
    private = key.private_bytes(
        pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    return private, signer.public_bytes(pem)


@pytest.fixture(scope="module")
def laboratory():
    return identity_of("laboratory")


@pytest.fixture(scope="module")
def document(laboratory):
    return signed(make_certificate(certified(), "Ball plate", date(2026, 3, 20)), *laboratory)


def test_a_signature_holds(document, laboratory):
    verify(document, laboratory[1])


def test_a_changed_number_is_noticed(document, laboratory):
    tampered = document.replace(b"2026-0001", b"2026-0002")
    assert tampered != document
    with pytest.raises(DataError, match="does not hold"):
        verify(tampered, laboratory[1])


def test_somebody_else_has_not_signed(document):
    with pytest.raises(DataError, match="does not hold"):
        verify(document, identity_of("somebody else")[1])


def test_an_unsigned_certificate_is_refused(laboratory):
    with pytest.raises(DataError, match="does not hold"):
        verify(make_certificate(certified(), "Ball plate", date(2026, 3, 20)), laboratory[1])


def test_a_key_that_is_none_is_refused(laboratory):
    plain = make_certificate(certified(), "Ball plate", date(2026, 3, 20))
    with pytest.raises(ConfigurationError, match="cannot sign"):
        signed(plain, b"no key", laboratory[1])


def test_a_signed_certificate_is_valid(document):
    read_schema().assertValid(etree.fromstring(document))
