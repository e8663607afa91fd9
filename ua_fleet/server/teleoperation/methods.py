"""Acquire, Renew, Release and Drive: the Methods of TeleoperationType, which all robots share.

What is refused has a Bad StatusCode, and its words in the DiagnosticInfo of who asks for that:

    Bad_UserAccessDenied        no operator; taken over by no engineer; the lease of another session
    Bad_InvalidState            the robot is at something else, or the lease is over
    Bad_ResourceUnavailable     another one drives it; the lease was taken over
    Bad_NoCommunication         its bridge is not there
    Bad_Timeout                 its bridge does not answer
    Bad_InvalidArgument         a setpoint that is none; the robot is stopped
    Bad_ConfigurationError      the files of server and bridge differ
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from typing import Any, Final

import structlog
from asyncua import ua

from ua_fleet.endpoint.convert import to_variant
from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.endpoint.sessions import Session, current_session
from ua_fleet.endpoint.stack import Refusal, StatusCodes, name_of
from ua_fleet.endpoint.users import Role
from ua_fleet.errors import LeaseRefused
from ua_fleet.nodes.method_factory import caller
from ua_fleet.nodes.teleoperation_nodes import ACQUIRE, DRIVE, RELEASE, RENEW
from ua_fleet.server.teleoperation.service import DrivingSession, TeleoperationService
from ua_fleet.teleoperation import TeleoperationModel
from ua_fleet.values import BuiltinType, StatusCode

__all__ = ["TeleoperationMethods"]

_log: Any = structlog.get_logger("ua_fleet.server")

_UINT32: Final = int(BuiltinType.UINT32)


class TeleoperationMethods:
    """Answers the Methods."""

    def __init__(
        self, server: HardenedServer, service: TeleoperationService, models: Sequence[TeleoperationModel]
    ) -> None:
        """Let them be called by operators; the types are loaded.

        Args:
            server: whose Methods they are.
            service: does what is asked for.
            models: the robots that can be driven by hand.
        """
        self._service, self._context = service, server.context
        self._robots = {(model.status.ns, model.status.id): model.robot for model in models}
        calls: list[tuple[ua.NodeId, Callable[..., Awaitable[Any]]]] = [
            (ACQUIRE, self._acquire),
            (RENEW, self._renew),
            (RELEASE, self._release),
            (DRIVE, self._drive),
        ]
        for method, call in calls:
            server.link_method(server.get_node(method), call)
            server.require_role(method, Role.OPERATOR)
        self._context.waiting_methods.update((ACQUIRE, RENEW, RELEASE))
        self._context.frequent_methods.update((RENEW, DRIVE))

    async def _acquire(self, parent: ua.NodeId, take_over: ua.Variant) -> list[ua.Variant]:
        robot, session, user = self._robot(parent), _session(), caller()
        if take_over.Value and not user.role.covers(Role.ENGINEER):
            raise LeaseRefused(StatusCode.BAD_USER_ACCESS_DENIED, "only engineers take a robot over from its holder")

        def gone() -> str:
            if session.closed or session.link is None:
                return "the session or its connection has ended"
            if session.user is None or session.user.name != user.name:
                return "another user has the session"
            return "" if self._context.may_call(session.user, DRIVE) else f"{user.name} may not drive any more"

        driver = DrivingSession(session.key, user.name, session.caller, gone)
        try:
            granted = await self._service.acquire(robot, driver, take_over=bool(take_over.Value))
        except Exception as error:
            if (code := getattr(error, "ua_status", None)) is not None:
                _log.warning("robot not given out", robot=robot, by=user.name, reason=f"{name_of(code)}: {error}")
            raise
        return [
            to_variant(_UINT32, granted.lease),
            to_variant(_UINT32, granted.counter),
            to_variant(int(BuiltinType.STRING), granted.taken_from),
        ]

    async def _renew(self, parent: ua.NodeId, lease: ua.Variant) -> list[ua.Variant]:
        await self._service.renew(self._robot(parent), int(lease.Value), _session().key)
        return []

    async def _release(self, parent: ua.NodeId, lease: ua.Variant) -> list[ua.Variant]:
        await self._service.release(self._robot(parent), int(lease.Value), _session().key)
        return []

    async def _drive(
        self, parent: ua.NodeId, lease: ua.Variant, number: ua.Variant, echo: ua.Variant, values: ua.Variant
    ) -> list[ua.Variant]:
        session = _session().key
        self._service.drive(self._robot(parent), session, lease.Value, number.Value, echo.Value, values.Value or ())
        return []

    def _robot(self, parent: ua.NodeId) -> str:
        identifier: Any = parent.Identifier
        robot = self._robots.get((int(parent.NamespaceIndex), identifier))
        if robot is None:
            # The type has the Methods too, but nothing behind them.
            raise Refusal(StatusCodes.BadNodeIdInvalid, "no robot")
        return robot


def _session() -> Session:
    session = current_session.get()
    assert session is not None
    return session
