"""Which topic plays which role: other names, of one cell of several."""

import pytest

from rotcal_ros.bags import names
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.recordings.topics import Topics

LENGTHS = {names.TRACER_LENGTH: "lengths"}


@pytest.mark.parametrize("namespace", ["/cell_a", "cell_a"])
def test_a_relative_name_is_one_of_the_cell_that_is_meant(namespace):
    topics = Topics(namespace, planned=LENGTHS)
    assert topics.role("/cell_b/lengths") is None
    assert topics.role("/cell_a/lengths") == names.TRACER_LENGTH
    assert topics.role("/cell_a/tracer_length") is None


def test_without_a_cell_two_topics_of_a_name_are_refused():
    topics = Topics(planned=LENGTHS)
    assert topics.role("/cell_a/lengths") == names.TRACER_LENGTH
    with pytest.raises(BagError, match="--namespace"):
        topics.role("/cell_b/lengths")


def test_a_role_is_open_again_once_the_configuration_is_known():
    topics = Topics()
    assert topics.role("/cell/tracer_length") == names.TRACER_LENGTH
    topics.follow({names.TRACER_LENGTH: "/etalon/lengths"})
    assert topics.role("/etalon/lengths") == names.TRACER_LENGTH
    assert topics.role("/cell/tracer_length") is None
