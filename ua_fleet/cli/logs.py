"""Logs of long-running commands, set up in this one place."""

from __future__ import annotations

import io
import logging
import os
import sys
import threading
from collections.abc import MutableMapping
from types import TracebackType
from typing import Any, Final, TextIO

from ua_fleet.cli.endings import UsageError
from ua_fleet.printing import harmless, harmless_lines

__all__ = ["LOG_VARIABLE", "set_up_logging"]

LOG_VARIABLE: Final = "UA_FLEET_LOG"
_LEVELS: Final = {"debug": 10, "info": 20, "warning": 30, "error": 40}
_OURS: Final = ("ua_fleet", "ua_bridges")


class _Always:
    """Puts the names of the process into each line, unless the line has its own."""

    def __init__(self, names: dict[str, str]) -> None:
        self._names = names

    def __call__(self, _logger: Any, _method: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
        for name, value in self._names.items():
            event.setdefault(name, value)
        return event


def _harmless(_logger: Any, _method: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    """What strangers said does nothing to the terminal; JSON escapes all of it anyway."""
    for name, value in event.items():
        if isinstance(value, str):
            event[name] = harmless(value)
    return event


def _traceback(target: TextIO, exc_info: Any) -> None:
    """Without the local variables, as the default one shows them: among them there may be a key."""
    import structlog

    text = io.StringIO()
    structlog.dev.plain_traceback(text, exc_info)
    target.write(harmless_lines(text.getvalue()))


def set_up_logging(default: str = "info", **names: str) -> None:
    """Logs go to stderr: for people on a terminal, one JSON object a line elsewhere.

    That is so for all that is said in the process: by packages with their own logs, in warnings, and by what nobody
    has caught. UA_FLEET_LOG sets the level: debug, info, warning, error; packages of others speak from warnings on.

    Args:
        default: the level without UA_FLEET_LOG.
        names: of the process, e.g. its bridge; each line of JSON has them.

    Raises:
        UsageError: the level is none of these.
    """
    name = os.environ.get(LOG_VARIABLE) or default
    level = _LEVELS.get(name.lower())
    if level is None:
        raise UsageError(f"{LOG_VARIABLE}={name} is no level of logs; use one of: {', '.join(_LEVELS)}")
    import structlog

    on_terminal = sys.stderr.isatty()
    last: list[Any] = [
        _Always(names),
        structlog.processors.format_exc_info,
        structlog.processors.JSONRenderer(),
    ]
    if on_terminal:
        last = [_harmless, structlog.dev.ConsoleRenderer(exception_formatter=_traceback)]
    first: list[Any] = [
        structlog.contextvars.merge_contextvars,
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        structlog.processors.StackInfoRenderer(),
    ]
    structlog.configure(
        processors=[*first, *last],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
        cache_logger_on_first_use=True,
    )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=[structlog.stdlib.add_logger_name, *first],
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *last],
        )
    )
    logging.root.handlers[:] = [handler]
    logging.root.setLevel(max(level, logging.WARNING))
    for ours in _OURS:
        logging.getLogger(ours).setLevel(level)
    logging.captureWarnings(True)
    if not on_terminal:
        _log_what_nobody_has_caught()


def _log_what_nobody_has_caught() -> None:
    """A traceback has many lines, and none of them is JSON."""
    import structlog

    log: Any = structlog.get_logger()

    def uncaught(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        log.critical("a mistake of ua_fleet; report this log", exc_info=(kind, error, trace))

    def uncaught_in_thread(told: threading.ExceptHookArgs) -> None:
        if told.exc_value is not None and not isinstance(told.exc_value, SystemExit):
            uncaught(told.exc_type, told.exc_value, told.exc_traceback)

    if sys.excepthook is sys.__excepthook__:
        sys.excepthook = uncaught
    if threading.excepthook is threading.__excepthook__:
        threading.excepthook = uncaught_in_thread
