"""What is wrong between the URL of a broker and how it is used."""

from __future__ import annotations

from ua_fleet.config.broker_schema import BrokerLogin
from ua_fleet.document import Document, KeyPath, key_text
from ua_fleet.errors import TransportError
from ua_fleet.transport.mqtt.address import parse_broker_url

__all__ = ["check_broker"]


def check_broker(document: Document, path: KeyPath, url: str, broker: BrokerLogin) -> None:
    """Note what of a section's `broker` does not go with its `url`."""
    try:
        address = parse_broker_url(url)
    except TransportError as error:
        document.problem((*path, "url"), str(error))
        return
    for position, node in enumerate(broker.nodes):
        if parse_broker_url(node).has_tls != address.has_tls:
            document.problem(
                (*path, "broker", "nodes", position),
                "one node is reached by TLS, and another one is not",
                f"write {'mqtts' if address.has_tls else 'mqtt'}:// as in `{key_text((*path, 'url'))}`",
            )
    for key in ("ca_file", "certificate_file", "key_file") if not address.has_tls else ():
        if getattr(broker, key) is not None:
            document.problem(
                (*path, "broker", key), "this is for TLS, and the URL begins with mqtt://", "write mqtts:// there"
            )
