"""A folder that contains itself ends the search for bags."""

import strange_paths as strange
from test_strange_paths import answer, wrong


def test_a_folder_that_contains_itself_holds_no_bags(tmp_path):
    path = strange.made("folder in itself", tmp_path, "")
    setup, new = str(strange.DATA / "tracer.yaml"), str(tmp_path / "new")
    for source in (str(path), f"{path}/**"):
        arguments = ["reprocess", source, "--setup", setup, "-o", new]
        assert not wrong(arguments)
        assert "names no bag" in answer(arguments).stderr
