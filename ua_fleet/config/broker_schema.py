"""The section `pubsub.broker` of `fleet.yaml`: how an MQTT broker is used; and what other sections have of it."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING

from pydantic import Field, field_validator, model_validator

from ua_fleet.config.base import Model
from ua_fleet.errors import TransportError
from ua_fleet.transport.mqtt.address import parse_broker_url
from ua_fleet.transport.mqtt.topics import TopicTree

if TYPE_CHECKING:
    from ua_fleet.pubsub.publisher_ids import PublisherIds

__all__ = ["BrokerConfig", "BrokerLogin", "Delivery"]


class Delivery(StrEnum):
    """RequestedDeliveryGuarantee of data (OPC 10000-14 6.4.2.2)."""

    BEST_EFFORT = "best_effort"
    AT_MOST_ONCE = "at_most_once"
    AT_LEAST_ONCE = "at_least_once"
    EXACTLY_ONCE = "exactly_once"

    @property
    def qos(self) -> int:
        """The MQTT quality of service (OPC 10000-14 7.3.4.5)."""
        return {Delivery.AT_LEAST_ONCE: 1, Delivery.EXACTLY_ONCE: 2}.get(self, 0)


class BrokerLogin(Model, frozen=True):
    """How a process reaches an MQTT broker and logs in there."""

    nodes: tuple[str, ...] = Field(
        default=(), max_length=32, examples=[["mqtt://broker-b:1883", "mqtt://broker-c:1883"]]
    )
    """Further nodes of the same broker, a cluster: the next one is tried when one cannot be reached, or is lost."""
    user: str | None = Field(default=None, min_length=1, max_length=1024)
    """User at the broker; each process may have its own by `${NAME}`."""
    password_file: str | None = None
    """File whose first line is the password; relative to `fleet.yaml`. Only its owner may read it."""
    ca_file: str | None = None
    """Certificates (PEM) of the authorities that sign the broker's certificate; otherwise those of the system."""
    certificate_file: str | None = None
    """Certificate (PEM) by which this process logs in to the broker."""
    key_file: str | None = None
    """Its private key (PEM)."""

    @model_validator(mode="after")
    def _check(self) -> BrokerLogin:
        if (self.certificate_file is None) != (self.key_file is None):
            raise ValueError("certificate_file and key_file belong together: write both, or neither")
        if self.password_file is not None and self.user is None:
            raise ValueError("password_file is of a user: write `user` too, or remove it")
        return self

    @field_validator("nodes")
    @classmethod
    def _are_brokers(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        try:
            for url in value:
                parse_broker_url(url)
        except TransportError as error:
            raise ValueError(str(error)) from None
        return value

    @field_validator("user")
    @classmethod
    def _has_no_line_break(cls, value: str | None) -> str | None:
        if value is not None and not value.isprintable():
            raise ValueError("a user has no control characters")
        return value


class BrokerConfig(BrokerLogin, frozen=True):
    """How the MQTT broker of `pubsub.url` is used. Without meaning over UDP."""

    prefix: str = Field(default="opcua", examples=["opcua"])
    """The first level of the standard topics `<prefix>/<uadp|json>/<type>/...` (OPC 10000-14 7.3.4.7)."""
    queue: str = Field(default="{topic}", examples=["hall2/{topic}"])
    """QueueName: the topic of each source's data. `{topic}` is `ua_<space>_<ns>_<id>`, and `{space}`, `{ns}` and `{id}`
    are its numbers."""
    delivery: Delivery = Delivery.AT_LEAST_ONCE
    """RequestedDeliveryGuarantee of data: QoS 0, 0, 1 or 2. Announcements and Actions always have QoS 1."""
    keep_alive_s: int = Field(default=5, ge=1, le=600)
    """Period in which the connection is looked at. A broker notices a lost process within 1.5 of it."""
    answer_timeout_s: float | None = Field(default=None, gt=0, le=600)
    """So long the broker may take for an answer, then the connection is made anew. Without it 5, and 20 with `nodes`,
    since a cluster of which a node has died answers nothing for some seconds."""
    most_waiting_s: float | None = Field(default=None, ge=0, le=3600)
    """So long values wait in their order while the broker is away or slow, beyond that only the newest of each source.
    Without it 2, and 30 with `nodes`."""
    most_waiting_bytes: int = Field(default=64 * 1024 * 1024, ge=65_536)
    """Values that wait at most while the broker is away or slow; then an older one goes for a newer one."""

    @model_validator(mode="after")
    def _check_topics(self) -> BrokerConfig:
        try:
            self.tree()
        except TransportError as error:
            raise ValueError(str(error)) from None
        return self

    def tree(
        self, *, is_json: bool = False, has_actions: bool = True, publisher_ids: PublisherIds | None = None
    ) -> TopicTree:
        """The topics of the fleet, for UADP or for JSON; `publisher_ids` are those of spaces with another one."""
        return TopicTree(self.prefix, self.queue, is_json=is_json, has_actions=has_actions, publisher_ids=publisher_ids)
