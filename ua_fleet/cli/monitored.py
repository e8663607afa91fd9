"""The monitoring of a long-running command, as `fleet.yaml` says."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ua_fleet.config.schema import MonitoringConfig
    from ua_fleet.monitoring import Monitor, ProcessKind

__all__ = ["monitored"]


@asynccontextmanager
async def monitored(
    config: MonitoringConfig, process: ProcessKind, name: str, state_dir: Path, *, port: int | None, port_key: str
) -> AsyncGenerator[Monitor]:
    """A monitor that answers over HTTP while the context lasts, unless `fleet.yaml` says that nobody may ask.

    Args:
        config: the section `monitoring`.
        process: what the process is.
        name: what `fleet.yaml` calls it.
        state_dir: its folder.
        port: its own port, where it has one.
        port_key: the key of that.

    Raises:
        ServerStartError: the port is in use, or the address is not this machine's.
    """
    from ua_fleet.monitoring import Monitor
    from ua_fleet.monitoring.endpoint import MonitoringEndpoint

    monitor = Monitor(process, name)
    if not config.enabled:
        yield monitor
        return
    key = "monitoring.port" if port is None else port_key
    wanted = config.port if port is None else port
    async with MonitoringEndpoint(monitor, config.host, wanted, state_dir, key=key, names=config.names):
        yield monitor
