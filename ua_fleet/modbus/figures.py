"""What the gateway tells of itself: figures for Prometheus, and whether it is ready."""

from __future__ import annotations

from collections.abc import Iterator

from ua_fleet.modbus.gateway import Gateway
from ua_fleet.modbus.listener import ModbusListener
from ua_fleet.monitoring import Monitor, metrics
from ua_fleet.monitoring.metrics import Family

__all__ = ["GatewayFigures"]

_CAUSES = ("writer", "address", "value", "function", "unit", "frame", "connections")


class GatewayFigures:
    """Looks at the parts of a running gateway when it is asked."""

    def __init__(self, gateway: Gateway, listener: ModbusListener, place: str) -> None:
        self._gateway, self._listener, self._place = gateway, listener, place

    def tell(self, monitor: Monitor) -> None:
        """Tell of the gateway from now on: it listens."""
        monitor.add(self.collect)
        monitor.ready_when(lambda: self._gateway.problem, lambda: f"Modbus at {self._place}")

    def collect(self) -> Iterator[Family]:
        """All figures now."""
        yield metrics.SERVER_CONNECTED.one(not self._gateway.problem)
        yield metrics.MODBUS_CONNECTIONS.one(self._listener.connections)
        yield metrics.MODBUS_REFUSED.many(((cause,), self._listener.refused[cause]) for cause in _CAUSES)
