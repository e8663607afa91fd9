"""What of a demonstration's `fleet.yaml` depends on where its processes run: side by side, or each in a container."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from ua_fleet.errors import ConfigError

__all__ = ["Layout", "check_same_fleet"]

_ALL_CLIENTS: Final = """\
# Any client certificate is accepted, so that UaExpert connects at once; users and passwords are still asked for.
  trust_all_clients: true"""
_KNOWN_CLIENTS: Final = """\
# A client is let in once its certificate is known: ua-fleet cert trust --last --show.
  trust_all_clients: false"""
_UNSECURED: Final = "# Unsigned messages, on loopback only.\n  security: none"
_SECURED: Final = """\
# The server makes the keys; the bridges fetch them with their certificates, and they change while all runs.
  security: sign_and_encrypt
  keys: """


@dataclass(frozen=True, slots=True)
class Layout:
    """Words for the template of a `fleet.yaml`. Folders are relative to it."""

    written_by: str
    """Command that writes it, without `ua-fleet`."""
    server_port: int
    pubsub_url: str
    keys: str | None
    """What stands in `pubsub.keys`, as YAML in one line; None: messages are not secured."""
    master_uri: str
    """Of the ROS master."""
    ros1_host_ip: str = "127.0.0.1"
    """Address by which other ROS 1 nodes reach the ROS 1 bridge."""
    ros2_discovery: str = "localhost"
    """How far ROS 2 bridges look for other nodes."""
    trusts_all_clients: bool = True
    server_host: str = "127.0.0.1"
    server_state: str = "state"
    bridges_state: str = "state/bridges"
    modbus_state: str = "state/modbus"
    interface: str = "lo"
    broker_nodes: tuple[str, ...] = ()
    """Further nodes of the MQTT broker at `pubsub_url`, a cluster."""
    monitoring_port: int = 0
    modbus_host: str = "127.0.0.1"
    modbus_writers: str = "127.0.0.1"

    def words(self) -> dict[str, object]:
        """By their names in the templates."""
        nodes = [f"broker: {{nodes: [{', '.join(self.broker_nodes)}]}}"] if self.broker_nodes else []
        return {
            **asdict(self),
            "pubsub_url": "\n  ".join([self.pubsub_url, *nodes]),
            "trusted_clients": _ALL_CLIENTS if self.trusts_all_clients else _KNOWN_CLIENTS,
            "pubsub_security": _UNSECURED if self.keys is None else _SECURED + self.keys,
        }


def check_same_fleet(path: Path, text: str, remedy: str) -> None:
    """Raise ConfigError where the `fleet.yaml` at `path` is another one than an earlier `text`.

    The first line is always the same, whatever was chosen for the rest.
    """
    if path.exists() and path.read_text(encoding="utf-8").partition("\n")[0] != text.partition("\n")[0]:
        raise ConfigError("this is another fleet's", file=str(path), suggestion=remedy)
