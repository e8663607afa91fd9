"""The Diagnostics of a bridge, from what its status DataSet tells."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final

from ua_fleet.operation.pubsub.connections import Resets
from ua_fleet.operation.pubsub.description import ADVANCED, Counter, Diagnostics, small_counts
from ua_fleet.pubsub.components import CONNECTION, Component
from ua_fleet.pubsub.group_figures import FIGURES_FIELD, GroupFigures, unpacked
from ua_fleet.pubsub.remote_writer import RemoteWriter
from ua_fleet.values import StatusCode
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

__all__ = ["ToldDiagnostics"]

_NO_COMMUNICATION: Final = int(StatusCode.BAD_NO_COMMUNICATION)


def _nothing_below() -> bool:
    return False


class ToldDiagnostics:
    """The Diagnostics of one bridge's components. It looks at the last status when it is asked."""

    def __init__(
        self,
        key: str,
        status: Callable[[], RemoteWriter | None],
        is_heard: Callable[[], bool],
        address: Callable[[int], object],
        resets: Resets,
    ) -> None:
        """Show what a bridge tells.

        Args:
            key: of its connection.
            status: the DataSetWriter of its status, where it was heard.
            is_heard: whether the bridge is heard.
            address: where messages of its connection with a number go.
            resets: of counters.
        """
        self._key, self._status, self._is_heard, self._address, self._resets = key, status, is_heard, address, resets
        self._frame: DataSetMessage | None = None
        self._told: dict[tuple[int, Component], GroupFigures] = {}
        """What that frame says."""

    def has_problem(self, number: int) -> bool:
        """Whether its connection with this number is in the state Error, as the bridge tells now."""
        told = self._figures().get((number, CONNECTION))
        return told is not None and bool(told.has_problem) and self._is_heard()

    def __call__(self, component: Component, number: int = 0, key: str = "") -> Diagnostics | None:
        """What is counted of a component; None where the bridge does not tell of it.

        Args:
            component: the component.
            number: of the connection that it stands at.
            key: of that connection, where it is not the first.
        """
        if (number, component) not in self._figures():
            return None
        key = key or self._key

        def figure(name: str) -> int:
            figures = self._figures().get((number, component))
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
            address = {"ResolvedAddress": partial(self._address, number)}
            return self._made(key, component, counters, address, self._has_failed if number == 0 else _nothing_below)
        counters |= {
            "SentNetworkMessages": counter("sent"),
            "FailedTransmissions": counter("failed", is_error=True),
            "EncryptionErrors": counter("not_secured", is_error=True, level=ADVANCED),
        }
        live = small_counts(lambda: figure("configured"), lambda: figure("operational"), "DataSetWriters")
        return self._made(key, component, counters, live, _nothing_below)

    def reset(self, component: Component, number: int = 0, key: str = "") -> bool:
        """Begin to count anew; False where nothing is counted."""
        made = self(component, number, key)
        if made is not None:
            self._resets.reset(key or self._key, component, made.counters)
        return made is not None

    def _made(
        self,
        key: str,
        component: Component,
        counters: Mapping[str, Counter],
        live: Mapping[str, Callable[[], object]],
        sub_error: Callable[[], bool],
    ) -> Diagnostics:
        return Diagnostics(
            self._resets.counters(key, component, counters),
            live,
            sub_error,
            lambda: 0 if self._is_heard() else _NO_COMMUNICATION,
        )

    def _has_failed(self) -> bool:
        """Whether a WriterGroup has counted an error."""
        groups = [self(component, number) for number, component in self._figures() if component != CONNECTION]
        return any(made.total(errors=True) for made in groups if made is not None)

    def _figures(self) -> dict[tuple[int, Component], GroupFigures]:
        writer = self._status()
        if writer is None or writer.metadata is None or writer.last_frame is None:
            return {}
        if writer.last_frame is not self._frame:
            self._frame, self._told = writer.last_frame, self._unpacked(writer.metadata, writer.last_frame)
        return self._told

    @staticmethod
    def _unpacked(metadata: DataSetMetaData, frame: DataSetMessage) -> dict[tuple[int, Component], GroupFigures]:
        names = [field.name for field in metadata.fields]
        values = frame.values
        at = names.index(FIGURES_FIELD) if FIGURES_FIELD in names else len(values)
        numbers: Any = values[at] if at < len(values) else ()
        return unpacked(numbers) if isinstance(numbers, tuple) else {}  # pyright: ignore[reportUnknownArgumentType]
