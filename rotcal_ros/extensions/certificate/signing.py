"""Signatures of certificates: XML signatures (W3C), enveloped, as the schema has them."""

from __future__ import annotations

from typing import Final

from lxml import etree
from signxml.algorithms import SignatureConstructionMethod
from signxml.exceptions import InvalidInput, InvalidSignature
from signxml.signer import XMLSigner
from signxml.verifier import XMLVerifier

from rotcal_ros.extensions.certificate.document import as_bytes
from rotcal_ros.extensions.certificate.elements import DCC_NAMESPACE
from rotcal_ros.foundation.errors import ConfigurationError, DataError

ROOT: Final = f"{{{DCC_NAMESPACE}}}digitalCalibrationCertificate"


def signed(certificate: bytes, key: bytes, x509: bytes) -> bytes:
    """Return a certificate signed with a private ``key`` (PEM); ``x509`` is who signs (PEM).

    Raises ConfigurationError for a key or a certificate that cannot be used, DataError for a
    document that is no XML.
    """
    signer = XMLSigner(
        method=SignatureConstructionMethod.enveloped, signature_algorithm="rsa-sha256"
    )
    try:
        root = signer.sign(etree.fromstring(certificate), key=key, cert=x509.decode("ascii"))
    except etree.XMLSyntaxError as error:
        raise DataError(
            f"cannot sign: the certificate is no XML that can be read: {error}"
        ) from error
    except (InvalidInput, TypeError, ValueError) as error:
        raise ConfigurationError(
            f"cannot sign: {error}; expected an RSA key and its X.509 certificate, both PEM"
        ) from error
    return as_bytes(root)


def verify(certificate: bytes, x509: bytes) -> None:
    """Raise DataError unless ``x509`` (PEM) has signed the whole certificate as it stands."""
    try:
        proved = XMLVerifier().verify(certificate, x509_cert=x509.decode("ascii"))
    except (InvalidSignature, InvalidInput, etree.XMLSyntaxError) as error:
        raise DataError(f"the signature does not hold: {error}") from error
    if getattr(getattr(proved, "signed_xml", None), "tag", "") != ROOT:
        raise DataError("the signature does not hold: only a part of the certificate is signed")
