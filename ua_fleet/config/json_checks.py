"""What of a `fleet.yaml` does not go with PubSub as JSON."""

from __future__ import annotations

from ua_fleet.config.parts import Parts
from ua_fleet.config.pubsub_schema import PubSubConfig, PubSubSecurity
from ua_fleet.config.schema import BridgeConfig
from ua_fleet.document import KeyPath

__all__ = ["check_json"]


def check_json(parts: Parts) -> None:
    """Note where JSON is wanted on a road that does not carry it, or for what it must not carry."""
    for path, pubsub in parts.connections:
        if pubsub.is_json:
            _check_road(parts, path, pubsub)
        elif pubsub.security is PubSubSecurity.BROKER:
            parts.document.problem(
                (*path, "security"),
                "`broker` is for `encoding: json`, and UADP has keys of its own",
                "write `sign_and_encrypt`, or add `encoding: json`",
            )
    for name, bridge in parts.bridges.items():
        if bridge.wire_id is not None and any(each.is_json for each in _connections(parts, bridge)):
            parts.document.problem(
                ("bridges", name, "publisher_id"),
                "over JSON the PublisherId of a bridge is its space, by which its topics are named",
                "remove it, or write `pubsub.encoding: uadp`",
            )
    for name, robot in parts.robots.items():
        if robot.teleoperation is None:
            continue
        on = _connections(parts, parts.bridges.get(robot.bridge))
        if on and all(each.is_json for each in on):
            parts.document.problem(
                ("robots", name, "teleoperation"),
                "setpoints never go over JSON: nothing would prove who has sent them",
                "remove it, or write `pubsub.encoding: uadp`",
            )
        elif any(each.is_json and each.actions for each in on):
            parts.document.problem(
                ("robots", name, "teleoperation"),
                "the robot could be taken over JSON, and nothing would prove who does",
                "remove it, or write `actions: false` where its bridge has `encoding: json`",
            )


def _connections(parts: Parts, bridge: BridgeConfig | None) -> list[PubSubConfig]:
    """The connections that a bridge is on."""
    if bridge is None:
        return []
    names = bridge.connections
    on = [each for _, each in parts.connections if each.name in names]
    return on or [each for _, each in parts.connections[:1]]


def _check_road(parts: Parts, path: KeyPath, pubsub: PubSubConfig) -> None:
    if not pubsub.is_brokered:
        parts.document.problem(
            (*path, "encoding"),
            "JSON goes over an MQTT broker, which keeps the metadata that it needs, and not over UDP",
            "write `url: mqtts://<host>:<port>`, or `encoding: uadp`",
        )
    if pubsub.security is not PubSubSecurity.BROKER:
        parts.document.problem(
            (*path, "security"),
            f"JSON is neither signed nor encrypted by us, and this says `{pubsub.security.value}`",
            "write `broker`: TLS and the rights at the broker are its protection; or `encoding: uadp`",
        )
