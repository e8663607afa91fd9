"""What is wrong between several PubSub connections, and between them and the processes that are on them."""

from __future__ import annotations

from typing import Final

from ua_fleet.config.connections import OF_ALL
from ua_fleet.config.parts import Parts
from ua_fleet.config.pubsub_schema import PubSubConfig
from ua_fleet.config.relay_checks import relayed_to
from ua_fleet.config.relay_schema import RelayConfig
from ua_fleet.config.schema import ServerConfig
from ua_fleet.document import Document, KeyPath, as_mapping
from ua_fleet.names import closest, listed
from ua_fleet.pubsub.security.replay import MOST_WINDOWS

__all__ = ["check_connections", "check_list"]

MOST_REQUESTORS: Final = MOST_WINDOWS - 1
"""Spaces whose commands are told from replayed ones, beside the bridge's own, which answers under the same key."""


def check_list(document: Document, items: list[object], connections: list[PubSubConfig | None]) -> None:
    """Note the problems of a list of connections; those that are not valid by themselves are None."""
    path: KeyPath = ("pubsub",)
    if not items:
        document.problem(path, "names no connection", "write the keys of one, or a list of at least one")
    names: dict[str, int] = {}
    places: dict[object, int] = {}
    for number, (item, connection) in enumerate(zip(items, connections, strict=True)):
        given = as_mapping(item) or {}
        for key in OF_ALL if number else ():
            if key in given and connection and connections[0] and _differs(connection, connections[0], key):
                document.problem(
                    (*path, number, key), "holds for all connections", "write it in the first one, and remove it here"
                )
        if connection is None:
            continue
        if connection.name is None:
            document.problem((*path, number), "`name` is missing", "each connection of a list has one: add `name: ...`")
        elif connection.name in names:
            document.problem(
                (*path, number, "name"), f"{connection.name} is the name of two connections", "choose another one"
            )
        else:
            names[connection.name] = number
        place = _place(connection)
        if place in places:
            document.problem(
                (*path, number, "url"),
                f"leads where connection {places[place] + 1} of the list leads, too",
                "what goes over both would come twice: remove one of them",
            )
        places.setdefault(place, number)


def _differs(one: PubSubConfig, other: PubSubConfig, key: str) -> bool:
    return bool(getattr(one, key) != getattr(other, key))


def _place(connection: PubSubConfig) -> object:
    """Where messages go: connections with the same place are one."""
    shared = connection.url, connection.encoding
    return (*shared, connection.broker.prefix) if connection.is_brokered else (*shared, connection.interface)


def check_connections(parts: Parts, server: ServerConfig, relays: dict[str, RelayConfig]) -> None:
    """Note the problems of who is on which connection, of those `relays` that are valid by themselves."""
    _check_number_of_requestors(parts)
    names = [connection.name for _, connection in parts.connections]
    known = [name for name in names if name is not None]
    is_list = isinstance(parts.document.data.get("pubsub"), list)
    if is_list and len(known) != len(parts.document.data["pubsub"]):
        return  # which there are is not known
    served = set(_named(parts, ("server", "connections"), server.connections, known, is_list=is_list) or known)
    on: dict[int, set[str]] = {}
    for name, bridge in parts.bridges.items():
        path: KeyPath = ("bridges", name, "connections")
        on[bridge.space] = set(_named(parts, path, bridge.connections, known, is_list=is_list) or known[:1])
        if is_list and known and relayed_to(relays, bridge.space, name, on[bridge.space]).isdisjoint(served):
            where = path if bridge.connections else ("bridges", name)
            parts.document.problem(
                where,
                f"the server is on {listed(sorted(served))} alone, so that it never hears this bridge",
                "name a connection that both are on",
            )
        elif is_list and known and on[bridge.space].isdisjoint(served):
            _check_commands(parts, name)
    for name, bridge in parts.bridges.items() if is_list else ():
        for position, space in enumerate(bridge.requestors):
            if space in on and on[space].isdisjoint(on[bridge.space]):
                parts.document.problem(
                    ("bridges", name, "requestors", position),
                    f"the bridge of space {space} is on no connection of this one, so that it cannot command it",
                    "name a connection that both are on",
                )


def _check_number_of_requestors(parts: Parts) -> None:
    if not any(pubsub.is_secured for _, pubsub in parts.connections):
        return  # nothing tells a replayed message there
    for name, bridge in parts.bridges.items():
        if (number := len(bridge.requestors)) > MOST_REQUESTORS:
            text = f"{number} spaces may command it; commands of {MOST_REQUESTORS} are told from replayed ones"
            remedy = "name fewer, or distribute its robots over several bridges"
            parts.document.problem(("bridges", name, "requestors"), text, remedy)


def _check_commands(parts: Parts, bridge_name: str) -> None:
    """Note what cannot be done of the robots of a bridge that the server hears by a relay alone."""
    for name, robot in parts.robots.items():
        if robot.bridge != bridge_name:
            continue
        for key in ("skills", "teleoperation"):
            if getattr(robot, key):
                parts.document.problem(
                    ("robots", name, key),
                    f"the server hears bridge {bridge_name} by a relay alone, which forwards no commands",
                    "name a connection that both are on",
                )


def _named(parts: Parts, path: KeyPath, given: tuple[str, ...], known: list[str], *, is_list: bool) -> list[str]:
    """Those of the names that are names of connections; the others are noted."""
    found: list[str] = []
    for position, name in enumerate(given):
        where = (*path, position)
        if not is_list and name not in known:
            parts.document.problem(where, "`pubsub` is no list of connections", "remove it, or make `pubsub` a list")
        elif name not in known:
            there = f"there are: {listed(known)}" if known else ""
            parts.document.problem(where, f"there is no connection `{name}`", closest(name, known) or there)
        elif name in found:
            parts.document.problem(where, f"`{name}` is named twice", "remove one of them")
        else:
            found.append(name)
    return found
