"""How a connection speaks JSON."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from ua_fleet.topics import Topic
from ua_fleet.wire.json import Form
from ua_fleet.wire.messages import DataSetMetaData

__all__ = ["JsonSettings"]


@dataclass(frozen=True, slots=True, kw_only=True)
class JsonSettings:
    """How a connection speaks JSON."""

    form: Form = Form.VERBOSE
    """How fields of data are written."""
    has_actions: bool = False
    """Whether Actions are sent and taken."""
    described: Collection[Topic] = frozenset()
    """Sources whose fields are known here, as those of `fleet.yaml`: without metadata none is shown as a text."""
    stated: Mapping[tuple[str, int], DataSetMetaData] = field(default_factory=dict[tuple[str, int], DataSetMetaData])
    """Metadata of DataSetWriters that announce none, by PublisherId and DataSetWriterId."""
