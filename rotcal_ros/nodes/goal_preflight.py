"""Before a goal moves anything: all nodes and instruments are there, and fit its configuration."""

from __future__ import annotations

from functools import partial

from rotcal_ros.catalogue import Calibration
from rotcal_ros.instruments.conventions import single_shots
from rotcal_ros.node_names import PREFLIGHT_NODES, VIEWERS
from rotcal_ros.nodes.asking import Asking
from rotcal_ros.nodes.cell_links import CellLinks
from rotcal_ros.nodes.concerns import PREFLIGHT
from rotcal_ros.nodes.crew import Codes
from rotcal_ros.nodes.goal_watch import GoalWatch
from rotcal_ros.nodes.preflight import doubts, expected_air, faults, without_air
from rotcal_ros.nodes.sim_clock import unlike_clocks
from rotcal_ros.nodes.topic_names import names_at_odds, topics_value


async def be_ready(calibration: Calibration, watch: GoalWatch, asking: Asking) -> None:
    """Wait for all nodes and topics; GoalError names what is missing after the time for it."""
    links, configuration = watch.links, calibration.configuration
    links.forget()
    if watch.preflight:  # a later one, after a lost node, hears of a stop in between
        watch.stop.forget()
    watch.tell("preflight: nodes")
    await watch.have(links.missing_nodes, Codes.NODE_LOST)
    nodes = watch.crew.nodes = watch.crew.nodes | _needed(links)
    watch.tell("preflight: clocks")
    await watch.have(lambda: unlike_clocks(links.health, configuration), Codes.TOPIC_MISSING)
    watch.tell("preflight: topics")
    await _have_topics(calibration, watch, asking)
    _, wished = expected_air(calibration)
    unheard = [
        without_air(role, name, configuration) for role, name in links.missing_air(wished).items()
    ]
    links.warn(
        PREFLIGHT, unheard + doubts(links.health.values("capture"), configuration, calibration)
    )
    watch.crew.nodes = nodes | _needed(links)
    watch.refuse_stop()
    watch.preflight = False


def _needed(links: CellLinks) -> set[str]:
    """Return the nodes of the suite and those that are here; nobody needs what shows something."""
    return (links.health.present() | set(PREFLIGHT_NODES)) - {*VIEWERS.values()}


async def _have_topics(calibration: Calibration, watch: GoalWatch, asking: Asking) -> None:
    """Wait for the topics; a stop that has broken the run off is released and resumed first.

    Instruments may be silent meanwhile, and a capture that was started anew has heard nothing.
    """
    missing = partial(_missing, calibration, watch.links)
    # What is missing may be there and not have been found; what is not there is waited for below.
    await watch.is_found(lambda: [] if _halted(watch) else missing())
    while True:
        await watch.have(lambda: [] if _halted(watch) else missing(), Codes.TOPIC_MISSING)
        if not _halted(watch):
            return
        await asking.have_done()


def _halted(watch: GoalWatch) -> bool:
    """Return whether somebody has to resume after an emergency stop: never in the first one."""
    return not watch.preflight and bool(watch.stop.heed())


def _missing(calibration: Calibration, links: CellLinks) -> list[str]:
    """Return what is missing around the topics, in words."""
    configuration = calibration.configuration
    if odd := names_at_odds(links.node, topics_value(configuration)):
        return odd
    needed, _ = expected_air(calibration)
    air = [
        f"nobody publishes {name}, without which the index of refraction is unknown"
        for name in links.missing_air(needed).values()
    ]
    wrong = faults(links.health.values("capture"), configuration, calibration.plan)
    silent, stop = single_shots(configuration.topics), configuration.safety.emergency_stop
    return links.missing_topics(calibration.method.topics, silent, stop) + air + wrong
