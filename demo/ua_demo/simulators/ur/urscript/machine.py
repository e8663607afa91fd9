"""The threads of one program, each one step of the controller at a time."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any, Final

from ua_demo.simulators.ur.urscript.nodes import Scope, Statement, Steps, run_block
from ua_demo.simulators.ur.urscript.values import ScriptError, Value

__all__ = ["Machine"]

_TURNS_A_STEP: Final = 2000
"""Turns of loops that one thread may take before the others are let on."""
_MOST_THREADS: Final = 50


class _Thread:
    """A handle. Only the machine knows what it stands for."""

    def __init__(self, name: str, steps: Generator[None, None, object]) -> None:
        self.name, self.steps, self.is_over = name, steps, False


class Machine:
    """A program that runs, or has ended."""

    def __init__(self, name: str, statements: Sequence[Statement], functions: Mapping[str, Callable[..., Any]]) -> None:
        self.name = name
        self._functions = {key: _checked(key, function) for key, function in functions.items()}
        self._main = _Thread(name, run_block(statements, Scope(self, None)))
        self._threads = [self._main]
        self._turns = 0

    @property
    def is_over(self) -> bool:
        """Whether its main thread has ended, and with it all others."""
        return self._main.is_over

    def step(self) -> None:
        """Let each thread go on until it waits.

        Raises:
            ScriptError: the program cannot go on; it is over.
        """
        for thread in list(self._threads):
            if thread.is_over:
                continue
            self._turns = 0
            try:
                next(thread.steps)
            except StopIteration:
                thread.is_over = True
            except ScriptError:
                self.stop()
                raise
            except RecursionError:
                self.stop()
                raise ScriptError("expressions within expressions are too deep") from None
            if self._main.is_over:
                self.stop()
                return
        self._threads = [thread for thread in self._threads if not thread.is_over]

    def stop(self) -> None:
        """End it."""
        for thread in self._threads:
            thread.is_over = True
            if not _runs(thread.steps):
                thread.steps.close()

    # What its statements need: see nodes.Runner

    def builtin(self, name: str) -> Callable[..., Any] | None:
        """See Runner."""
        return self._functions.get(name)

    def spend(self) -> bool:
        """See Runner."""
        self._turns += 1
        return self._turns % _TURNS_A_STEP == 0

    def start_thread(self, name: str, steps: Steps) -> object:
        """See Runner."""
        if len(self._threads) >= _MOST_THREADS:
            raise ScriptError(f"a program has at most {_MOST_THREADS} threads")
        thread = _Thread(name, steps)
        self._threads.append(thread)
        return thread

    def kill_thread(self, handle: object) -> None:
        """See Runner."""
        if isinstance(handle, _Thread) and handle in self._threads and not _runs(handle.steps):
            handle.is_over = True
            handle.steps.close()

    def join_thread(self, handle: object) -> Steps:
        """See Runner."""
        while isinstance(handle, _Thread) and not handle.is_over:
            yield
        return False


def _runs(steps: Generator[None, None, object]) -> bool:
    """Whether it is the thread that is at work now; it cannot be closed then, and goes no further."""
    return inspect.getgeneratorstate(steps) == inspect.GEN_RUNNING


def _checked(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, with an error for the program where it is called in another way than it takes."""
    signature = inspect.signature(function)

    def call(*arguments: Value, **named: Value) -> Any:
        try:
            signature.bind(*arguments, **named)
        except TypeError as error:
            raise ScriptError(f"{name}: {error}") from error
        return function(*arguments, **named)

    return call
