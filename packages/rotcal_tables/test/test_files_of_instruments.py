"""Files as the programs of instruments write them, read by entry point."""

import pytest
from click.testing import CliRunner

from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.recordings.inputs import Input

UP, DOWN = [(0.1, 3.2, -1.5), (0.3, 3.4, -1.1)], [(0.9, 4.4, -0.5), (1.1, 4.0, -0.3)]
SAID = (
    "sheet.values=deviations", "sheet.reading_unit=arcsec", "sheet.angle_unit=deg",
)  # fmt: skip


def rtl(count=3):
    """Return two runs up and two down at 0, 120 and 240, as sections, numbers and line ends."""
    runs = [UP[0], DOWN[0], UP[1], DOWN[1]]
    data = [
        f"    {run}   {k + 1}      {values[k]:.6f}"
        for run, values in enumerate(runs, start=1)
        for k in (range(3) if run % 2 else (2, 1, 0))
    ]
    return "\r\n".join([
        "HEADER::", "File type:rtl", "Owner:nobody", "Version no:1", "", "TARGET DATA::",
        "Filetype:rtl", f"Target-count: {count}", "Targets :", "0.000000  120.000000",
        "240.000000", "Flags: 1 0", "", "USER-TEXT::", "Machine: mill", "", "RUNS::",
        "Run-count: 4", "", "DEVIATIONS::", "Run Target Data:", *data, "", "ENVIRONMENT::",
        "EOF::", "",
    ])  # fmt: skip


def solved(path):
    return Input(path, changes=SAID).read().solve()


def test_runs_of_a_laser_are_read_with_their_directions_and_units_are_asked(tmp_path):
    (path := tmp_path / "c.rtl").write_text(rtl(), newline="")
    asked = CliRunner().invoke(rotcal, ["solve", str(path)])
    assert asked.exit_code == 2
    unit, _, _, mrad, _, sign, deviations, _, all_of_it = asked.stderr.splitlines()[-9:]
    assert unit.startswith("asked as well: ")
    assert "the column 'deviation' (deviation) states no unit" in unit
    assert mrad == "--set sheet.reading_unit=mrad: 4.4 mrad = 0.0044 rad"
    assert sign.endswith("(commanded - actual) (if reading_unit=arcsec)")
    assert deviations.startswith("--set sheet.values=deviations: there the axis stands 4.4 arcsec")
    head, *words = all_of_it.split(" --set ")
    assert head == "all at once:"
    answers = dict(zip(words, ("deg", "arcsec", "deviations"), strict=True))
    given = [f"--set={each.partition('=')[0]}={value}" for each, value in answers.items()]
    assert CliRunner().invoke(rotcal, ["solve", str(path), *given]).exit_code == 0
    both = solved(path).directions["ECC"]
    assert both.angles / DEGREE == pytest.approx([0.0, 120.0, 240.0])
    assert both.forward / ARCSEC == pytest.approx([0.2, 3.3, -1.3])
    assert both.reverse / ARCSEC == pytest.approx([1.0, 4.2, -0.4])


def test_a_changed_byte_changes_the_value_and_a_contradiction_is_refused(tmp_path):
    (path := tmp_path / "c.rtl").write_text(rtl().replace("3.200000", "3.900000"), newline="")
    assert solved(path).directions["ECC"].forward[1] / ARCSEC == pytest.approx(3.65)
    path.write_text(rtl(count=4), newline="")
    with pytest.raises(BagError, match="Target-count is 4, and 3 targets are listed"):
        solved(path)
    path.write_text(rtl().replace("4.000000", "4,000 000"), newline="")
    with pytest.raises(BagError, match="is no run, target and deviation"):
        solved(path)
