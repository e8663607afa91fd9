# pyright: basic, reportMissingImports=false
"""How the bridge publishes in ROS 1: a rospy publisher for each DataSet."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import rospy

from ua_bridges.ros.errors import ConversionError
from ua_bridges.ros.feed import Mapped
from ua_bridges.ros.form import Form, with_stamp
from ua_bridges.ros.outlets import Publishing
from ua_bridges.ros.schema import ros1_type_name
from ua_bridges.ros1.classes import MessageType, installed_type, needed_type, type_from_definition
from ua_bridges.ros1.outlet import QUEUE_SIZE, Outlet
from ua_fleet.errors import ConfigError

__all__ = ["Ros1Publishing"]


class Ros1Publishing(Publishing[Outlet]):
    """See Publishing. The watch registers what is new."""

    failures = (ConversionError, rospy.ROSException, rospy.ROSSerializationException)

    def __init__(self, changed: Callable[[Outlet | None], None]) -> None:
        """`changed` is told that there is another outlet than before, with the one that it replaces."""
        self._changed = changed
        self._shared: dict[str, tuple[MessageType, Any]] = {}
        """The message that the sinks of one topic share."""

    def mirror(self, name: str, form: Form, *, latched: bool, are_events: bool) -> tuple[Outlet, Form]:
        """See Publishing. Each subscriber has a queue, as long for values as for events."""
        type_name = ros1_type_name(form.ros_type)
        if installed_type(type_name) is None and form.definition is not None:
            kind = type_from_definition(type_name, form.definition)
        else:
            kind = needed_type(type_name)
            form = with_stamp(form, kind.schema)
        shared = None if form.is_whole else kind.cls()
        return Outlet(name, kind, form.names, latched=latched, shared=shared), form

    def sink(self, data: Mapped, *, takes_setpoints: bool) -> Outlet:
        """See Publishing."""
        mapping = data.side
        name, kind = mapping.own_topic, needed_type(ros1_type_name(mapping.message_type))
        shared_kind, shared = self._shared.setdefault(name, (kind, kind.cls()))
        if shared_kind.name != kind.name:
            raise ConfigError(f"another sink has the type {shared_kind.name} for this topic, not {kind.name}")
        paths = [field.path or field_name or "data" for field_name, field in data.config.all_fields().items()]
        queue_size = 1 if takes_setpoints else QUEUE_SIZE
        return Outlet(name, kind, paths, latched=mapping.latched, shared=shared, queue_size=queue_size)

    def retire(self, outlet: Outlet) -> int:
        """See Publishing."""
        return outlet.close()

    def changed(self, made: Outlet | None, replaced: Outlet | None) -> None:
        """See Publishing."""
        self._changed(replaced)
