"""Both messages of an order become one command, in whatever order they arrive."""

from types import SimpleNamespace

from hypothesis import given
from hypothesis import strategies as st

from rotcal_ros.capture.messages import WAITING_LIMIT, OrderPairing
from rotcal_ros.foundation.observations import Approach, Command, PointKind

HEADER = SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=0))


def table(step, attempt=0, angle=0.5):
    return SimpleNamespace(header=HEADER, step=step, attempt=attempt, angle=angle, approach=1)


def probe(step, attempt=0, target=3):
    return SimpleNamespace(
        header=HEADER, step=step, attempt=attempt, kind=1, target=target,
        position=(1.0, 2.0, 3.0), station=2,
    )  # fmt: skip


def fed(orders, messages):
    """Feed messages and return the commands that they give."""
    answers = [
        orders.probe_target(m) if hasattr(m, "target") else orders.table_angle(m) for m in messages
    ]
    return [command for command in answers if command is not None]


def test_the_second_message_completes_the_order():
    expected = Command(7, 1, 0.5, Approach(1), PointKind(1), 3, (1.0, 2.0, 3.0), 2)
    for messages in ((table(7, 1), probe(7, 1)), (probe(7, 1), table(7, 1))):
        orders = OrderPairing()
        assert fed(orders, messages[:1]) == []
        assert fed(orders, messages[1:]) == [expected]
        assert fed(orders, messages[1:]) == []  # a complete order is forgotten


def test_step_and_attempt_must_agree():
    assert fed(OrderPairing(), [table(1, 0), probe(1, 1), probe(2, 0)]) == []


def test_a_repeated_message_replaces_the_earlier_one():
    (command,) = fed(OrderPairing(), [table(1, angle=0.1), table(1, angle=0.2), probe(1)])
    assert command.table_angle == 0.2


def test_nothing_is_joined_after_clear():
    orders = OrderPairing()
    assert fed(orders, [table(1)]) == []
    orders.clear()
    assert fed(orders, [probe(1)]) == []


def test_memory_is_bounded_and_the_oldest_is_forgotten_first():
    orders = OrderPairing()
    assert fed(orders, map(table, range(WAITING_LIMIT + 1))) == []
    later = range(1, WAITING_LIMIT + 1)
    assert [c.step for c in fed(orders, map(probe, later))] == list(later)
    assert fed(orders, [probe(0)]) == []


@given(
    st.lists(st.integers(0, 20), unique=True, min_size=1, max_size=20).flatmap(
        lambda steps: st.permutations([m for s in steps for m in (table(s), probe(s))])
    )
)
def test_any_order_of_arrival_gives_every_command_once(messages):
    commands = fed(OrderPairing(), messages)
    assert {(c.step, c.attempt) for c in commands} == {(m.step, m.attempt) for m in messages}
    assert len(commands) == len(messages) // 2
    last = [m.step for k, m in enumerate(messages) if m.step in {n.step for n in messages[:k]}]
    assert [c.step for c in commands] == last  # each with its second message
