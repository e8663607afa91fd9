"""Processes that run tests, forked off one that has imported all files of tests.

xdist starts each of its processes anew. Each imports 4,000 modules, and on a clean clone rewrites the assertions of all
tests too. Here one process does so for all (`fork_server`), and what is forked off it has all modules in memory.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Generator
from pathlib import Path
from typing import Any, Final

import pytest
from execnet import gateway_io
from execnet.gateway_base import Popen2IO

from tests.fork_server import COLLECT
from tests.forking import Command, ForkedProcess, ForkServer

__all__ = ["ForkedWorkers"]

_PROGRAM: Final = str(Path(__file__).with_name("execnet_bootstrap.py"))
_gateway_io: Final[Any] = gateway_io
_create_io: Final = _gateway_io.create_io


class _ForkedIO(Popen2IO):
    """What execnet speaks by with a process, as with one that it has started itself."""

    def __init__(self, process: ForkedProcess, execmodel: Any) -> None:
        super().__init__(process.stdin, process.stdout, execmodel)
        self._process = process

    def wait(self) -> int:
        """Wait for its end."""
        return self._process.wait()

    def kill(self) -> None:
        """End it."""
        self._process.kill()


class ForkedWorkers:
    """In the process that gives tests out."""

    def __init__(self) -> None:
        self._server: ForkServer | None = None
        self._files: list[str] = []

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_setupnodes(self, config: pytest.Config) -> None:
        """xdist is about to start its processes."""
        self._files = [f"--rootdir={config.rootpath}", *config.args]
        _gateway_io.create_io = self._create_io

    @pytest.hookimpl(hookwrapper=True)
    def pytest_sessionfinish(self) -> Generator[None]:
        """xdist ends its processes."""
        yield
        _gateway_io.create_io = _create_io
        if self._server is not None:
            self._server.end()

    def _create_io(self, spec: Any, execmodel: Any) -> Any:
        if not spec.popen or spec.python:
            return _create_io(spec, execmodel)
        if self._server is None:
            self._server = ForkServer(sys.executable, COLLECT, *self._files)
        command = Command(sys.executable, _PROGRAM, False, [])
        return _ForkedIO(ForkedProcess(command, os.environ, reads=True, server=self._server), execmodel)
