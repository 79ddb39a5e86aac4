"""The schemas of PTB for digital calibration certificates, as published, where they are at hand.

They are under the LGPL, version 3, and not part of this repository. A folder, named by the
environment variable ROTCAL_DCC_SCHEMA, holds them under the last parts of their addresses:
https://ptb.de/dcc/v3.3.0/dcc.xsd, https://ptb.de/si/v2.2.1/SI_Format.xsd and
https://ptb.de/si/v2.2.1/qudt/quantitykind.xsd. Nothing is fetched: what they import is
looked for in that folder, the schema of W3C's signatures in the package signxml.
"""

import os
from pathlib import Path

import pytest
import signxml
from lxml import etree

FOLDER = Path(os.environ.get("ROTCAL_DCC_SCHEMA", "build/dcc_schema"))


def read_schema():
    """Return the schema; skips the test where it is not at hand."""
    if not (FOLDER / "dcc.xsd").is_file():
        pytest.skip("no schema of PTB here: ROTCAL_DCC_SCHEMA names its folder")
    folders = (FOLDER, Path(signxml.__file__).parent / "schemas")

    class Local(etree.Resolver):
        """Finds every schema by the name of its file."""

        def resolve(self, url, _public_id, context):
            name = url.rpartition("/")[2]
            found = next((f / name for f in folders if (f / name).is_file()), None)
            return None if found is None else self.resolve_filename(str(found), context)

    parser = etree.XMLParser(no_network=True)
    parser.resolvers.add(Local())
    return etree.XMLSchema(etree.parse(str(FOLDER / "dcc.xsd"), parser))
