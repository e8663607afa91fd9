# pyright: basic, reportMissingImports=false
"""How the bridge publishes in ROS 2: a publisher for each topic, made and ended in the node's thread."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

from ua_bridges.ros.codec import compile_encoder
from ua_bridges.ros.convert import compile_writer
from ua_bridges.ros.errors import SchemaInvalid
from ua_bridges.ros.feed import Mapped
from ua_bridges.ros.form import Form, with_stamp
from ua_bridges.ros.outlets import Gone, Publishing, Values
from ua_bridges.ros.sink import compile_sink
from ua_bridges.ros2.classes import load_type, make
from ua_bridges.ros2.outlet import HeldPublisher, Make
from ua_bridges.ros2.qos import EVENTS, MIRROR, sink_qos

__all__ = ["Attendant", "Ros2Outlet", "Ros2Publishing"]

Step = Callable[[], None]


class Attendant(Protocol):
    """Who looks after publishers in the node's thread; see `ua_bridges.ros2.watch.Watch`."""

    def attend(self, publisher: HeldPublisher) -> None:
        """Look after a new publisher until it is open."""
        ...

    def drop(self, publisher: HeldPublisher) -> None:
        """End a publisher."""
        ...

    def keep(self, name: str, message_class: Any, message: Any) -> None:
        """Keep a message that the bridge before this one has published."""
        ...

    def forget(self, name: str) -> None:
        """There is a newer message than the one that is kept."""
        ...


class Ros2Outlet:
    """See `ua_bridges.ros.outlets.Outlet`: a publisher, which several DataSets may share, and the way into messages."""

    def __init__(
        self, publisher: HeldPublisher, make_message: Make, attendant: Attendant, call: Callable[[Step], None]
    ) -> None:
        self.name, self.publisher = publisher.name, publisher
        self._make, self._attendant, self._call = make_message, attendant, call

    def publish(self, values: Values, gone: Gone) -> int:
        """See Outlet."""
        return self.publisher.publish(self._make, values, gone)

    def write(self, values: Values) -> bool:
        """See Outlet."""
        return self.publisher.write(self._make, values)

    @property
    def listeners(self) -> int:
        """See Outlet."""
        return self.publisher.listeners

    def remember(self, values: Values) -> None:
        """See Outlet."""
        again = copy.deepcopy(self._make(values))
        if self.publisher.qos.transient_local:
            self._call(partial(self._attendant.keep, self.name, self.publisher.kind.cls, again))

    def supersede(self) -> None:
        """See Outlet."""
        self._call(partial(self._attendant.forget, self.name))


class Ros2Publishing(Publishing[Ros2Outlet]):
    """See Publishing."""

    def __init__(self, attendant: Attendant, call: Callable[[Step], None]) -> None:
        """`call` has a step done in the node's thread."""
        self._attendant, self._call = attendant, call
        self._shared: dict[str, HeldPublisher] = {}
        """Publishers of robots' own topics, by name."""

    def mirror(self, name: str, form: Form, *, latched: bool, are_events: bool) -> tuple[Ros2Outlet, Form]:
        """See Publishing. In ROS 2 a subscriber says whether it wants the last message, if that is a state."""
        kind = load_type(form.ros_type)
        form = with_stamp(form, kind.schema)
        publisher = HeldPublisher(name, kind, EVENTS if are_events else MIRROR)
        fill = compile_writer(kind.schema, form.names, make, partial=not form.is_whole)
        encode = compile_encoder(kind.schema, form.names, partial(fill, kind.cls())) if form.is_whole else None
        return self._outlet(publisher, encode or publisher.filling(fill)), form

    def sink(self, data: Mapped, *, takes_setpoints: bool) -> Ros2Outlet:
        """See Publishing: the depth of the queue is that of `qos`."""
        mapping = data.side
        paths = [(name or data.name, field.path or name or "data") for name, field in data.config.all_fields().items()]
        kind = load_type(mapping.type)
        fill = compile_sink(kind.schema, paths)
        publisher = self._shared.get(mapping.own_topic)
        if publisher is None:
            publisher = HeldPublisher(mapping.own_topic, kind, sink_qos(mapping.qos))
            self._shared[mapping.own_topic] = publisher
            self._call(partial(self._attendant.attend, publisher))
        elif publisher.kind is not kind:
            raise SchemaInvalid(kind.name, f"another sink writes {publisher.kind.name} to the same topic")
        return self._outlet(publisher, publisher.filling(fill))

    def _outlet(self, publisher: HeldPublisher, make_message: Make) -> Ros2Outlet:
        return Ros2Outlet(publisher, make_message, self._attendant, self._call)

    def retire(self, outlet: Ros2Outlet) -> int:
        """See Publishing: what it holds is counted in the node's thread."""
        return 0

    def changed(self, made: Ros2Outlet | None, replaced: Ros2Outlet | None) -> None:
        """See Publishing."""
        if replaced is not None:
            self._call(partial(self._attendant.drop, replaced.publisher))
        if made is not None:
            self._call(partial(self._attendant.attend, made.publisher))
