"""The section `unified_namespace` of `fleet.yaml`: the values of robots as plain JSON on an MQTT broker."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from ua_fleet.config.base import Model
from ua_fleet.config.broker_schema import BrokerLogin
from ua_fleet.uns.payloads import Payload
from ua_fleet.uns.topics import DEFAULT_TEMPLATE, template_problem

__all__ = ["UnifiedNamespaceConfig"]


class UnifiedNamespaceConfig(Model, frozen=True):
    """The server publishes the values of all robots for programs that know only MQTT; it takes nothing from there."""

    url: Annotated[str, Field(pattern=r"^mqtts?://[^/]+$", examples=["mqtts://broker.hall2:8883"])]
    """The broker: `mqtt://<host>:<port>`, `mqtts://` for TLS. It may be that of `pubsub`."""
    site: str | None = Field(default=None, min_length=1, examples=["plant"])
    """What `{site}` stands for, one level or several: `acme/lyon`."""
    topic: str = DEFAULT_TEMPLATE
    """Template of the topics. Placeholders are whole levels: `{site}`, `{fleet}` (`fleet.name`), `{robot}` and `{data}`
    (`speed`, or `pose.x` where there are several fields)."""
    payload: Payload = Payload.OBJECT
    """`object`: `{"value": 21.5, "time": "2024-01-17T21:20:00Z", "quality": "Good"}`, with a null value while Bad.
    `value`: the bare value, and null while not Good."""
    rate_hz: float = Field(default=1.0, gt=0, le=1000)
    """A number is published at most so often; the last one always is. Texts, Booleans and changes of quality are not
    held back."""
    expiry_s: float = Field(default=180.0, ge=15, le=1e6)
    """The broker forgets what the server does not say again: each topic is published anew after a third of this. Over
    MQTT 3.1.1 nothing is forgotten."""
    max_payload_bytes: int = Field(default=65_536, ge=256, le=4 * 1024 * 1024)
    """A larger value, such as an image, is published as null."""
    broker: BrokerLogin = BrokerLogin()
    """How the server logs in to the broker."""

    @model_validator(mode="after")
    def _check(self) -> UnifiedNamespaceConfig:
        if problem := template_problem(self.topic, self.site):
            raise ValueError(f"topic {self.topic!r}: {problem}")
        return self
