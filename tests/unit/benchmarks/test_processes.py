"""Processes of the benchmarks: one that ends is a failure, with what it said last."""

from __future__ import annotations

import os
import sys

import pytest

from benchmarks import start
from benchmarks._ros import median_and_p99, running_node
from benchmarks.harness import Failed


def test_a_process_that_ends_says_why() -> None:
    program = "import sys; print('ready', flush=True); sys.stdin.readline(); sys.exit('the port is in use')"
    with running_node(sys.executable, "-c", program, env=os.environ) as node:
        node.tell("go")
        with pytest.raises(Failed, match="ended with code 1: the port is in use"):
            node.read()


def test_nothing_measured_is_a_failure() -> None:
    assert median_and_p99([3.0, 1.0, 2.0]) == (2.0, 3.0)
    with pytest.raises(Failed, match="nothing arrived"):
        median_and_p99([])


def test_the_floor_of_the_start_serves() -> None:
    """It ended at once: `benchmarks/json.py` was taken for the library's module."""
    with running_node(*start.floor_command(1), env=os.environ) as node:
        assert node.ready == "ready"
