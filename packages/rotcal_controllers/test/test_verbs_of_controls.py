"""What `rotcal export` and `rotcal verify` say of what these controls cannot take."""

import pytest
from test_cli_export import export  # noqa: F401
from test_settings_everywhere import CONFIG, refused  # noqa: F401


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--to", "fanuc", "--spacing", 10], "--accept-unverified"),
        (["--to", "sinumerik", "--spacing", 7], "choose a spacing that divides 360"),
    ],
)
def test_an_export_is_refused(export, tmp_path, arguments, words):  # noqa: F811
    run = export(*arguments)
    assert (run.exit_code, words in run.stderr) == (2, True)
    assert not (tmp_path / "files").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--to", "fanucc"], "did you mean 'fanuc'"),
        (["--to", "fanuc"], "--accept-unverified"),
        (
            ["--to", "heidenhain", "--accept-unverified", "--set", "plan.table_positions=12"],
            "measure the full circle",
        ),
    ],
    ids=str,
)
def test_a_verification_is_refused_before_it_measures(refused, options, words):  # noqa: F811
    assert words in refused("verify", CONFIG / "verify_demo.yaml", "-o", "out", *options)
