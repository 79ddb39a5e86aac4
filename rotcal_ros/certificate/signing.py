"""Signatures of certificates: XML signatures (W3C), enveloped, as the schema has them."""

from __future__ import annotations

from lxml import etree
from signxml import XMLSigner, XMLVerifier, methods
from signxml.exceptions import InvalidInput, InvalidSignature

from rotcal_ros.certificate.document import as_bytes
from rotcal_ros.errors import ConfigurationError, DataError


def signed(certificate: bytes, key: bytes, x509: bytes) -> bytes:
    """Return a certificate signed with a private ``key`` (PEM); ``x509`` is who signs (PEM).

    Raises ConfigurationError for a key or a certificate that cannot be used.
    """
    signer = XMLSigner(method=methods.enveloped, signature_algorithm="rsa-sha256")
    try:
        root = signer.sign(etree.fromstring(certificate), key=key, cert=x509.decode("ascii"))
    except (InvalidInput, TypeError, ValueError) as error:
        raise ConfigurationError(
            f"cannot sign: {error}; expected an RSA key and its X.509 certificate, both PEM"
        ) from error
    return as_bytes(root)


def verify(certificate: bytes, x509: bytes) -> None:
    """Raise DataError unless ``x509`` (PEM) has signed the whole certificate as it stands."""
    try:
        XMLVerifier().verify(certificate, x509_cert=x509.decode("ascii"))
    except (InvalidSignature, InvalidInput, etree.XMLSyntaxError) as error:
        raise DataError(f"the signature does not hold: {error}") from error
