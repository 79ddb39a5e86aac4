"""The bridge over DDS: what is in force, and what is measured on top of it."""

from dataclasses import replace

import numpy as np
import pytest
from test_bridge import Bench, table

pytestmark = pytest.mark.ros


@pytest.fixture
def bench(cell, tmp_path):
    made = Bench(cell, tmp_path)
    yield made
    made.end()


def test_the_cell_hears_what_is_in_force_and_what_it_leaves_is_added(bench):
    from rotcal_msgs.msg import TableInForce

    from rotcal_ros.nodes.runtime.qos import LATCHED

    heard = []
    bench.node.create_subscription(
        TableInForce, "table_in_force", lambda m: heard.append(m.in_force), LATCHED
    )
    bench.publish(table())
    bench.start()
    bench.wait_for_state("written, not applied")
    bench.wait(lambda: heard, "the table in force")
    assert heard[-1] == "unknown"
    assert bench.apply().success
    bench.wait(lambda: len(heard[-1]) == 64, "a hash in force")
    first = np.loadtxt(bench.controller / "c_linuxcnc.comp")[:, 1]

    bench.publish(replace(table(0.1), measured_on="f" * 64))
    bench.wait_for_state("not added: measured with table ffffffffffff in force")
    bench.publish(replace(table(0.1), measured_on=heard[-1]))
    status = bench.wait_for_state("written, not applied")
    assert status["in_force"].startswith(f"adds to the table {heard[-1]}")
    assert bench.apply().success
    both = np.loadtxt(bench.controller / "c_linuxcnc.comp")[:, 1]
    # a tenth on top; looked up at the corrected angle it differs by 1e-4 arcsec at most
    np.testing.assert_allclose(both, 1.1 * first, atol=1e-3 / 3600.0)
