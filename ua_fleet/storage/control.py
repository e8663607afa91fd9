"""How a running process is asked to hold its databases still while another one copies them.

A process listens on the socket `<name>.control` in its `state_dir`, mode 0600; nobody but its user, and root, is heard.

    asked        answered
    hold         {"held": ["/…/server.db"]}      the files stay as they are, while the connection lasts
    release      {"held": ["/…/server.db"]}      they were held until now, so what was read meanwhile is whole
    (closed)                                     they are released
    -            {"error": "…"}                  they are not held

Whatever ends the asking process closes its connection, and so releases the files. After `LONGEST_S` they are released
all the same, since the log grows meanwhile.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import struct
from collections.abc import AsyncGenerator, Awaitable, Callable, Generator, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

import structlog

from ua_fleet.errors import StorageUnavailable
from ua_fleet.storage.database import hold_own, release_own
from ua_fleet.storage.files import make_private_folder

__all__ = ["SUFFIX", "Held", "InThread", "held_by", "state_control"]

SUFFIX: Final = ".control"
LONGEST_S: Final = 600.0
_LINE_BYTES: Final = 64 * 1024
_ANSWER_S: Final = 60.0
"""What a checkpoint may take on a slow disk."""
_CREDENTIALS: Final = struct.Struct("3i")

_log: Any = structlog.get_logger("ua_fleet.storage")

Result = TypeVar("Result")
InThread = Callable[[Callable[[], Any]], Awaitable[Any]]
"""Does work in another thread that has databases open."""


class _Control:
    """Answers; only one backup at a time."""

    def __init__(self, threads: Sequence[InThread], longest_s: float) -> None:
        self._threads, self._longest_s = threads, longest_s
        self._is_held = False

    async def answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection."""
        try:
            peer = writer.get_extra_info("socket")
            _, uid, _ = _CREDENTIALS.unpack(peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size))
            if uid in (os.geteuid(), 0):
                async with asyncio.timeout(self._longest_s):
                    await self._serve(reader, writer)
        except (OSError, TimeoutError, ValueError):
            pass  # it is gone, or too slow: closing tells it that nothing is held
        finally:
            writer.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if await reader.readline() != b"hold\n":
            return
        if self._is_held:
            _send(writer, {"error": "another backup is being made; wait until it ends"})
            return
        self._is_held = True
        try:
            try:
                held = [str(path) for path in await self._everywhere(hold_own)]
            except StorageUnavailable as error:
                _send(writer, {"error": str(error)})
                return
            _send(writer, {"held": held})
            if await reader.readline() == b"release\n":
                _send(writer, {"held": held})
                await writer.drain()
        finally:
            await asyncio.shield(self._release())

    async def _everywhere(self, work: Callable[[], list[Path]]) -> list[Path]:
        found = work()
        for thread in self._threads:
            found += await thread(work)
        return found

    async def _release(self) -> None:
        release_own()
        for thread in self._threads:
            with contextlib.suppress(RuntimeError):  # the thread has ended, and its databases are closed
                await thread(release_own)
        self._is_held = False


def _send(writer: asyncio.StreamWriter, answer: dict[str, Any]) -> None:
    writer.write(json.dumps(answer).encode() + b"\n")


@contextlib.asynccontextmanager
async def state_control(
    folder: Path, name: str, threads: Sequence[InThread] = (), *, longest_s: float = LONGEST_S
) -> AsyncGenerator[None]:
    """Let the databases of this process be copied while the context lasts.

    Where no socket can be made, such as on a disk that is read only, the log says so, and backups need a stop.

    Args:
        folder: the `state_dir`.
        name: of the process, which is the only one of this name there.
        threads: those beside the calling one that have databases open.
        longest_s: how long they are held at most, in seconds.
    """
    control = _Control(threads, longest_s)
    with contextlib.ExitStack() as cleanup:
        try:
            listening = cleanup.enter_context(_listening(folder, f"{name}{SUFFIX}"))
            server = await asyncio.start_unix_server(control.answer, sock=listening, limit=_LINE_BYTES, backlog=4)
        except OSError as error:
            reason = error.strerror or str(error)
            _log.warning("no backup can be made while this process runs", folder=str(folder), reason=reason)
            yield
            return
        try:
            yield
        finally:
            server.close()


@contextlib.contextmanager
def _folder_path(folder: Path) -> Generator[str]:
    """A short path to a folder: the address of a socket has 107 bytes at most."""
    descriptor = os.open(folder, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield f"/proc/self/fd/{descriptor}"
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def _listening(folder: Path, name: str) -> Generator[socket.socket]:
    make_private_folder(folder)
    with _folder_path(folder) as short, socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listening:
        path = f"{short}/{name}"
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)  # of a process that was killed
        listening.bind(path)
        os.chmod(path, 0o600)  # before anybody can connect: it does not listen yet
        try:
            yield listening
        finally:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(path)


class Held:
    """A process that holds its databases."""

    def __init__(self, place: Path, connection: socket.socket) -> None:
        self._place, self._connection = place, connection
        self._lines = connection.makefile("rb")
        self.files = self._ask("hold")
        """Those that it holds."""

    def still(self) -> None:
        """Make sure that the files were held until now; raises StorageUnavailable."""
        self._ask("release")

    def _ask(self, what: str) -> list[Path]:
        try:
            self._connection.sendall(f"{what}\n".encode())
            answer = json.loads(self._lines.readline(_LINE_BYTES))
        except (OSError, ValueError):
            raise StorageUnavailable(
                f"{self._place}: the process ended, or released its files too early; make the backup again"
            ) from None
        if "error" in answer:
            raise StorageUnavailable(f"{self._place}: {answer['error']}")
        return [Path(path) for path in answer["held"]]


@contextlib.contextmanager
def held_by(place: Path) -> Generator[Held | None]:
    """Have the process behind a socket hold its databases while the context lasts; None where no process is there.

    Raises:
        StorageUnavailable: it is there, and does not.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(_ANSWER_S)
        try:
            with _folder_path(place.parent) as short:
                connection.connect(f"{short}/{place.name}")
        except (ConnectionRefusedError, FileNotFoundError):
            yield None
            return
        except OSError as error:
            raise StorageUnavailable(f"{place}: {error.strerror}; run this as the user of that process") from error
        yield Held(place, connection)
