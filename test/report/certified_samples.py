"""Results with all that a certificate can state, and the parts of a page by their clause."""

import re
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser

import numpy as np

from rotcal_ros.foundation.circumstances import Circumstances, Range, StepCounts
from rotcal_ros.foundation.identity import Identity, InstrumentIdentity, Instruments
from rotcal_ros.foundation.protection import EFFECTS, Protection
from rotcal_ros.foundation.results import Rejection, Residuals, Result
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.report.page import TITLE, ReportInput

IDENTITY = Identity(
    item="rotary table", maker="Maker", model="T 400", serial="0815", place="hall 3",
    operator="A. Person", laboratory="Length Laboratory", laboratory_address="Street 1, Town",
    laboratory_country="DE", laboratory_email="lab@example.org", customer="Customer Ltd",
    customer_address="Road 2, City", customer_number="4711", certificate_number="K-2026-17",
    received="2026-03-01", tolerance_arcsec=10.0,
    instruments=Instruments(
        tracer=InstrumentIdentity(
            maker="Tracers", model="LT", serial="99", calibrated="2026-01-15", certificate="C-1"
        ),
        thermometer=InstrumentIdentity(serial="7"),
    ),
)  # fmt: skip
CIRCUMSTANCES = Circumstances(
    axis="C", identity=IDENTITY, begun_ns=1_772_524_800_000_000_000,
    ended_ns=1_772_532_000_000_000_000, temperature_c=Range(20.12, 19.9, 20.3),
    pressure_pa=Range(101_325.0, 101_300.0, 101_350.0), humidity=Range(0.45, 0.4, 0.5),
    refraction="corrected by the tracer", counts=StepCounts(50, 48, 2, 3),
)  # fmt: skip


def result(**changes) -> Result:
    """Return a full circle of 12 angles with 3 arcsec in the second order, u = 0.4 arcsec."""
    angles = np.deg2rad(np.arange(12) * 30.0)
    ecc = 3.0 * ARCSEC * (np.cos(2.0 * angles) - 1.0)
    std = np.full(12, 0.4 * ARCSEC)
    std[0] = 0.0
    row = np.arange(24)
    known = Result(
        method="tracer_multistation", angles=angles, deviations={"ECC": ecc}, std={"ECC": std},
        covariance={"ECC": np.diag(std**2)}, sigma0=1.02, dof=12, n_observations=24,
        rejected=(Rejection(3, "normalised residual 5.1 > 3.3"),),
        adjacent_deviations=np.diff(ecc), adjacent_std=np.full(11, 0.5 * ARCSEC),
        residuals=Residuals(
            table_position=row % 12, target=row // 12, residual=np.linspace(-1e-6, 1e-6, 24),
            redundancy=np.full(24, 0.5), test_value=np.linspace(-2.0, 2.0, 24), used=row != 3,
        ),
        protections=tuple(Protection(effect, "harmless", "nothing moves") for effect in EFFECTS),
        budget={"lengths": 0.6 * std, "targets": 0.8 * std},
        circumstances=CIRCUMSTANCES,
    )  # fmt: skip
    return replace(known, **changes)


def report(shown: Result | None = None, **changes) -> ReportInput:
    """Return the report of a result, :func:`result` if none is given."""
    whole = ReportInput(
        result=shown or result(), title=TITLE, method_title="Laser tracer, multi-station",
        inputs=[("bag_0.mcap", "ab" * 32)], versions={"numpy": "2.0"}, issued="2026-03-04",
        configuration_text="method: tracer_multistation",
    )  # fmt: skip
    return replace(whole, **changes)


class Clauses(HTMLParser):
    """The text of every element with ``data-iso17025``, by clause."""

    VOID = frozenset({"meta", "br", "img", "hr", "link", "input", "path", "use", "rect"})

    def __init__(self, page: str) -> None:
        super().__init__()
        self.texts: dict[str, list[str]] = {}
        self._open: list[str | None] = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        if tag in self.VOID:
            return
        clause = dict(attrs).get("data-iso17025")
        self._open.append(clause)
        if clause:
            self.texts.setdefault(clause, []).append("")

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            self._open.pop()

    def handle_startendtag(self, tag, attrs):
        """Nothing stands in an element that closes itself."""

    def handle_data(self, data):
        for clause in filter(None, self._open):
            self.texts[clause][-1] += f"{data.strip()} "


def text_of(page: str) -> str:
    """Return what a reader sees, in one line, without style sheets and figures."""
    body = re.sub(r"<(style|svg).*?</\1>", " ", page, flags=re.DOTALL)
    return " ".join(unescape(re.sub(r"<[^>]*>", " ", body)).split())
