"""A process of tests asks about a test that one has crashed in, and about no test while none has crashed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from tests.crashes import CrashNote, ask_less


class Asked:
    """What pytest-rerunfailures has for the process that gives tests out."""

    def __init__(self) -> None:
        self.nodeids: list[str] = []

    def get_test_failures(self, nodeid: str) -> int:
        self.nodeids.append(nodeid)
        return 1


def test_nobody_is_asked_while_none_has_crashed() -> None:
    note, asked, node = CrashNote(), Asked(), SimpleNamespace(workerinput={})
    try:
        note.pytest_configure_node(node)
        config: Any = SimpleNamespace(workerinput=node.workerinput, failures_db=asked)
        ask_less(config)
        config.failures_db.set_test_reruns("a", 1)
        assert config.failures_db.get_test_failures("a") == 0
        assert asked.nodeids == []
        note.pytest_handlecrashitem()
        assert config.failures_db.get_test_failures("b") == 1
        assert asked.nodeids == ["b"]
    finally:
        note.pytest_unconfigure()
