"""The bridge as a process: what is opened, in which order, and closed whatever happens.

With message security one task beside the shell keeps the keys, and the bridge enters its space once it has the key that
it publishes with.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from contextlib import AsyncExitStack
from functools import partial
from pathlib import Path
from typing import Final

from ua_fleet.bridge.assembly import BridgeGiven
from ua_fleet.bridge.carry import CarryFactory
from ua_fleet.bridge.core import Rule
from ua_fleet.bridge.driver import Driver
from ua_fleet.bridge.shell import BridgeShell
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import keys_needed
from ua_fleet.errors import UaFleetError
from ua_fleet.keys.keeper import keep_keys
from ua_fleet.keys.source import KeySource
from ua_fleet.monitoring import Mistakes, Monitor
from ua_fleet.skill.journal import MemoryJournal, ResponderJournal
from ua_fleet.storage.control import state_control
from ua_fleet.storage.journal import SqliteJournal
from ua_fleet.storage.process_lock import process_lock
from ua_fleet.topics import loop_verdict
from ua_fleet.transport.base import Transport
from ua_fleet.transport.sealed import Sent

__all__ = ["run_bridge"]

JOURNAL: Final = "executions.db"
"""In a bridge's state folder: what its robots were asked to do."""


async def run_bridge(
    config: FleetConfig,
    bridge_name: str,
    driver: Driver,
    transport: Transport | Sequence[Transport],
    *,
    state_dir: Path,
    keys: KeySource | None = None,
    journal: ResponderJournal | None = None,
    ready: Callable[[], None] | None = None,
    rule: Rule = loop_verdict,
    sent: Sent | None = None,
    monitor: Monitor | None = None,
    carry: CarryFactory | None = None,
) -> None:
    """Run a bridge until cancelled; then the driver has left its space and the transport is closed.

    Args:
        config: the fleet.
        bridge_name: which of its bridges this is.
        driver: the bridge's driver, not started.
        transport: the PubSub side, not started; of a bridge on several connections one for each, in their order.
        state_dir: where the bridge remembers what must survive a restart; used only with message security or skills.
        keys: where the keys of message security come from; not needed where it is `none`.
        journal: of executions; the one in `state_dir` if left out. Without skills there is nothing to remember.
        ready: called once both sides work.
        rule: the loop rule; only a test puts another one in its place.
        sent: told of each message that is sent, with its bytes on the wire.
        monitor: tells of the bridge.
        carry: makes who carries runs in it; without, it takes no part of any.

    Raises:
        ConfigError: no key source is configured, or what stands in `state_dir` cannot be used.
        BridgeUnavailable: a library that the driver needs is missing.
        DriverFailed: a mistake of the driver has ended it; a bridge that is started anew goes on where it stopped.
        StorageUnavailable: the journal of executions cannot be used, or this bridge runs already.
        TransportError: the PubSub side cannot be opened; with the remedy.
    """
    keys = keys_needed(config, config.bridges[bridge_name].space, keys)
    async with AsyncExitStack() as cleanup:
        cleanup.enter_context(process_lock(state_dir / f"{bridge_name}.lock", f"bridge {bridge_name}"))
        if journal is None and driver.has_skills:
            journal = cleanup.enter_context(SqliteJournal(state_dir / JOURNAL))
        await cleanup.enter_async_context(state_control(state_dir, bridge_name))
        mistakes = monitor.mistakes if monitor is not None else Mistakes()
        journal = journal or MemoryJournal()
        shell = BridgeShell(
            BridgeGiven(config, bridge_name, driver, transport, state_dir, journal, rule, sent, mistakes, carry)
        )
        parts = shell.parts
        cleanup.push_async_callback(parts.connections.close)
        cleanup.push_async_callback(driver.stop)
        cleanup.callback(shell.end)
        if parts.teleoperation is not None:
            cleanup.push_async_callback(parts.teleoperation.stop)
        try:
            async with asyncio.TaskGroup() as tasks:
                if keys is not None:
                    count = config.pubsub.keys.future_keys + 1
                    envelopes = parts.connections.envelopes
                    keeping = partial(keep_keys, envelopes, keys, parts.keys, count=count, mistakes=mistakes)
                    tasks.create_task(mistakes.keep("keys", keeping))
                    if monitor is not None:
                        monitor.ready_when(
                            lambda: f"it waits for its keys: {parts.keys.problem() or 'they were asked for'}"
                        )
                    await shell.wait_for_own_key()
                driver.remember_in(state_dir)
                await driver.start(parts.inlet)
                await parts.connections.start(shell.receive)
                shell.begin()
                if monitor is not None:
                    parts.figures.tell(monitor)
                if ready is not None:
                    ready()
                await shell.over
        except ExceptionGroup as failed:
            # Whatever failed while the rest was ended stands first; an error with a remedy was the cause.
            first, *others = sorted(failed.exceptions, key=lambda error: not isinstance(error, UaFleetError))
            for other in others:
                shell.failed("this failed, too, while the bridge ended", other)
            raise first from None
