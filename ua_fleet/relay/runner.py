"""The relay as a process: the event loop, one timer, and its connections. What it forwards, its core decides."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from contextlib import AsyncExitStack
from functools import partial
from pathlib import Path
from typing import Any, Final

import structlog

from ua_fleet.config.nodes import mapped_sources
from ua_fleet.config.relays import directions_of, origins_on, relay_connections
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import keys_for, publisher_ids, relay_envelopes, weaknesses
from ua_fleet.config.teleoperation import setpoint_groups
from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import UaFleetError
from ua_fleet.keys.keeper import KeysKept, keep_keys
from ua_fleet.keys.source import KeySource
from ua_fleet.monitoring import Mistakes, Monitor
from ua_fleet.monitoring.counted import counted, keys_left, transported
from ua_fleet.monitoring.metrics import Family
from ua_fleet.one_timer import PAUSE_S, OneTimer
from ua_fleet.pubsub.security.groups import relay_group
from ua_fleet.relay.core import Forwarded, RelayCore, RelayedConnection
from ua_fleet.storage.process_lock import process_lock
from ua_fleet.transport.base import Address, Transport
from ua_fleet.transport.connections import Connection, Connections
from ua_fleet.transport.party import Brokered, Party
from ua_fleet.transport.sealed import SealedSender
from ua_fleet.wire import Codec
from ua_fleet.wire.security import SecurityMode

__all__ = ["run_relay"]

REPORT_S: Final = 1.0


class _Shell:
    """What the event loop calls: one method for each cause of work."""

    def __init__(
        self,
        config: FleetConfig,
        name: str,
        transports: Sequence[Transport],
        state_dir: Path,
        mistakes: Mistakes,
    ) -> None:
        self._loop, self._mistakes = asyncio.get_running_loop(), mistakes
        self._log: Any = structlog.get_logger("ua_fleet.relay", relay=name)
        self.counters, self.keys = Counters(), KeysKept()
        numbers = relay_connections(config, name)
        envelopes = relay_envelopes(config, name, self.counters, state_dir)
        self.connections = Connections(
            [
                Connection(config.connections[number].name or str(number), transport, envelope, takes_actions=False)
                for number, transport, envelope in zip(numbers, transports, envelopes, strict=True)
            ]
        )
        self._core = RelayCore(
            [
                RelayedConnection(each.envelope, isinstance(each.transport, Brokered), origins_on(config, number))
                for number, each in zip(numbers, self.connections.all, strict=True)
            ],
            directions_of(config, name),
            self.counters,
            Codec(),
            receive_timeout_s=config.pubsub.receive_timeout_s,
            publisher_ids=publisher_ids(config),
            stated=mapped_sources(config).stated,
        )
        self._senders = [SealedSender(each.envelope, each.transport, self._loop.time) for each in self.connections.all]
        groups = setpoint_groups(config)
        for number, each in enumerate(self.connections.all):
            if isinstance(each.transport, Brokered):
                each.transport.speak_for(
                    Party(
                        publisher_id=None,
                        seal=each.envelope.seal,
                        token=each.envelope.sending_token,
                        is_secured=each.envelope.mode is not SecurityMode.NONE,
                        names_of=lambda _writer_id: None,
                        names_of_origin=self._core.names_of,
                        receive_kept=partial(self._receive, connection=number, is_fresh=False),
                        setpoint_groups=groups,
                    )
                )
        self._timer = OneTimer(self._loop, self._on_timer)
        self._report_at = 0.0
        for weakness in weaknesses(config):
            self._log.warning(weakness)

    async def start(self) -> None:
        """Open the connections, and ask the origins for what they are."""
        for number, each in enumerate(self.connections.all):
            await each.transport.start(partial(self._receive, connection=number))
        self._send(self._core.begin())
        self._on_timer()

    def end(self) -> None:
        """Forward nothing any more."""
        self._timer.end()

    def _receive(self, datagram: bytes, sender: Address, *, connection: int, is_fresh: bool = True) -> None:
        try:
            self._send(self._core.receive(connection, datagram, self._loop.time(), is_fresh=is_fresh))
        except Exception as error:  # noqa: BLE001 - whatever is wrong with one datagram, others are behind it
            self._mistakes.caught("datagrams", error, client=f"{sender[0]}:{sender[1]}")
        self._arm()

    def _send(self, forwarded: Sequence[Forwarded]) -> None:
        for connection, plain in forwarded:
            self._senders[connection].send(plain)

    def _arm(self) -> None:
        """Set the one timer to the next deadline, unless it will ring before that."""
        deadline = self._core.next_deadline()
        self._timer.set(self._report_at if deadline is None else min(deadline, self._report_at))

    def _on_timer(self) -> None:
        now = self._loop.time()
        if now >= self._report_at:
            self._report_at = now + REPORT_S
            with self._mistakes.guard("each second"):
                self._report(now)
        try:
            self._send(self._core.poll(now))
        except Exception as error:  # noqa: BLE001 - what is due stays due: it is tried again, and not all the time
            self._mistakes.caught("timer", error)
            self._timer.pause(now + PAUSE_S)
        self._arm()

    def _report(self, now: float) -> None:
        for complaint in self._core.complaints(now):
            self._log.warning(complaint.what, cause=complaint.cause, count=complaint.count, detail=complaint.detail)
        self.connections.count_drops(self.counters)

    def tell(self, monitor: Monitor) -> None:
        """Tell of the relay from now on. It is of no use where one of its connections does not work."""
        monitor.add(self._collect)
        monitor.ready_when(lambda: self.connections.problem or self.connections.envelopes.problem)

    def _collect(self) -> Iterator[Family]:
        yield from counted(self.counters, has_space=False)
        yield from transported(self.connections.stats)
        if self.connections.envelopes.is_secured:
            yield from keys_left(self.connections.envelopes.keys_last_s(self._loop.time()), self.keys.source_problem)

    def summary(self) -> dict[str, Any]:
        """What it has done, for the log at its end."""
        drops = {str(Drop(cause).value): count for cause, count in self.counters.drops.items() if count}
        return {"received": self.counters.messages_in, "forwarded": self.counters.messages_out, "drops": drops}


async def run_relay(
    config: FleetConfig,
    name: str,
    transports: Sequence[Transport],
    *,
    state_dir: Path,
    keys: KeySource | None = None,
    ready: Callable[[], None] | None = None,
    monitor: Monitor | None = None,
) -> None:
    """Run a relay until cancelled; then its transports are closed.

    Args:
        config: the fleet.
        name: which of its relays this is.
        transports: not started, one for each of its connections, in their order.
        state_dir: where it remembers which nonces it has used; used only with message security.
        keys: where the keys of message security come from; not needed where no connection has it.
        ready: called once it forwards.
        monitor: tells of the relay.

    Raises:
        ConfigError: no key source is configured, or what stands in `state_dir` cannot be used.
        StorageUnavailable: this relay runs already.
        TransportError: a connection cannot be opened; with the remedy.
    """
    on = [config.connections[number] for number in relay_connections(config, name)]
    keys = keys_for(on, keys)
    async with AsyncExitStack() as cleanup:
        cleanup.enter_context(process_lock(state_dir / f"{name}.lock", f"relay {name}"))
        mistakes = monitor.mistakes if monitor is not None else Mistakes()
        shell = _Shell(config, name, transports, state_dir, mistakes)
        cleanup.callback(lambda: structlog.get_logger("ua_fleet.relay", relay=name).info("ends", **shell.summary()))
        cleanup.push_async_callback(shell.connections.close)
        cleanup.callback(shell.end)
        try:
            async with asyncio.TaskGroup() as tasks:
                if keys is not None:
                    count = config.pubsub.keys.future_keys + 1
                    envelopes = shell.connections.envelopes
                    keeping = partial(keep_keys, envelopes, keys, shell.keys, count=count, mistakes=mistakes)
                    tasks.create_task(mistakes.keep("keys", keeping))
                    if monitor is not None:
                        monitor.ready_when(
                            lambda: f"it waits for its keys: {shell.keys.problem() or 'they were asked for'}"
                        )
                    await shell.keys.wait_for([relay_group(name)])
                await shell.start()
                if monitor is not None:
                    shell.tell(monitor)
                if ready is not None:
                    ready()
                await asyncio.get_running_loop().create_future()
        except ExceptionGroup as failed:
            raise min(failed.exceptions, key=lambda error: not isinstance(error, UaFleetError)) from None
