"""Whether a process is well, asked from outside. The standard library alone, since this runs every few seconds."""

from __future__ import annotations

import json
import os
import socket
import sys
import time
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from ua_fleet.printing import harmless

__all__ = [
    "DEFAULT_STATE_DIR",
    "DEFAULT_TIMEOUT_S",
    "DEFAULT_WITHIN_S",
    "HealthQuestion",
    "HealthVerdict",
    "check",
    "quick",
    "tell",
]

DEFAULT_STATE_DIR: Final = "state"
"""The server's, beside `fleet.yaml`."""
DEFAULT_TIMEOUT_S: Final = 3.0
DEFAULT_WITHIN_S: Final = 10.0
ADDRESS_FILE: Final = "monitoring.json"
"""As in `ua_fleet.monitoring.address`, which writes it; a test compares them."""
_MOST_BYTES: Final = 16_384
_HERE: Final = {"": "127.0.0.1", "0.0.0.0": "127.0.0.1", "::": "::1"}
"""Where a process is reached that listens on all addresses."""


class HealthQuestion(NamedTuple):
    """What is to be found out; all of it has to be well."""

    at: str | None = None
    """Address of a process's monitoring, `host:port`."""
    state_dir: str | None = None
    """Folder in which a process has written that address."""
    live: bool = False
    """Whether the process answers at all, in place of whether it is ready."""
    tcp: str | None = None
    """`host:port` where something is to accept connections."""
    heartbeat: str | None = None
    """A file that a program touches while it works."""
    within_s: float = DEFAULT_WITHIN_S
    """How long ago that may have been."""
    timeout_s: float = DEFAULT_TIMEOUT_S
    """Longest wait for an answer."""


class HealthVerdict(NamedTuple):
    """The answer."""

    is_well: bool
    text: str
    """One line: what is well, or what is wrong and what to do."""


class _Unwell(Exception):
    """What is wrong."""


def check(asked: HealthQuestion) -> HealthVerdict:
    """Find out what is asked for; what was not named is the server of the folder `state`."""
    well: list[str] = []
    try:
        if asked.tcp is not None:
            well.append(_accepts(asked.tcp, asked.timeout_s))
        if asked.heartbeat is not None:
            well.append(_beats(asked.heartbeat, asked.within_s))
        if asked.at is not None or asked.state_dir is not None or not well:
            well.append(_answers(asked))
    except _Unwell as unwell:
        return HealthVerdict(False, str(unwell))
    return HealthVerdict(True, "; ".join(well))


def tell(verdict: HealthVerdict, *, as_json: bool = False) -> int:
    """Print a verdict; returns the exit code."""
    shown = json.dumps({"well": verdict.is_well, "text": verdict.text}) if as_json else harmless(verdict.text)
    sys.stdout.write(f"{shown}\n")
    sys.stdout.flush()
    return 0 if verdict.is_well else 1


def _split(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or not 0 < int(port) <= 65535:
        raise _Unwell(f"{text} is no address; write it as HOST:PORT")
    host = host.strip("[]")
    return _HERE.get(host, host), int(port)


def _accepts(place: str, timeout_s: float) -> str:
    try:
        socket.create_connection(_split(place), timeout_s).close()
    except OSError as error:
        raise _Unwell(f"nothing accepts connections at {place}: {_reason(error)}") from error
    return f"{place} accepts connections"


def _beats(path: str, within_s: float) -> str:
    try:
        age_s = time.time() - os.stat(path).st_mtime
    except OSError as error:
        raise _Unwell(f"{path}: {_reason(error)}; check that the program has started") from error
    if age_s > within_s:
        raise _Unwell(f"{path} was touched {age_s:.1f} s ago, more than {within_s:g} s: the program does not work")
    return f"{path} was touched {max(age_s, 0.0):.1f} s ago"


def _answers(asked: HealthQuestion) -> str:
    instance = ""
    if asked.at is not None:
        host, port = _split(asked.at)
    else:
        host, port, instance = _written(asked.state_dir or DEFAULT_STATE_DIR)
    path = "/healthz" if asked.live else "/readyz"
    place = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    try:
        code, headers, body = _get(host, port, path, asked.timeout_s)
    except TimeoutError as error:
        text = f"{place} did not answer within {asked.timeout_s:g} s: its event loop is blocked, or the machine is busy"
        raise _Unwell(text) from error
    except OSError as error:
        raise _Unwell(f"no answer at {place}: {_reason(error)}; check that the process runs") from error
    if instance and f"\r\nua-fleet-instance: {instance}" not in headers.lower():
        raise _Unwell(f"another process answers at {place}; the process of this state_dir has ended")
    if code != 200:
        raise _Unwell(body or f"{place}{path} answered with status {code}")
    return body or "ok"


def _written(state_dir: str) -> tuple[str, int, str]:
    path = os.path.join(state_dir, ADDRESS_FILE)
    try:
        with open(path, encoding="utf-8") as file:
            found = json.load(file)
        host = str(found["host"])
        return _HERE.get(host, host), int(found["port"]), str(found["instance"])
    except OSError as error:
        raise _Unwell(f"{path}: {_reason(error)}; check that the process runs, with monitoring.enabled") from error
    except (ValueError, KeyError, TypeError) as error:
        raise _Unwell(f"{path} cannot be read; start the process again") from error


def _get(host: str, port: int, path: str, timeout_s: float) -> tuple[int, str, str]:
    """Status, headers and the first line of the body."""
    until = time.monotonic() + timeout_s
    received = b""
    with socket.create_connection((host, port), timeout_s) as connection:
        # By its address: a process answers to its own names alone.
        peer = str(connection.getpeername()[0]).partition("%")[0]
        named = f"[{peer}]" if ":" in peer else peer
        connection.sendall(f"GET {path} HTTP/1.1\r\nHost: {named}:{port}\r\nConnection: close\r\n\r\n".encode())
        while len(received) < _MOST_BYTES:
            left_s = until - time.monotonic()
            if left_s <= 0:
                raise TimeoutError
            connection.settimeout(left_s)
            if not (part := connection.recv(_MOST_BYTES)):
                break
            received += part
    head, _, body = received.partition(b"\r\n\r\n")
    words = head.split(None, 2)
    if len(words) < 2 or not words[0].startswith(b"HTTP/1.") or not words[1].isdigit():
        raise _Unwell(f"what answers at {host}:{port} is no ua-fleet process")
    return int(words[1]), head.decode("latin-1"), body.decode("utf-8", "replace").partition("\n")[0]


def _reason(error: OSError) -> str:
    return (error.strerror or str(error) or type(error).__name__).lower()


_TEXTS: Final = {"--at": "at", "--state-dir": "state_dir", "--tcp": "tcp", "--heartbeat": "heartbeat"}
_SECONDS: Final = {"--within": "within_s", "--timeout": "timeout_s"}


def quick(arguments: Sequence[str]) -> int | None:
    """`ua-fleet healthcheck` with these arguments; None where they are such that the whole command line is needed."""
    given: dict[str, Any] = {}
    as_json = False
    rest = iter(arguments)
    for name in rest:
        if name in ("--live", "--json"):
            as_json = as_json or name == "--json"
            given["live"] = given.get("live", False) or name == "--live"
            continue
        value = next(rest, None)
        if value is None or value.startswith("-"):
            return None
        if name in _TEXTS:
            given[_TEXTS[name]] = value
        elif name in _SECONDS:
            try:
                seconds = float(value)
            except ValueError:
                return None
            if not seconds > 0:
                return None
            given[_SECONDS[name]] = seconds
        else:
            return None
    return tell(check(HealthQuestion(**given)), as_json=as_json)
