"""What is wrong between the relays of a `fleet.yaml` and its connections, bridges and other relays.

Of each origin, or part of one, there is one way to each connection: its process is there, or one relay brings it. So a
receiver knows by which keys to open what comes in its name, and nothing goes round: followed back, each way leads from
relay to relay to where the origin itself is.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from ua_fleet.config.parts import Parts
from ua_fleet.config.pubsub_schema import PubSubConfig
from ua_fleet.config.relay_schema import RelayConfig, RelayedConfig
from ua_fleet.config.relays import SOURCE_PREFIX, origins_of
from ua_fleet.config.schema import ServerConfig
from ua_fleet.config.source_schema import PublishedSourceConfig
from ua_fleet.document import KeyPath
from ua_fleet.errors import TopicInvalid
from ua_fleet.names import closest, listed
from ua_fleet.topics import SERVER_SPACE, check_space

__all__ = ["check_relays", "relayed_to"]

MOST_NAME: Final = 61
"""Characters of a relay's name: with `r-` before it, it is the name of a SecurityGroup and of a key file."""


class _Leg(NamedTuple):
    """One direction of a relay, with where it stands in the file."""

    relay: str
    path: KeyPath
    source: str
    target: str
    spaces: dict[int, int]
    """The spaces of its origins, each with the place in the list of the first that is of it."""
    wholes: tuple[int, ...]
    """Places of the origins that are whole spaces."""


def check_relays(
    parts: Parts,
    relays: dict[str, RelayConfig],
    server: ServerConfig,
    sources: Mapping[str, PublishedSourceConfig],
) -> None:
    """Note the problems of relays."""
    connections = {each.name: each for _, each in parts.connections if each.name is not None}
    if not isinstance(parts.document.data.get("pubsub"), list):
        for name in relays:
            parts.document.problem(
                ("relays", name), "`pubsub` is no list of connections, so that there is nothing between", "remove it"
            )
        return
    if len(connections) != len(parts.document.data["pubsub"]):
        return  # which there are is not known
    where = _places(parts, server, list(connections))
    legs: list[_Leg] = []
    for name, relay in relays.items():
        _check_name(parts, name)
        for number, forward in enumerate(relay.forwards):
            leg = _leg(parts, name, ("relays", name, "forwards", number), forward, connections, sources)
            if leg is not None:
                legs.append(leg)
    for leg in legs:
        _check_json(parts, leg, connections)
        for space, position in leg.spaces.items():
            _check_way(parts, leg, space, (*leg.path, "origins", position), where, legs, connections)


def relayed_to(relays: dict[str, RelayConfig], space: int, name: str, on: set[str]) -> set[str]:
    """The connections to which relays bring something of the bridge of a space, from those that it is on."""
    reached = set(on)
    is_of = {name, str(space)}
    while True:
        more = {
            each.target
            for relay in relays.values()
            for each in relay.forwards
            if each.source in reached
            and any(str(one) in is_of or str(one).startswith(f"{SOURCE_PREFIX}{space}_") for one in each.origins)
        }
        if more <= reached:
            return reached
        reached |= more


def _check_name(parts: Parts, name: str) -> None:
    if name in parts.bridges:
        parts.document.problem(
            ("relays", name),
            f"`{name}` is the name of a bridge, too, and the key service knows both by their names",
            "choose another one",
        )
    if len(name) > MOST_NAME:
        parts.document.problem(("relays", name), f"the name of a relay has at most {MOST_NAME} characters", "cut it")


def _leg(
    parts: Parts,
    relay: str,
    path: KeyPath,
    forward: RelayedConfig,
    connections: dict[str, PubSubConfig],
    sources: Mapping[str, PublishedSourceConfig],
) -> _Leg | None:
    """One direction whose names are all known; what is not is noted."""
    before = len(parts.document.problems)
    for side, name in (("source", forward.source), ("target", forward.target)):
        if name not in connections:
            hint = closest(name, connections) or f"there are: {listed(sorted(connections))}"
            parts.document.problem((*path, side), f"there is no connection `{name}`", hint)
    if forward.source == forward.target:
        parts.document.problem((*path, "target"), "leads back to where it comes from", "name another connection")
    spaces: dict[int, int] = {}
    wholes: list[int] = []
    for position, origin in enumerate(forward.origins):
        try:
            [space] = origins_of([origin], parts.bridges).publishers
            if isinstance(origin, int):
                check_space(space)
        except KeyError:
            _tell_unknown(parts, sources, (*path, "origins", position), str(origin), forward.source)
        except TopicInvalid as error:
            parts.document.problem(
                (*path, "origins", position), f"`{origin}` is no origin: {error.reason}", "see docs/topics.md"
            )
        else:
            spaces.setdefault(space, position)
            if isinstance(origin, int) or origin in parts.bridges:
                wholes.append(position)
    if len(parts.document.problems) > before:
        return None
    return _Leg(relay, path, forward.source, forward.target, spaces, tuple(wholes))


def _tell_unknown(
    parts: Parts, sources: Mapping[str, PublishedSourceConfig], path: KeyPath, origin: str, connection: str
) -> None:
    """Note what is wrong with an origin that is no bridge's name."""
    for name, bridge in parts.bridges.items():
        if bridge.publisher_id == origin:
            parts.document.problem(
                path, f"`{origin}` is a PublisherId, and bridges are listed by their names", f"write `{name}`"
            )
            return
    for name, source in sources.items():
        number = source.publisher_id
        if origin in (name, number) and isinstance(number, str):
            parts.document.problem(
                path,
                f"the PublisherId of `sources.{name}` is a text, and a relay knows publishers by their numbers",
                f"give that publisher a number, or put the server on {connection} too",
            )
            return
        if origin == name:
            parts.document.problem(
                path, f"`{origin}` is in `sources`, and publishers are listed by their numbers", f"write {number}"
            )
            return
    there = listed(sorted(parts.bridges)) if parts.bridges else "none"
    hint = closest(origin, parts.bridges) or f"bridges there: {there}"
    parts.document.problem(path, f"there is no bridge `{origin}`", hint)


def _places(parts: Parts, server: ServerConfig, names: list[str]) -> dict[int, set[str]]:
    """The connections that the process of each space is on."""
    where = {bridge.space: set(bridge.connections) or set(names[:1]) for bridge in parts.bridges.values()}
    where[SERVER_SPACE] = set(server.connections) or set(names)
    return where


def _check_json(parts: Parts, leg: _Leg, connections: dict[str, PubSubConfig]) -> None:
    if not connections[leg.source].is_json or connections[leg.target].is_json:
        return
    for position in leg.wholes:
        parts.document.problem(
            (*leg.path, "origins", position),
            f"{leg.source} is JSON, which is not signed, so only single sources can be relayed from there to UADP",
            "name them, each like `ua_1_2_1005`",
        )


def _check_way(
    parts: Parts,
    leg: _Leg,
    space: int,
    path: KeyPath,
    where: dict[int, set[str]],
    legs: list[_Leg],
    connections: dict[str, PubSubConfig],
) -> None:
    """Whether there is one way of a space to the target, and one that begins where its process is."""
    who = "the server" if space == SERVER_SPACE else f"the bridge of space {space}"
    on = where.get(space)
    if on is not None and leg.target in on:
        parts.document.problem(
            path, f"{who} is on {leg.target} itself, where no relay speaks for it", "remove it from this list"
        )
        return
    others = [each for each in legs if each is not leg and each.target == leg.target and space in each.spaces]
    if others:
        parts.document.problem(
            path,
            f"relay {others[0].relay} brings space {space} from {others[0].source} to {leg.target}, too",
            "leave it to one of them, in one list",
        )
        return
    at, passed = leg, {leg.target}
    while on is None or at.source not in on:
        if at.source in passed:
            parts.document.problem(path, f"space {space} would go round by {listed(sorted(passed))}", "cut it once")
            return
        passed.add(at.source)
        before = [each for each in legs if each.target == at.source and space in each.spaces]
        if not before:
            break
        at = before[0]
    if on is not None and at.source not in on:
        parts.document.problem(
            path,
            f"{who} is not on {at.source}, and no relay brings it there",
            f"take it from {listed(sorted(on))}, or put that process on {at.source}",
        )
    elif on is None and _lacks_keys(connections, at):
        parts.document.problem(
            path,
            f"space {space} is no bridge's, so that the key service has no keys of what it says on {at.source}",
            "add its bridge, or take keys from files (`pubsub.keys.source: files`)",
        )


def _lacks_keys(connections: dict[str, PubSubConfig], leg: _Leg) -> bool:
    source = connections[leg.source]
    return source.is_secured and source.keys.source == "service"
