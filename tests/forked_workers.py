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
from execnet import gateway_base, gateway_io

from tests.fork_server import COLLECT
from tests.forking import Command, ForkedProcess, ForkServer, share

__all__ = ["ForkedWorkers"]

_PROGRAM: Final = str(Path(__file__).with_name("execnet_bootstrap.py"))
_gateway_io: Final[Any] = gateway_io
_gateway_base: Final[Any] = gateway_base
_create_io: Final = _gateway_io.create_io


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
            self._server.close()

    def _create_io(self, spec: Any, execmodel: Any) -> Any:
        if not spec.popen or spec.python:
            return _create_io(spec, execmodel)
        if self._server is None:
            self._server = ForkServer(sys.executable, COLLECT, *self._files)
            share()
        command = Command(sys.executable, _PROGRAM, False, [])
        process = ForkedProcess(command, os.environ, reads=True, server=self._server)
        io = _gateway_base.Popen2IO(process.stdin, process.stdout, execmodel)
        io.wait, io.kill = process.wait, process.kill  # execnet ends it as a process that it has started itself
        return io
