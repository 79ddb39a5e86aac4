"""The schemas of PTB for digital calibration certificates, as published: see schema/README.md.

Nothing is fetched: what they import is looked for beside them, the schema of W3C's signatures in
the package signxml.
"""

from pathlib import Path

import signxml
from lxml import etree

FOLDER = Path(__file__).parent / "schema"


def read_schema():
    """Return the schema."""
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
