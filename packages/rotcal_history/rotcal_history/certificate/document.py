"""A digital calibration certificate: its parts in order, the result itself, and a signature.

The first part says who calibrated what for whom, with which software; the second holds methods,
instruments, conditions and curves. Signatures are enveloped XML signatures (W3C), as the schema
has them.
"""

from __future__ import annotations

import gzip
from base64 import b64encode
from collections.abc import Iterable, Iterator
from datetime import date
from hashlib import sha256
from math import sqrt
from typing import Any, Final

import numpy as np
from lxml import etree
from lxml.builder import ElementMaker
from signxml.algorithms import SignatureConstructionMethod
from signxml.exceptions import InvalidInput, InvalidSignature
from signxml.signer import XMLSigner
from signxml.verifier import XMLVerifier

from rotcal_ros import __version__
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.circumstances import SIMULATED, Circumstances, Range
from rotcal_ros.foundation.components import COVERAGE_FACTOR, TRANSLATIONS
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.escapes import printable, printable_lines
from rotcal_ros.foundation.identity import Identity, InstrumentIdentity
from rotcal_ros.foundation.in_force import describe
from rotcal_ros.foundation.language import ENGLISH, Phrase, language, language_codes, phrase
from rotcal_ros.foundation.results import AxisLine, Result

DCC_NAMESPACE: Final = "https://ptb.de/dcc"
SI_NAMESPACE: Final = "https://ptb.de/si"
PREFIXES: Final = {"dcc": DCC_NAMESPACE, "si": SI_NAMESPACE}
DCC: Final = ElementMaker(namespace=DCC_NAMESPACE, nsmap=PREFIXES)
SI: Final = ElementMaker(namespace=SI_NAMESPACE, nsmap=PREFIXES)
LANGUAGE: Final = ENGLISH.code
OTHERS: Final = language_codes()[1:]


def text_element(tag: str, *paragraphs: str, **attributes: str) -> Any:
    """Return an element with its text in English, and what is a phrase in the others too."""
    contents = [DCC.content(printable_lines(p), lang=LANGUAGE) for p in paragraphs]
    contents += [
        DCC.content(printable_lines(language(code).say(p)), lang=code)
        for code in OTHERS
        for p in paragraphs
        if isinstance(p, Phrase)
    ]
    return DCC(tag, *contents, **attributes)


def leaf_element(tag: str, value: str) -> Any:
    """Return an element with one word or number; runs of blanks become one, as the schema asks."""
    return DCC(tag, printable(" ".join(value.split())))


def present_elements(*elements: Any) -> list[Any]:
    """Return those elements that are there."""
    return [element for element in elements if element is not None]


def number_list(values: Iterable[float]) -> str:
    """Return numbers as a list of the schema; every bit survives."""
    return " ".join(repr(float(value)) for value in values)


def contact_element(
    tag: str, name: str, address: str = "", email: str = "", country: str = ""
) -> Any:
    """Return a person or an organisation; one that has an address has a location."""
    location = None
    if address:
        further = text_element("further", address)
        location = DCC.location(
            *present_elements(leaf_element("countryCode", country) if country else None, further)
        )
    mail = leaf_element("eMail", email) if email else None
    return DCC(tag, *present_elements(text_element("name", name), mail, location))


def identification_element(issuer: str, value: str, name: str) -> Any:
    """Return a number by which something is known, and who gave it."""
    return DCC.identification(
        leaf_element("issuer", issuer), leaf_element("value", value), text_element("name", name)
    )


SCHEMA: Final = "3.3.0"
LARGEST_TEXT: Final = 9_900_000
"""Characters in one text: parsers of XML refuse more than 10 million."""
_LOCATION: Final = "{http://www.w3.org/2001/XMLSchema-instance}schemaLocation"


def make_certificate(result: Result, method_title: str, issued: date) -> bytes:
    """Return the digital calibration certificate of a result as XML, UTF-8.

    Raises ConfigurationError that lists what the result lacks, DataError if its verdict is not ok.
    """
    require_certifiable(result)
    root = DCC.digitalCalibrationCertificate(
        administrative_data(result, issued),
        measurement_results(result, method_title),
        _result_file(result),
        schemaVersion=SCHEMA,
    )
    root.set(_LOCATION, f"{DCC_NAMESPACE} {DCC_NAMESPACE}/v{SCHEMA}/dcc.xsd")
    etree.indent(root)
    return xml_bytes(root)


def xml_bytes(root: Any) -> bytes:
    """Return a document as it is written."""
    data: bytes = etree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return data


def _result_file(result: Result) -> Any:
    """Return result.json, from which all of it can be computed again.

    A large one is compressed; if it is still too large, only its SHA-256 is included.
    """
    name, mime, data = "result.json", "application/json", result.to_json().encode()
    digest = sha256(data).hexdigest()
    if _too_large(data):
        name, mime, data = f"{name}.gz", "application/gzip", gzip.compress(data, mtime=0)
    if _too_large(data):
        name, mime = "result.json.sha256", "text/plain"
        data = f"{digest}  result.json\n".encode()
    return DCC.document(
        text_element("name", phrase("The result in the machine-readable form of rotcal_ros")),
        leaf_element("fileName", name),
        leaf_element("mimeType", mime),
        leaf_element("dataBase64", b64encode(data).decode()),
    )


def _too_large(data: bytes) -> bool:
    return 4 * len(data) > 3 * LARGEST_TEXT


PROBABILITY: Final = "0.95"
_RADIAN: Final = "\\radian"
_METRE: Final = "\\metre"
_NORMAL: Final = "normal"


def measurement_results(result: Result, method_title: str) -> Any:
    """Return the element ``measurementResults``."""
    circumstances = result.circumstances
    paragraphs = [NOT_MEASURED] if circumstances.simulated else []
    paragraphs.append(phrase("Deviation = actual - commanded, names after ISO 230-1, SI units."))
    return DCC.measurementResults(
        DCC.measurementResult(
            *present_elements(
                text_element(
                    "name", mark_simulated(phrase("Deviations of a rotary table"), circumstances)
                ),
                text_element("description", *paragraphs),
                DCC.usedMethods(*_methods(result, method_title)),
                DCC.usedSoftware(software_element()),
                _instruments(circumstances),
                _conditions(circumstances),
                DCC.results(
                    *(_axis(line) for line in result.axes),
                    *(_curve(result, name) for name in result.components),
                ),
            )
        )
    )


def _methods(result: Result, title: str) -> Iterator[Any]:
    yield DCC.usedMethod(
        text_element("name", phrase(title)),
        text_element(
            "description",
            f"Method {result.method} of rotcal_ros; {result.n_observations} observations, of "
            f"these {len(result.rejected)} rejected; degrees of freedom {result.dof}, "
            f"sigma0 {result.sigma0:.4g}.",
            phrase("Compensation table in force meanwhile: {0}.", describe(result.measured_on)),
        ),
    )
    refraction = result.circumstances.refraction
    if refraction:
        yield DCC.usedMethod(
            text_element("name", phrase("Index of refraction of the air")),
            text_element("description", f"{refraction}."),
        )


def _instruments(circumstances: Circumstances) -> Any:
    known = circumstances.identity.instruments.known
    return DCC.measuringEquipments(
        *(_instrument(name, instrument) for name, instrument in known.items())
    )


def _instrument(name: str, instrument: InstrumentIdentity) -> Any:
    history = []
    if instrument.calibrated:
        history.append(phrase("Calibrated on {0}.", instrument.calibrated))
    if instrument.certificate:
        history.append(phrase("Certificate {0}.", instrument.certificate))
    serial = None
    if instrument.serial:
        known = identification_element("manufacturer", instrument.serial, phrase("serial number"))
        serial = DCC.identifications(known)
    return DCC.measuringEquipment(
        *present_elements(
            text_element("name", phrase(name.replace("_", " "))),
            text_element("description", *history) if history else None,
            contact_element("manufacturer", instrument.maker) if instrument.maker else None,
            leaf_element("model", instrument.model) if instrument.model else None,
            serial,
        )
    )


def _conditions(circumstances: Circumstances) -> Any:
    """Return the known conditions of the air; None: nothing is known."""
    ranges = (
        (phrase("Temperature"), circumstances.temperature_c, "\\degreecelsius"),
        (phrase("Air pressure"), circumstances.pressure_pa, "\\pascal"),
        (phrase("Relative humidity"), circumstances.humidity, "\\one"),
    )
    known = [_condition(name, found, unit) for name, found, unit in ranges if found is not None]
    return DCC.influenceConditions(*known) if known else None


def _condition(name: str, found: Range, unit: str) -> Any:
    values = [
        (phrase("mean"), found.mean),
        (phrase("lowest"), found.lowest),
        (phrase("highest"), found.highest),
    ]
    if found.lowest == found.highest:  # such as a value that the configuration states
        values = [(phrase("value"), found.mean)]
    quantities = (
        DCC.quantity(
            text_element("name", what), SI.real(SI.value(repr(float(value))), SI.unit(unit))
        )
        for what, value in values
    )
    return DCC.influenceCondition(text_element("name", name), DCC.data(*quantities))


def _axis(line: AxisLine) -> Any:
    """Return where an axis stands: two places and two small turns, each pair with its covariance.

    What joins a place and a turn is in the result that is attached.
    """
    origin = SI.realListXMLList(SI.valueXMLList(number_list(line.origin)), SI.unitXMLList(_METRE))
    point = DCC.quantity(
        text_element("name", phrase("Nominal point of the axis, x y z")),
        origin,
        refType="basic_nominalValue",
    )
    pairs = (
        DCC.quantity(
            text_element("name", " ".join(line.names[at])),
            _measured(line.value[at], line.std[at], line.covariance[at, at], unit),
            refType="basic_measurementError",
        )
        for at, unit in ((slice(2), _METRE), (slice(2, 4), _RADIAN))
    )
    return DCC.result(
        text_element("name", phrase("Average line of the axis {0}", line.letter)),
        text_element(
            "description",
            phrase("Measured less nominal line (ISO 230-7), in the machine's coordinates."),
            phrase("The places hold at the height of the nominal point."),
        ),
        DCC.data(point, *pairs),
        refType="rotcal_axis",
    )


def _curve(result: Result, component: str) -> Any:
    """Return one deviation over the angles, with expanded uncertainties and covariance."""
    angles = SI.realListXMLList(
        SI.valueXMLList(number_list(result.angles)), SI.unitXMLList(_RADIAN)
    )
    deviations = _measured(
        result.deviations[component],
        result.std[component],
        result.covariance.get(component),
        _METRE if component in TRANSLATIONS else _RADIAN,
    )
    return DCC.result(
        text_element("name", component),
        DCC.data(
            DCC.quantity(
                text_element("name", phrase("Commanded angle")),
                angles,
                refType="basic_nominalValue",
            ),
            DCC.quantity(
                text_element("name", phrase("{0}: actual - commanded", component)),
                deviations,
                refType="basic_measurementError",
            ),
        ),
        refType=f"rotcal_{component}",
    )


def _measured(value: Floats, std: Floats, covariance: Floats | None, unit: str) -> Any:
    """Return values (n,) with their expanded uncertainties and, where it is known, covariance."""
    found = SI.realListXMLList(
        SI.valueXMLList(number_list(value)), SI.unitXMLList(unit), _expanded(std)
    )
    if covariance is not None:
        found.append(_covariance(covariance, unit))
    return found


def _expanded(std: Floats) -> Any:
    """Return U = k u; k is a power of two, so that no bit of u is lost."""
    return SI.measurementUncertaintyUnivariateXMLList(
        SI.expandedMUXMLList(
            SI.valueExpandedMUXMLList(number_list(COVERAGE_FACTOR * std)),
            SI.coverageFactorXMLList(f"{COVERAGE_FACTOR:g}"),
            SI.coverageProbabilityXMLList(PROBABILITY),
            SI.distributionXMLList(_NORMAL),
        )
    )


def _covariance(covariance: Floats, unit: str) -> Any:
    """Return the covariance matrix, column by column.

    The schema knows it as part of a hyper-ellipsoidal region, whose coverage factor is that of
    the chi-squared distribution in as many dimensions.
    """
    from scipy.stats import chi2

    squared = f"{unit}\\tothe{{2}}"
    columns = (
        SI.columnXMLList(
            SI.covarianceXMLList(SI.valueXMLList(number_list(column)), SI.unitXMLList(squared))
        )
        for column in np.asarray(covariance).T
    )
    factor = sqrt(float(chi2.ppf(float(PROBABILITY), len(covariance))))
    return SI.measurementUncertaintyMultivariateXMLList(
        SI.ellipsoidalRegionMUXMLList(
            SI.covarianceMatrixXMLList(*columns),
            SI.coverageFactorXMLList(repr(factor)),
            SI.coverageProbabilityXMLList(PROBABILITY),
            SI.distributionXMLList(_NORMAL),
        )
    )


REQUIRED: Final = {
    "item": "what was calibrated",
    "serial": "the serial number that the item is known by",
    "place": "where it was calibrated",
    "operator": "the person who is responsible",
    "laboratory": "who is responsible for the calibration",
    "laboratory_address": "where the laboratory is",
    "laboratory_country": "in which country, two letters of ISO 3166",
    "customer": "for whom it was calibrated",
    "customer_address": "where the customer is",
    "certificate_number": "the unique number of the certificate",
}
"""Settings of the group ``identity`` that every certificate needs, and why."""


def require_certifiable(result: Result) -> None:
    """Refuse what cannot be certified.

    Raises ConfigurationError that lists everything that is missing, by the names of the settings,
    and DataError for a result that is not ok: a certificate vouches for its uncertainties.
    """
    missing = missing_settings(result)
    if missing:
        names = ", ".join(name.removeprefix("identity.") for name in missing)
        lines = "\n".join(f"  {name}: {why}" for name, why in missing.items())
        raise ConfigurationError(
            f"a calibration certificate needs more than this result states ({names}), see below: "
            "give it in the configuration, or with --setup or --set for a bag or a table (the "
            "group identity changes no number)",
            lines,
        )
    if result.verdict != "ok":
        raise DataError(
            f"the verdict is {result.verdict}: no certificate is written about uncertainties that "
            "the data contradict; look at the report for the cause, and measure again"
        )


def missing_settings(result: Result) -> dict[str, str]:
    """Return the settings that are missing for a certificate, with what they are for."""
    circumstances = result.circumstances
    identity = circumstances.identity
    missing = {
        f"identity.{name}": why for name, why in REQUIRED.items() if not getattr(identity, name)
    }
    traced = [i for i in identity.instruments.known.values() if i.serial and i.calibrated]
    if not traced:
        missing["identity.instruments.*"] = (
            "serial and date of calibration (calibrated) of one instrument or more: traceability"
        )
    if circumstances.days is None:
        missing["identity.measured"] = "when it was measured: a bag records it, a table does not"
    return missing


NOT_MEASURED: Final = phrase("SIMULATED: a simulation, no item was measured.")


def administrative_data(result: Result, issued: date) -> Any:
    """Return the element ``administrativeData``."""
    circumstances = result.circumstances
    identity = circumstances.identity
    return DCC.administrativeData(
        DCC.dccSoftware(software_element()),
        _core_data(circumstances, issued),
        DCC.items(_item(circumstances)),
        DCC.calibrationLaboratory(
            contact_element(
                "contact",
                identity.laboratory,
                identity.laboratory_address,
                identity.laboratory_email,
                identity.laboratory_country,
            )
        ),
        DCC.respPersons(
            DCC.respPerson(
                contact_element("person", identity.operator), leaf_element("mainSigner", "true")
            )
        ),
        contact_element("customer", identity.customer, identity.customer_address),
        DCC.statements(*(DCC.statement(*parts) for parts in _statements(result))),
    )


def mark_simulated(name: str, circumstances: Circumstances) -> str:
    """Return a name that says where a simulation was measured instead."""
    return phrase("SIMULATED: {0}", name) if circumstances.simulated else name


def software_element() -> Any:
    """Return this software as an element."""
    return DCC.software(
        text_element("name", "rotcal_ros"),
        leaf_element("release", __version__),
        leaf_element("type", "application"),
    )


def _core_data(circumstances: Circumstances, issued: date) -> Any:
    identity = circumstances.identity
    assert circumstances.days is not None
    begun, ended = circumstances.days
    number = f"{SIMULATED}-" * circumstances.simulated + identity.certificate_number
    ordered = None
    if identity.customer_number:
        known = identification_element(
            "customer", identity.customer_number, phrase("customer's number")
        )
        ordered = DCC.identifications(known)
    return DCC.coreData(
        *present_elements(
            leaf_element("countryCodeISO3166_1", identity.laboratory_country),
            *(leaf_element("usedLangCodeISO639_1", code) for code in language_codes()),
            leaf_element("mandatoryLangCodeISO639_1", LANGUAGE),
            leaf_element("uniqueIdentifier", number),
            ordered,
            leaf_element("receiptDate", identity.received) if identity.received else None,
            leaf_element("beginPerformanceDate", begun),
            leaf_element("endPerformanceDate", ended),
            leaf_element("performanceLocation", "other"),
            leaf_element("issueDate", issued.isoformat()),
        )
    )


def _item(circumstances: Circumstances) -> Any:
    identity: Identity = circumstances.identity
    axis = (
        phrase("Rotary axis {0}.", circumstances.axis)
        if circumstances.axis
        else phrase("Rotary axis.")
    )
    paragraphs = [axis, NOT_MEASURED] if circumstances.simulated else [axis]
    return DCC.item(
        *present_elements(
            text_element("name", mark_simulated(identity.item, circumstances)),
            text_element("description", *paragraphs),
            contact_element("manufacturer", identity.maker) if identity.maker else None,
            leaf_element("model", identity.model) if identity.model else None,
            DCC.identifications(
                identification_element("manufacturer", identity.serial, phrase("serial number"))
            ),
        )
    )


def _statements(result: Result) -> Iterator[list[Any]]:
    """Yield name and declaration of each statement for the reader."""
    circumstances = result.circumstances
    if circumstances.simulated:
        yield _statement(phrase(SIMULATED), NOT_MEASURED)
    yield _statement(phrase("Place of calibration"), circumstances.identity.place)
    yield _statement(
        phrase("Uncertainty"),
        phrase(
            "The expanded uncertainties are standard uncertainties times the coverage factor "
            "k = 2, which for a normal distribution is a coverage of about 95 %. The covariance "
            "matrices are those of the standard uncertainties (JCGM 100)."
        ),
    )
    yield _statement(
        phrase("Traceability"),
        phrase(
            "The results are traced through the instruments named with the results and the "
            "certificates of their calibrations."
        ),
    )
    yield _statement(phrase("Verdict of the evaluation"), phrase("{0}.", result.verdict_line))
    if result.warnings:
        yield _statement(phrase("Remarks"), *map(phrase, result.warnings))


def _statement(name: str, *paragraphs: str) -> list[Any]:
    return [text_element("name", name), text_element("declaration", *paragraphs)]


ROOT: Final = f"{{{DCC_NAMESPACE}}}digitalCalibrationCertificate"


def signed(certificate: bytes, key: bytes, x509: bytes) -> bytes:
    """Return a certificate signed with a private ``key`` (PEM); ``x509`` is who signs (PEM).

    Raises ConfigurationError for a key or a certificate that cannot be used, DataError for a
    document that is not XML.
    """
    signer = XMLSigner(
        method=SignatureConstructionMethod.enveloped, signature_algorithm="rsa-sha256"
    )
    try:
        root = signer.sign(etree.fromstring(certificate), key=key, cert=x509.decode("ascii"))
    except etree.XMLSyntaxError as error:
        raise DataError(f"cannot sign: the certificate is not readable XML: {error}") from error
    except (InvalidInput, TypeError, ValueError) as error:
        raise ConfigurationError(
            f"cannot sign: {error}; expected an RSA key and its X.509 certificate, both PEM"
        ) from error
    return xml_bytes(root)


def verify(certificate: bytes, x509: bytes) -> None:
    """Raise DataError unless ``x509`` (PEM) has signed the whole certificate as it is."""
    try:
        proved = XMLVerifier().verify(certificate, x509_cert=x509.decode("ascii"))
    except (InvalidSignature, InvalidInput, etree.XMLSyntaxError) as error:
        raise DataError(
            f"the signature does not hold: {error}; ask its sender for the original"
        ) from error
    if getattr(getattr(proved, "signed_xml", None), "tag", "") != ROOT:
        raise DataError(
            "the signature does not hold: only a part of the certificate is signed; ask its "
            "sender for the original"
        )
