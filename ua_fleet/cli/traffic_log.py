"""`--traffic-log` of `serve` and `bridge`."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ua_fleet.config.schema import FleetConfig

__all__ = ["TrafficLogFile", "traffic_log"]

TrafficLogFile = Annotated[
    Path | None,
    typer.Option("--traffic-log", help="Write each PubSub message's kind and size to this file, as JSON lines."),
]


@contextmanager
def traffic_log(path: Path | None, config: FleetConfig) -> Generator[Callable[[bytes, int], None] | None]:
    """What to tell of each message; None where nobody wants to know."""
    if path is None:
        yield None
        return
    from ua_fleet.config.traffic import known_kinds
    from ua_fleet.storage.traffic_log import TrafficLog

    with closing(TrafficLog(path, known_kinds(config))) as log:
        yield lambda plain, wire_bytes: log.sent(plain, wire_bytes, time.time())
