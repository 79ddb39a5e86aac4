"""Which files are tables of numbers."""

import pytest

from rotcal_ros.foundation.tables import is_table


@pytest.mark.parametrize(
    ("name", "content", "is_one"),
    [
        ("a.csv", b"position\n1\n", True),
        ("a.txt", b"position\n1\n", False),
        ("a.txt", b"position;length\n1;2\n", True),
        ("a.dat", b"\xff\xfep\x00", True),  # UTF-16
        ("a.bin", b"\xff\xfep\x00", False),
        ("a.json", b"position;length\n1;2\n", False),
        ("a.prn", b"1;2\0", False),
    ],
)
def test_a_table_is_told_by_its_ending_or_by_its_columns(tmp_path, name, content, is_one):
    (tmp_path / name).write_bytes(content)
    assert is_table(tmp_path / name) == is_one
