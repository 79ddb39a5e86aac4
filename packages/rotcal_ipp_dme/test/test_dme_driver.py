"""Which orders the driver carries out, which it gives up, and when it stops the machine."""

from dataclasses import replace
from itertools import count
from math import degrees

import pytest
from wire import DEADLINE_S, wait_for

from rotcal_ipp_dme.driver import Driver, OrderRunner
from rotcal_ipp_dme.settings import DmeSettings
from rotcal_ros.foundation.node_state import NodeState, State, Why
from rotcal_ros.foundation.observations import Approach, Command, PointKind
from rotcal_ros.planning.plan import Step

TARGET = Command(3, 0, 0.5, Approach.POSITIVE, PointKind.SURFACE, 0, (0.1, 0.0, 0.0))
STEP = Step(3, 0, 0.5, Approach.POSITIVE, PointKind.SURFACE, 0, (0.1, 0.0, 0.0), 0, 2, 0.025)


def driver_of(server, *, begin=True):
    complaints, points = [], []
    settings = DmeSettings(
        port=server.port, home=True, settle_s=0.004, reply_timeout_s=DEADLINE_S,
        motion_timeout_s=10.0 * DEADLINE_S, idle_period_s=0.02, turn_by="goto_r",
        table_zero_deg=-28.6479,
    )  # fmt: skip
    driver = Driver(settings, lambda _: None, points.append, complaints.append)
    if begin:
        driver.begin()
    return driver, points, complaints


def test_an_order_is_refused_before_a_person_clears(serve):
    server = serve("PtMeas", "error")
    driver, points, complaints = driver_of(server)
    wait_for(lambda: driver.state.state is State.READY)
    driver.order(TARGET, STEP)
    wait_for(lambda: complaints)
    assert "PtMeas" in complaints[0]
    driver.order(TARGET, STEP)
    wait_for(lambda: driver.refused == 1)
    assert "step 3, attempt 0 refused until a person clears: PtMeas" in complaints[1]
    server.harmed = ""
    assert "cleared: PtMeas" in driver.clear().result(DEADLINE_S)
    driver.order(TARGET, STEP)
    wait_for(lambda: sum(p.kind == PointKind.SURFACE for p in points) == 2 and not driver.busy)
    driver.stop()
    wait_for(lambda: not driver.alive)
    assert server.names()[-1] == "EndSession"


def test_behind_a_stop_no_session_begins_before_a_person_clears(serve):
    server = serve()
    driver, points, _ = driver_of(server, begin=False)
    driver.begin("no session was started: emergency stop")
    words = "no session was started: emergency stop"
    wait_for(lambda: driver.state == NodeState.of(State.FAILED, Why.BLOCKED, words))
    assert server.names() == []
    driver.clear().result(DEADLINE_S)
    assert "StartSession" in server.names()
    wait_for(lambda: points)
    driver.stop()
    wait_for(lambda: not driver.alive)


def test_a_cancel_aborts_what_moves_and_only_a_person_goes_on(serve):
    server = serve("GoTo", "accepted, never done")
    driver, points, _complaints = driver_of(server)
    wait_for(lambda: driver.state.state is State.READY)
    driver.order(TARGET, STEP)
    wait_for(lambda: "GoTo" in server.names())
    driver.abort("the calibration ended")
    wait_for(lambda: server.names()[-1] == "AbortE")
    assert driver.client.blocked == "the calibration ended"
    assert not [p for p in points if p.kind == PointKind.SURFACE]
    driver.stop()


def test_a_cancel_aborts_what_moves_after_an_error_that_nobody_asked_for_too(serve):
    server = serve("GoTo", "accepted, never done")
    driver, _points, complaints = driver_of(server)
    wait_for(lambda: driver.state.state is State.READY)
    driver.order(TARGET, STEP)
    wait_for(lambda: "GoTo" in server.names())
    server.tell('E0000 ! Error(3, 1009, "Machine", "Air pressure out of range")')
    wait_for(lambda: complaints)
    assert "Air pressure" in driver.client.blocked
    assert "AbortE" not in server.names()
    driver.abort("the calibration ended")
    wait_for(lambda: "AbortE" in server.names())
    assert "Air pressure" in driver.client.blocked
    driver.stop()


def test_the_end_in_the_middle_of_a_motion_aborts_it(serve):
    server = serve("PtMeas", "accepted, never done")
    driver, points, _complaints = driver_of(server)
    wait_for(lambda: driver.state.state is State.READY)
    driver.order(TARGET, STEP)
    wait_for(lambda: "PtMeas" in server.names())
    driver.stop()
    wait_for(lambda: "AbortE" in server.names())
    assert server.names().index("AbortE") > server.names().index("PtMeas")
    assert points == []


@pytest.mark.parametrize("cleared", [False, True])
def test_the_end_while_a_machine_is_homed_aborts_that_too(serve, cleared):
    server = serve("IsHomed", "error") if cleared else serve("Home", "accepted, never done")
    driver, _points, complaints = driver_of(server)
    if cleared:  # a person's word begins the session anew
        wait_for(lambda: complaints)
        server.harmed, server.fault = "Home", "accepted, never done"
        driver.clear()
    wait_for(lambda: "Home" in server.names())
    driver.stop()
    wait_for(lambda: not driver.alive)  # the answer to Home never comes
    wait_for(lambda: "AbortE" in server.names())
    assert server.names()[-2:] == ["Home", "AbortE"]
    assert (server.names().count("Home"), driver.alive) == (1, False)


def turns(server):
    """Return to which R (deg) the table was sent."""
    ways = [call.arguments[0] for call in server.heard if call.name == "GoTo"]
    return [way.number() for way in ways if way.name == "R"]


def test_nothing_is_sent_before_the_driver_begins(serve):
    server = serve()
    driver, points, complaints = driver_of(server, begin=False)
    driver.order(TARGET, STEP)
    assert not driver.alive
    driver.stop()
    assert (server.heard, points, complaints) == ([], [], [])


def test_what_is_forgotten_while_a_session_begins_is_never_done(serve):
    server = serve("Home", "late")
    driver, points, _complaints = driver_of(server)
    driver.order(TARGET, STEP)
    driver.forget()
    wait_for(lambda: len(points) > 1)  # reported unasked, behind the order
    assert "GoTo" not in server.names()
    driver.stop()


def test_of_orders_that_wait_only_the_last_is_carried_out(serve):
    server = serve("Home", "late")
    driver, points, _complaints = driver_of(server, begin=False)
    for step in (1, 2, 3):
        driver.order(replace(TARGET, step=step, table_angle=0.5 + 1e-3 * step), STEP)
    driver.begin()
    wait_for(lambda: sum(p.kind == PointKind.SURFACE for p in points) == 2 and not driver.busy)
    assert {p.step for p in points if p.kind == PointKind.SURFACE} == {3}
    third_deg = degrees(3e-3)
    assert turns(server) == pytest.approx([third_deg - 2.0, third_deg], abs=1e-4)
    driver.stop()


@pytest.mark.parametrize("kind", [PointKind.SURFACE, PointKind.REFLECTOR])
def test_before_every_motion_it_is_asked_whether_somebody_wants_it_still(serve, kind):
    server = serve()
    client = driver_of(server, begin=False)[0].client
    client.start()
    order = replace(TARGET, kind=kind, position=(0.1, 0.0, 0.3), approach=Approach.NEGATIVE)
    for motions in range(3):
        before, asked = server.names().count("GoTo"), count()
        measuring = OrderRunner(client, lambda: 0)
        given_up = lambda: next(asked) >= motions  # noqa: B023, E731
        assert list(measuring.carry_out(order, STEP, given_up)) == []
        assert server.names().count("GoTo") == before + motions
    client.close()


def test_the_end_does_not_wait_for_a_machine_that_answers_nothing(serve):
    server = serve("GoTo", "accepted, never done")
    driver, _points, complaints = driver_of(server)
    wait_for(lambda: driver.state.state is State.READY)
    driver.order(TARGET, STEP)
    wait_for(lambda: "GoTo" in server.names())
    answer, answered = server._answer, []
    server._answer = lambda *told: wait_for(lambda: answered) or answer(*told)
    driver.stop()  # the answer to AbortE comes only behind this
    assert complaints == []
    answered.append(True)
    wait_for(lambda: "AbortE" in server.names())
