"""The section `pubsub` of `fleet.yaml`."""

from __future__ import annotations

from enum import StrEnum
from ipaddress import ip_network
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from ua_fleet.config.base import Model
from ua_fleet.pubsub.timing import PubSubTiming

__all__ = ["KeysConfig", "PubSubConfig", "PubSubSecurity"]


class PubSubSecurity(StrEnum):
    """Message security of PubSub (MessageSecurityMode, OPC 10000-14 6.2.5.2). `none` has to be written."""

    NONE = "none"
    SIGN = "sign"
    SIGN_AND_ENCRYPT = "sign_and_encrypt"


class KeysConfig(Model, frozen=True):
    """Where the keys of PubSub come from, and how long they live (OPC 10000-14 6.2.12 and 8.3)."""

    source: Literal["service", "files"] = "service"
    """`service`: bridges pull keys from the OPC UA server. `files`: every process reads the same key files."""
    folder: str = "keys"
    """Folder of the key files of `source: files`; relative to `fleet.yaml`. Only its owner may read it."""
    policy: Literal["PubSub-Aes256-CTR", "PubSub-Aes128-CTR"] = "PubSub-Aes256-CTR"
    """SecurityPolicy of all SecurityGroups (OPC 10000-7)."""
    lifetime_s: float = Field(default=3600.0, gt=0)
    """KeyLifetime: the key service changes keys with this period. Key files change by `ua-fleet keys rotate`."""
    past_keys: int = Field(default=1, ge=0, le=16)
    """MaxPastKeyCount: keys that were replaced and that readers still take for one more lifetime."""
    future_keys: int = Field(default=4, ge=1, le=64)
    """MaxFutureKeyCount: keys handed out ahead; so many lifetimes the bridges go on without the service."""
    endpoint: Annotated[str, Field(pattern=r"^opc\.tcp://[^/]+")] | None = None
    """URL by which bridges reach the key service, where `server.host` and `server.port` do not say it."""


class PubSubConfig(Model, frozen=True):
    """OPC UA PubSub between the server and the bridges."""

    security: PubSubSecurity = Field(examples=["sign_and_encrypt"])
    """`sign_and_encrypt`, or `sign` where all may read. `none` sends and accepts unsigned messages. There is no
    default."""
    url: Annotated[str, Field(pattern=r"^opc\.udp://[^/]+:\d{1,5}$")] = "opc.udp://224.0.2.14:4840"
    """Multicast group (or a unicast address) and port (OPC 10000-14 7.3.2); an IPv6 address stands in brackets, as in
    `opc.udp://[ff15::ea7]:4840`."""
    interface: str = "lo"
    """Name or address of the network interface, or a subnet in which its address is (`192.168.1.0/24`), for machines
    that get their address from others; `lo` keeps all traffic on this machine."""
    ttl: int = Field(default=1, ge=0, le=255)
    """Router hops that a multicast datagram may make."""
    receive_buffer_bytes: int = Field(default=4 * 1024 * 1024, ge=65_536)
    """Wanted size of the socket's receive buffer; the kernel may give less, the log says what it gave."""
    keep_alive_s: float = Field(default=1.0, gt=0)
    """Period of keep-alive messages while a source lives but says nothing (KeepAliveTime)."""
    receive_timeout_s: float = Field(default=3.0, gt=0)
    """A source silent for so long is shown as Bad_NoCommunication (MessageReceiveTimeout)."""
    repeat_interval_s: float = Field(default=5.0, gt=0)
    """The last message of each source is sent again with this period, with its Timestamp unchanged."""
    inlet_size: int = Field(default=10_000, ge=1)
    """Messages that may wait inside a bridge between its robot side and its PubSub side; then the oldest is dropped."""
    max_wait_s: float = Field(default=2.0, gt=0)
    """What has waited so long, or its `max_age_s`, in a bridge is dropped where a newer message of its source waits."""
    keys: KeysConfig = KeysConfig()
    """Keys of message security; without meaning where `security` is `none`."""
    relaxed_replay: tuple[Annotated[int, Field(ge=0, le=65535)], ...] = ()
    """Spaces (PublisherIds) whose data, but no command, is taken without a replay check. open62541 1.5 needs it; said
    at start."""
    max_datagram_bytes: int = Field(default=65_507, ge=576, le=65_507)
    """Larger NetworkMessages are sent as chunks of at most this size (OPC 10000-14 7.2.4.4.4)."""
    max_message_bytes: int = Field(default=4 * 1024 * 1024, ge=65_536)
    """Largest message that is put together from chunks; also what all unfinished messages of one sender may hold."""

    @field_validator("interface")
    @classmethod
    def _interface_is_no_broken_subnet(cls, value: str) -> str:
        if "/" in value:
            try:
                ip_network(value)
            except ValueError as error:
                raise ValueError(f"{value!r} is no subnet such as 192.168.1.0/24: {error}") from None
        return value

    @model_validator(mode="after")
    def _check(self) -> PubSubConfig:
        if self.receive_timeout_s <= self.keep_alive_s:
            raise ValueError("receive_timeout_s must be greater than keep_alive_s")
        return self

    def timing(self) -> PubSubTiming:
        """The periods of writers and readers."""
        return PubSubTiming(self.keep_alive_s, self.receive_timeout_s, self.repeat_interval_s)
