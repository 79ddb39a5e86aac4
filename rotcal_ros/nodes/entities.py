"""What a node has made in the middleware, so that it can be given back."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any

from rclpy.node import Node


def entities(node: Node) -> Iterator[Any]:
    """Yield all publishers, subscriptions, clients, services, timers and actions of a node."""
    yield from node.waitables
    yield from node.timers
    yield from node.subscriptions
    yield from node.services
    yield from node.clients
    yield from node.publishers


def destroy(node: Node, kept: Collection[Any]) -> None:
    """Destroy all entities but those ``kept``; what belongs to another one goes with that."""
    ways = (
        (node.timers, node.destroy_timer),
        (node.subscriptions, node.destroy_subscription),
        (node.services, node.destroy_service),
        (node.clients, node.destroy_client),
        (node.publishers, node.destroy_publisher),
    )
    for present, destroy_one in ways:
        for entity in [e for e in present if e not in kept]:
            destroy_one(entity)
    for action in [e for e in node.waitables if e not in kept]:
        action.destroy()
