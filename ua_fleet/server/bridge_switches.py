"""The server's side of `bridge.switching`: asks bridges to disable and enable what they send."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import structlog

from ua_fleet.errors import RobotOffline, SkillRejected, UaFleetError
from ua_fleet.pubsub.components import Component
from ua_fleet.pubsub.events import ActionReceived
from ua_fleet.pubsub.switch_action import SWITCH, SWITCH_ID, switch_arguments, switch_topic
from ua_fleet.server.asked_actions import AskedActions, refusal
from ua_fleet.values import StatusCode
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement

__all__ = ["BridgeSwitchRequests"]

INSTANCE: Final = "pubsub"
"""Second part of the RequestorId: these requests are not those of skills, and stand in no journal."""
MOST_REQUESTS: Final = 100
"""That are remembered."""

_log: Any = structlog.get_logger("ua_fleet.server")


class SwitchRefused(UaFleetError):
    """A bridge does not disable or enable what it was asked to."""

    remedy = "See what the message says, and the state of the component."

    def __init__(self, code: int, text: str) -> None:
        self.ua_status = code
        super().__init__(text)


class BridgeSwitchRequests:
    """Asks the bridges of one fleet; `server.pubsub_model.SwitchBridge`."""

    def __init__(
        self,
        bridges: Mapping[str, int],
        ns: int,
        *,
        send: Callable[[bytes], None],
        want: Callable[[int, int, float], bool],
        sooner: Callable[[], None],
        must_be_verified: bool,
        clock: Callable[[], float],
        wall_ticks: Callable[[], int],
    ) -> None:
        """Prepare to ask.

        Args:
            bridges: their spaces by their names.
            ns: the fleet's namespace.
            send: sends a plain message to all.
            want: asks for Actions until they are announced.
            sooner: called when `next_deadline` may have come nearer.
            must_be_verified: only signed responses are taken.
            clock: monotonic seconds.
            wall_ticks: the wall clock.
        """
        self._topics = {name: switch_topic(space, ns) for name, space in bridges.items()}
        self._spaces = set(bridges.values())
        self._actions = AskedActions(
            INSTANCE,
            send=send,
            want=want,
            sooner=sooner,
            must_be_verified=must_be_verified,
            clock=clock,
            wall_ticks=wall_ticks,
            most_remembered=MOST_REQUESTS,
            log=_log,
        )
        self.commands = self._actions.commands

    def announced(self, announcement: ActionMetaDataAnnouncement) -> None:
        """Learn of an Action, where it is one of these."""
        if announcement.data_set_writer_id == SWITCH_ID and announcement.publisher_id in self._spaces:
            self.commands.announced(announcement)

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take responses."""
        self.commands.receive(event, now)

    def want(self, bridge: str) -> None:
        """Have a bridge's Action announced, where it is not yet."""
        self.commands.want(self._topics[bridge])

    async def __call__(self, bridge: str, component: Component, *, is_enabled: bool) -> None:
        """Ask a bridge, and wait for its answer.

        Raises:
            SwitchRefused: it refuses, or does not answer.
            RobotOffline: it has announced no such Action.
        """
        arguments = switch_arguments(component, is_enabled=is_enabled)
        try:
            outcome = await self._actions.ask(self._topics[bridge], bridge, SWITCH, arguments)
        except TimeoutError:
            said = f"the bridge {bridge} does not answer; check that it runs"
            raise SwitchRefused(StatusCode.BAD_TIMEOUT, said) from None
        except RobotOffline as error:
            said = f"the bridge {bridge} has not announced that it can be switched; check that it runs"
            raise SwitchRefused(StatusCode.BAD_NO_COMMUNICATION, said) from error
        except SkillRejected as error:
            raise SwitchRefused(error.ua_status, str(error)) from error
        if (code := refusal(outcome)) is not None:
            raise SwitchRefused(code, outcome.report.message or f"the bridge {bridge} refuses it")
