"""The section `pubsub` of `fleet.yaml`."""

from __future__ import annotations

from enum import StrEnum
from ipaddress import ip_network
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from ua_fleet.config.base import Model, Name
from ua_fleet.config.broker_schema import BrokerConfig
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.transport.mqtt.address import is_broker_url
from ua_fleet.wire.json import Form

__all__ = ["Encoding", "JsonForm", "KeysConfig", "PubSubConfig", "PubSubSecurity"]


class PubSubSecurity(StrEnum):
    """Message security of PubSub (MessageSecurityMode, OPC 10000-14 6.2.5.2). `none` has to be written."""

    NONE = "none"
    SIGN = "sign"
    SIGN_AND_ENCRYPT = "sign_and_encrypt"
    BROKER = "broker"
    """JSON is not signed: what protects it are TLS and the rights that the broker gives."""


class Encoding(StrEnum):
    """MessageMapping (OPC 10000-14 7.2.4 and 7.2.5)."""

    UADP = "uadp"
    JSON = "json"


class JsonForm(StrEnum):
    """How a field is written (OPC 10000-6 5.4.1)."""

    COMPACT = "compact"
    VERBOSE = "verbose"
    RAW = "raw"

    @property
    def form(self) -> Form:
        """The same for the codec."""
        return {JsonForm.COMPACT: Form.COMPACT, JsonForm.VERBOSE: Form.VERBOSE}.get(self, Form.RAW_DATA)


class KeysConfig(Model, frozen=True):
    """Where the keys of PubSub come from, and how long they live (OPC 10000-14 6.2.12 and 8.3)."""

    source: Literal["service", "files", "pushed"] = "service"
    """`service`: bridges pull keys from the OPC UA server, which makes them. `pushed`: the same, but a key service of
    others makes them and pushes them to the server. `files`: every process reads the same key files."""
    pushed_by: str | None = None
    """Name of the user who may push keys to the server; needed for `source: pushed`, and only there."""
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

    @property
    def from_server(self) -> bool:
        """Whether bridges pull keys from the server."""
        return self.source != "files"


class PubSubConfig(Model, frozen=True):
    """OPC UA PubSub between the server and the bridges: one connection, or each of a list of them."""

    name: Name | None = None
    """Name of the connection, needed where `pubsub` is a list of them."""
    security: PubSubSecurity = Field(examples=["sign_and_encrypt"])
    """`sign_and_encrypt`, or `sign` where all may read. `none` sends and accepts unsigned messages. `broker` has to be
    written for `encoding: json`: TLS and the broker's rights are its only protection. There is no default."""
    url: Annotated[str, Field(pattern=r"^(opc\.udp://[^/]+:\d{1,5}|mqtts?://[^/]+)$")] = "opc.udp://224.0.2.14:4840"
    """Multicast group (or a unicast address) and port (OPC 10000-14 7.3.2), where an IPv6 address stands in brackets,
    as in `opc.udp://[ff15::ea7]:4840`; or an MQTT broker: `mqtt://<host>:<port>`, `mqtts://` for TLS."""
    broker: BrokerConfig = BrokerConfig()
    """How the MQTT broker is used, where `url` names one."""
    encoding: Encoding = Encoding.UADP
    """`uadp`: bytes, signed and encrypted with the fleet's keys. `json`: text, over a broker only (docs/json.md)."""
    json_form: JsonForm = JsonForm.VERBOSE
    """How fields are written with `encoding: json`: `verbose`, `compact` with the type beside each value, `raw` without
    one. Every form is read."""
    actions: bool = False
    """Whether skills are asked for and done over a connection with `encoding: json`. Nothing of it is signed: whoever
    the broker lets write to `<prefix>/json/action-request/...` commands robots. Without meaning for `uadp`."""
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

    @property
    def is_brokered(self) -> bool:
        """Whether messages go over a broker."""
        return is_broker_url(self.url)

    @property
    def is_json(self) -> bool:
        """Whether messages are text."""
        return self.encoding is Encoding.JSON

    @property
    def is_secured(self) -> bool:
        """Whether messages are signed, so that a process needs keys."""
        return self.security in (PubSubSecurity.SIGN, PubSubSecurity.SIGN_AND_ENCRYPT)

    def timing(self) -> PubSubTiming:
        """The periods of writers and readers."""
        return PubSubTiming(self.keep_alive_s, self.receive_timeout_s, self.repeat_interval_s)
