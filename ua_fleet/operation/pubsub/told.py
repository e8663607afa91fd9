"""The Diagnostics of a bridge, from what its status DataSet tells."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from ua_fleet.operation.pubsub.connections import Resets
from ua_fleet.operation.pubsub.description import ADVANCED, Counter, Diagnostics, small_counts
from ua_fleet.pubsub.components import CONNECTION, Component
from ua_fleet.pubsub.group_figures import FIGURES_FIELD, GroupFigures, unpacked
from ua_fleet.pubsub.remote_writer import RemoteWriter
from ua_fleet.values import StatusCode

__all__ = ["ToldDiagnostics"]

_NO_COMMUNICATION: Final = int(StatusCode.BAD_NO_COMMUNICATION)


class ToldDiagnostics:
    """The Diagnostics of one bridge's components. It looks at the last status when it is asked."""

    def __init__(
        self,
        key: str,
        status: Callable[[], RemoteWriter | None],
        is_heard: Callable[[], bool],
        address: Callable[[], object],
        resets: Resets,
    ) -> None:
        """Show what a bridge tells.

        Args:
            key: of its connection.
            status: the DataSetWriter of its status, where it was heard.
            is_heard: whether the bridge is heard.
            address: where messages of the connection go.
            resets: of counters.
        """
        self._key, self._status, self._is_heard, self._address, self._resets = key, status, is_heard, address, resets

    def __call__(self, component: Component) -> Diagnostics | None:
        """What is counted of a component; None where the bridge does not tell of it."""
        if component not in self._figures():
            return None

        def figure(name: str) -> int:
            figures = self._figures().get(component)
            return 0 if figures is None else int(getattr(figures, name))

        def counter(name: str, *, is_error: bool = False, level: int = 0) -> Counter:
            return Counter(lambda: figure(name), is_error, level)

        counters = {
            "StateError": counter("errors", is_error=True),
            "StateOperationalByMethod": counter("by_method"),
            "StateOperationalByParent": counter("by_parent"),
            "StateOperationalFromError": counter("from_error"),
            "StatePausedByParent": counter("paused"),
            "StateDisabledByMethod": counter("disabled"),
        }
        if component == CONNECTION:
            return self._made(component, counters, {"ResolvedAddress": self._address}, self._has_failed)
        counters |= {
            "SentNetworkMessages": counter("sent"),
            "FailedTransmissions": counter("failed", is_error=True),
            "EncryptionErrors": counter("not_secured", is_error=True, level=ADVANCED),
        }
        live = small_counts(lambda: figure("configured"), lambda: figure("operational"), "DataSetWriters")
        return self._made(component, counters, live, lambda: False)

    def reset(self, component: Component) -> bool:
        """Begin to count anew; False where nothing is counted."""
        made = self(component)
        if made is not None:
            self._resets.reset(self._key, component, made.counters)
        return made is not None

    def _made(
        self,
        component: Component,
        counters: Mapping[str, Counter],
        live: Mapping[str, Callable[[], object]],
        sub_error: Callable[[], bool],
    ) -> Diagnostics:
        return Diagnostics(
            self._resets.counters(self._key, component, counters),
            live,
            sub_error,
            lambda: 0 if self._is_heard() else _NO_COMMUNICATION,
        )

    def _has_failed(self) -> bool:
        """Whether a WriterGroup has counted an error."""
        groups = [self(component) for component in self._figures() if component != CONNECTION]
        return any(made.total(errors=True) for made in groups if made is not None)

    def _figures(self) -> dict[Component, GroupFigures]:
        writer = self._status()
        if writer is None or writer.metadata is None or writer.last_frame is None:
            return {}
        names = [field.name for field in writer.metadata.fields]
        values = writer.last_frame.values
        at = names.index(FIGURES_FIELD) if FIGURES_FIELD in names else len(values)
        numbers: Any = values[at] if at < len(values) else ()
        return unpacked(numbers) if isinstance(numbers, tuple) else {}  # pyright: ignore[reportUnknownArgumentType]
