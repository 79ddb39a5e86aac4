"""A certificate of hostile names is XML without what nobody sees."""

from datetime import date

from lxml import etree
from test_hostile_names import every_name, named, unseen

from rotcal_history.certificate.document import make_certificate


@every_name
def test_a_certificate_is_xml(name):
    root = etree.fromstring(make_certificate(named(name), name, date(2026, 1, 1)))
    assert not unseen("".join(root.itertext()))
