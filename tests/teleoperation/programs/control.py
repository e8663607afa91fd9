"""A program of these tests that is told what to do through a Unix socket: a line of JSON in, a line of JSON back."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from typing import Any

__all__ = ["serve"]


async def serve(path: str, answer: Callable[[dict[str, Any]], Awaitable[dict[str, Any]]]) -> None:
    """Answer for ever, one request after the other of each connection; a mistake is answered with its words."""

    async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while line := await reader.readline():
            try:
                said = await answer(json.loads(line))
            except Exception as error:  # noqa: BLE001 - it is told, and the program goes on
                said = {"error": f"{type(error).__name__}: {error}"}
            writer.write(json.dumps(said).encode() + b"\n")
        writer.close()

    server = await asyncio.start_unix_server(connected, path)
    print("ready", flush=True)
    async with server:
        await server.serve_forever()
