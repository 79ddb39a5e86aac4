"""What is done with a table that was dropped on the page: it is explained, solved, written about.

All of it is work for a process of its own. The page names no file: the folder has one place for
each, and errors use the names that people know.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass, field, is_dataclass, replace
from functools import partial
from io import StringIO
from multiprocessing.connection import Connection
from pathlib import Path
from signal import SIG_IGN, SIGINT, signal
from typing import Any, Final

from click import UsageError

from rotcal_ros.cli.console import error_lines
from rotcal_ros.compensation.agreement import UNVERIFIED
from rotcal_ros.compensation.request import ExportRequest, write_export
from rotcal_ros.evaluation.marks import marks, why_withheld
from rotcal_ros.evaluation.two_measurements import verification_of
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.errors import (
    ConfigurationError,
    Question,
    RotcalError,
    UndecidedError,
)
from rotcal_ros.foundation.files import replace_atomically, write_atomically, write_durably
from rotcal_ros.foundation.language import Phrase, phrase, use_language
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.table_columns import UNITS, TableColumn, unit_setting
from rotcal_ros.foundation.table_questions import further_lines
from rotcal_ros.foundation.table_reading import Reading, Use
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.foundation.untrusted import read_text
from rotcal_ros.methods.configuration import (
    Configuration,
    changed,
    parse_configuration,
    read_configuration,
)
from rotcal_ros.methods.fitting import fitting_methods
from rotcal_ros.methods.measurements import read_measurements
from rotcal_ros.methods.method import Measurements, usable_methods
from rotcal_ros.methods.new_setup import (
    AIR,
    OF_THE_ITEM,
    first_asked,
    given_value,
    known_settings,
    setup_text,
    values_of_tables,
)
from rotcal_ros.methods.settings_reference import unit_and_meaning
from rotcal_ros.page.state import Curve, Deviations, PageMark, json_value
from rotcal_ros.recordings.result_sources import read_source
from rotcal_ros.report.page import report_measurement
from rotcal_ros.report.printing import html_to_pdf
from rotcal_tables.sheets.words import TABLE_ANGLE

TABLE, TARGETS, SETUP, AFTER, IN_FORCE = "table", "targets", "setup", "after", "in_force"
FILE_NAMES: Final = {
    TABLE: "table.txt", TARGETS: "targets.txt", SETUP: "given.yaml", AFTER: "after.txt",
}  # fmt: skip
"""What was dropped -> its place in the folder; targets are found beside the table."""
RESULT, GENERATED_SETUP, REPORT, PDF, DCC = (
    "result.json", "setup.yaml", "report.html", "report.pdf", "certificate.xml",
)  # fmt: skip
_STATED: Final = re.compile(r"--set '?([\w.]+)(?:=[^\s;,]*)?")
_ADVICE: Final = re.compile(r"[.:;] (?:State a column with another name by|say which:) --set .*$")
_OPTION: Final = re.compile(
    r"--([a-z]+(?:-[a-z]+)*)(?: (?:\S+\.\w+|[A-Z]+\b|\w+(?: --accept \w+)*(?= ?[;,(]|$)))?"
)
_VERB: Final = re.compile(r" \((?:rotcal [a-z]|--max-age|bridge\.)[^()]*\)")
_NAMED: Final = re.compile(r"(?<![\w./])[a-z]\w*(?:\.[a-z]\w*)+(?![\w(])")
_TICK: Final = phrase("a tick below")
_BOXES: Final = {
    "setup": phrase("Set-up file"),
    "targets": phrase("Targets"),
    "to": phrase("Controller"),
    "replace": phrase("None: the new table replaces whatever is there"),
    "add-to": phrase("One was: the new table is added to it"),
    "spacing": phrase("Distance between rows; if empty, it is chosen"),
    "axis": phrase("Letter of the machine’s axis"),
    "serial": phrase("Serial number of the table in the machine"),
    "set": phrase("Settings, one in a line as NAME=VALUE"),
    "machine-um": phrase("How well the machine measures or places a point (k = 1)"),
    "accept": _TICK,
    "accept-unverified": _TICK,
}
"""Options of the command line -> the boxes of the page that say the same."""
SHOWN_ROWS: Final = 6
METHOD_TITLES: Final = {method.name: phrase(method.title) for method in usable_methods()}
"""Of the methods, which are loaded here: the processes are copies of one that has done so."""
SHORT_LABELS: Final = {
    "identity.item": phrase("Item"),
    "identity.serial": phrase("Serial number"),
    "identity.place": phrase("Place"),
    "identity.operator": phrase("Measured by"),
    "identity.measured": phrase("Day of the measurement"),
    "air.temperature_c": phrase("Temperature of the air"),
    "air.pressure_pa": phrase("Pressure of the air"),
}
"""Shorter than what these settings say of themselves."""
Reply = dict[str, Any]
"""What the page is given: all that JSON can hold."""


@dataclass(frozen=True)
class WorkRequest:
    """The files in ``folder``, what people call them, and what a person has stated.

    ``names`` maps what was dropped to names of files; ``changes`` are ``group.name=value``. The
    ``method`` counts where no set-up was dropped. ``options`` say how something is made.
    """

    folder: Path
    names: Mapping[str, str]
    method: str
    changes: tuple[str, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)

    def configuration(self) -> Configuration:
        """Return the set-up that was dropped, with the changes, or one that is made of these."""
        if SETUP in self.names:
            return changed(read_configuration(self.folder / FILE_NAMES[SETUP]), self.changes)
        known = known_settings(self.method)
        given = (given_value(self.method, known, change) for change in self.changes)
        values = values_of_tables(self.method) | dict(given)
        return parse_configuration(setup_text(self.method, known, values), GENERATED_SETUP)

    def read(self, announce: Callable[[Reading], object] = str, role: str = TABLE) -> Measurements:
        """Return what was measured, with the names that people know."""
        configuration = self.configuration()
        targets = self.folder / FILE_NAMES[TARGETS] if TARGETS in self.names else None
        measured = read_measurements(
            self.folder / FILE_NAMES[role], configuration, targets, announce
        )
        known = {self.describe(name): digest for name, digest in measured.sha256.items()}
        assert is_dataclass(measured)
        return replace(measured, sha256=known)

    def describe(self, text: str) -> str:
        """Return a text with the names of files as people know them."""
        known = {FILE_NAMES[role]: name for role, name in self.names.items() if role in FILE_NAMES}
        text = text.replace(f"{self.folder}/", "").removeprefix(f"{GENERATED_SETUP}: ")
        places = "|".join(map(re.escape, known))
        return re.sub(places, lambda place: known[place[0]], text) if known else text


def setting_label(name: str, meaning: str) -> Phrase:
    """Return what stands beside the field of a setting."""
    return SHORT_LABELS.get(name) or phrase(meaning.replace(", in quotes", ""))


def run_work(sender: Connection, work: Callable[[WorkRequest], Reply], asked: WorkRequest) -> None:
    """Do some work in a process of its own and send its outcome, or the error."""
    signal(SIGINT, SIG_IGN)  # the page ends this process itself
    try:
        reply = work(asked)
    except Exception as error:
        reply = {"error": error_reply(error, asked)}
    sender.send(reply)


def error_reply(error: Exception, asked: WorkRequest) -> Reply:
    """Return an error as the command line says it, with its question, if it asks one."""
    text, *log = error_lines(error)
    question = error.question if isinstance(error, RotcalError) else None
    answers = {*further_lines(question), *(line for line in log if line.startswith("--set "))}
    text = asked.describe(error.found if isinstance(error, UndecidedError) else text)
    known = known_settings(asked.method) if asked.method else ()
    return {
        "text": _at_boxes(text, asked),
        "log": [asked.describe(line) for line in log if line not in answers],  # buttons say those
        "question": question and _in_words(question, asked),
        "names": [found for found in known if re.search(rf"(?<![\w.]){found}(?![\w.]*\w)", text)],
    }


def settings_on_page(method: str) -> list[str]:
    """Return the settings that the page has a box for, those of the measurement first."""
    known, stated = known_settings(method), values_of_tables(method)
    first = [name for name in first_asked(known, stated) if name not in stated]
    identity = [name for name in known if name.startswith("identity.") and name not in OF_THE_ITEM]
    return [*first, *OF_THE_ITEM, *AIR, *identity]


def _options_alone(found: re.Match[str]) -> str:
    """Return of what the command line is told, in brackets, the options that have boxes."""
    options = [f"--{name}" for name in re.findall("--([a-z-]+)", found[0]) if name in _BOXES]
    return f" ({', '.join(options)})" if options else ""


def name_page_fields(text: str, method: str) -> Phrase:
    """Return an error with the boxes of the page in the place of options of the command line.

    Its parts are the labels, which the page translates. A setting of a method without a box is one
    of a set-up file.
    """
    known = known_settings(method) if method else {}
    boxes, labels = settings_on_page(method) if known else [], list[Phrase]()

    def place(label: Phrase, quote: str = '"') -> str:
        labels.append(label)
        return f"{quote}{{{len(labels) - 1}}}{quote}"

    def setting(found: re.Match[str]) -> str:
        name = found[0]
        if name not in known:
            return name
        if name in boxes:
            return place(setting_label(name, unit_and_meaning(known[name])[1]))
        return place(phrase("{0} (in a set-up file)", name), "")

    def option(found: re.Match[str]) -> str:
        label = _BOXES.get(found[1])
        if label is None:
            return found[0]
        rest = found[0].removeprefix("--set") if found[1] == "set" else ""
        return place(label, "" if label is _TICK else '"') + rest

    text = _ADVICE.sub("", text)
    text = _STATED.sub(lambda found: found[1] if "." in found[1] else f"--set {found[1]}", text)
    text = _VERB.sub(_options_alone, text.replace("{", "(").replace("}", ")"))
    text = _OPTION.sub(option, _NAMED.sub(setting, text))
    return phrase(text, *labels)


def _at_boxes(text: str, asked: WorkRequest) -> Any:
    shown = name_page_fields(text.replace("--reference-u ARCSEC (k = 1), ", ""), asked.method)
    return json_value(shown) if shown.parts else shown


def _in_words(question: Question, asked: WorkRequest) -> Reply:
    """Return a question for the page, with those that are asked besides."""
    return {
        "setting": question.setting,
        "found": _at_boxes(asked.describe(question.found), asked),
        "answers": [(value, asked.describe(words)) for value, words in question.answers],
        "also": [_in_words(each, asked) for each in question.also],
    }


def list_fitting_methods(asked: WorkRequest) -> Reply:
    """Return the methods whose columns the table has, those that need nothing else first."""
    found = fitting_methods(asked.folder / FILE_NAMES[TABLE])
    found = sorted(found, key=lambda method: method.table is None or method.table.needs_setup)
    return {"methods": [method.name for method in found]}


def explain_tables(asked: WorkRequest) -> Reply:
    """Return how the tables are understood, as far as they are, and what stands against it."""
    readings, error = list[Reading](), None
    try:
        asked.read(readings.append)
    except Exception as stopped:
        error = error_reply(stopped, asked)
    tables = [_table(each, asked) for read in readings for each in (read, *read.beside)]
    return {"tables": tables, "error": error}


def _table(reading: Reading, asked: WorkRequest) -> Reply:
    return {
        "name": asked.describe(reading.table.path.name),
        "form": json_value(reading.form),
        "rows": len(reading.table.lines),
        "columns": list(_columns(reading)),
        "head": reading.head,
        "aside": reading.aside,
        "remarks": json_value((*reading.remarks, *map(asked.describe, reading.sources))),
        "left_out": json_value(reading.left_out),
        "header": reading.table.header,
        "first": reading.table.lines[:SHOWN_ROWS],
    }


def _columns(reading: Reading) -> Iterator[Reply]:
    """Yield our columns: what of theirs each is, and how that could be understood otherwise."""
    for header, theirs in reading.columns.items():
        column = TableColumn.of(header)
        angle = column.name == "position" and TABLE_ANGLE in reading.uses
        use = reading.uses.get(TABLE_ANGLE if angle else column.name)
        quantity = TABLE_ANGLE if angle else column.quantity
        yield {
            "header": header,
            "name": TABLE_ANGLE if angle else column.name,
            "theirs": json_value(theirs),
            "text": None if use is None else use.text,
            **_unit(use, quantity, column.name),
        }


def _unit(use: Use | None, quantity: str, name: str) -> Reply:
    """Return the setting of a unit that the head of a column does not state, and its choices."""
    if quantity not in UNITS or (use is not None and len(use.units) == 1):
        return {"setting": None, "units": () if use is None else use.units}
    return {"setting": unit_setting(name, quantity), "units": tuple(UNITS[quantity])}


def solve_table(asked: WorkRequest) -> Reply:
    """Solve the table; keep the result, and the set-up with which the command line repeats it."""
    result = asked.read().solve()
    write_atomically(asked.folder / RESULT, result.to_json())
    write_atomically(asked.folder / GENERATED_SETUP, asked.configuration().text)
    return {
        "deviations": json_value(page_deviations(result)),
        "verdict": result.verdict,
        "simulated": result.circumstances.simulated,
        "warnings": json_value(result.warnings),
        "rejected": len(result.rejected),
        "dof": result.dof,
        "sigma0": result.sigma0,
        "files": [RESULT, GENERATED_SETUP],
    }


def page_deviations(result: Result) -> Deviations:
    """Return a result as the operator's page shows it; without U if that is withheld."""
    why = why_withheld(result)
    curves = []
    for name in result.components:
        size, label = unit_of(name)
        expanded = () if why else tuple(COVERAGE_FACTOR * result.std[name] / size)
        curves.append(Curve(name, label, tuple(result.deviations[name] / size), expanded))
    return Deviations(
        angles_deg=tuple(result.angles / DEGREE),
        curves=tuple(curves),
        observations=result.n_observations,
        final=True,
        marks=tuple(map(PageMark.of, marks(result))),
        warnings=result.warnings,
        withheld=why or "",
    )


def verify_tables(asked: WorkRequest) -> Reply:
    """Judge the measurement by a second one, made with the table in force.

    The option ``stated`` holds changes for the second table alone.
    """
    own = replace(asked, changes=(*asked.changes, *map(str, asked.options["stated"])))
    results = {
        f"1 ({asked.names[TABLE]})": read_source(asked.folder / RESULT).result,
        f"2 ({asked.names[AFTER]})": own.read(role=AFTER).solve(),
    }
    found = verification_of(results)
    before, after = found.before, found.after
    columns = before.angles / DEGREE, before.deviation / ARCSEC, after.deviation / ARCSEC
    acts = [] if found.effect is None else [found.fault or found.effect.describe()]
    return {
        "verdict": found.verdict,
        "words": json_value((*acts, found.figures, *found.reserves)),
        "rows": [[f"{a:g}", f"{b:.2f}", f"{c:.2f}"] for a, b, c in zip(*columns, strict=True)],
    }


def write_report(asked: WorkRequest) -> Reply:
    """Write the report."""
    with use_language(str(asked.options["language"])):
        report_measurement(asked.read(), asked.folder / REPORT)
    return {"files": [REPORT]}


def write_pdf(asked: WorkRequest) -> Reply:
    """Print the report."""
    data = html_to_pdf(read_text(asked.folder / REPORT))
    replace_atomically(asked.folder / PDF, partial(write_durably, content=data))
    return {"files": [PDF]}


def write_dcc(asked: WorkRequest) -> Reply:
    """Write the digital calibration certificate."""
    (asked.folder / DCC).unlink(missing_ok=True)
    write = plugins.load(plugins.FUNCTIONS, "write_certificate", "function")
    write(read_source(asked.folder / RESULT).result, asked.folder / DCC)
    return {"files": [DCC]}


def export_to_controller(asked: WorkRequest) -> Reply:
    """Write the files for a controller, by the code of ``rotcal export``."""
    folder, result, options = asked.folder / "controller", asked.folder / RESULT, asked.options
    spacing, accepted = options["spacing"], set(map(str, options["accept"]))
    shutil.rmtree(folder, ignore_errors=True)
    request = ExportRequest(
        str(options["controller"]),
        folder,
        spacing=None if spacing is None else float(spacing),
        axis=str(options["axis"]) or None,
        serial=str(options["serial"]) or None,
        settings=tuple(filter(None, str(options["settings"]).splitlines())),
        replace=options["in_force"] == "replace",
        add_to=asked.folder / IN_FORCE if options["in_force"] == "add" else None,
        accept=tuple(accepted - {UNVERIFIED}),
        accept_unverified=UNVERIFIED in accepted,
    )
    export, files = write_export(read_source(result), request)
    words = [asked.describe(line) for line in export.describe()]
    return {"files": [f"{folder.name}/{file.name}" for file in files], "words": words}


def advise_plan(asked: WorkRequest) -> Reply:
    """Return what ``rotcal plan advise`` says, given its ``arguments``; without any what it knows.

    Raises ConfigurationError where the package is missing, or the arguments are none of it.
    """
    advise = plugins.extension(plugins.PLANS, "advise", "advice before a measurement")
    with redirect_stdout(StringIO()) as printed:
        try:
            advise.main([*map(str, asked.options["arguments"]), "--json"], standalone_mode=False)
        except UsageError as error:
            raise ConfigurationError(error.format_message()) from error
    found: Reply = json.loads(printed.getvalue())
    for way in found.get("ways", ()):
        way["refused"] = _at_boxes(way["refused"], asked)
    return found


WORK_FUNCTIONS: Final[Mapping[str, Callable[[WorkRequest], Reply]]] = {
    "fit": list_fitting_methods,
    "explain": explain_tables,
    "solve": solve_table,
    "verify": verify_tables,
    "report": write_report,
    "pdf": write_pdf,
    "dcc": write_dcc,
    "controller": export_to_controller,
    "advise": advise_plan,
}
"""What the page may ask for."""
