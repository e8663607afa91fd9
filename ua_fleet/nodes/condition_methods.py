"""The Methods of all conditions, which stand in their types: of faults, of alarms of values (OPC 10000-9 5.5 to 5.8).

The roles: operators acknowledge, confirm, comment and shelve; engineers suppress, enable and disable.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Final

from asyncua import ua

from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.endpoint.sessions import current_session
from ua_fleet.endpoint.stack import ObjectIds, Refusal, StatusCodes, ns0
from ua_fleet.endpoint.users import Role
from ua_fleet.errors import UaFleetError
from ua_fleet.nodes.alarm_nodes import AlarmNodes
from ua_fleet.nodes.alarms import ACKNOWLEDGE, ADD_COMMENT, DISABLE, ENABLE
from ua_fleet.nodes.carried_methods import said_by_bridges
from ua_fleet.nodes.method_factory import caller
from ua_fleet.nodes.scenario_view import ScenarioView
from ua_fleet.operation.alarms.condition import Condition
from ua_fleet.operation.alarms.service import AlarmService
from ua_fleet.operation.runs.carried import CarriedRuns
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.values import NodeId

__all__ = ["ConditionMethods"]

MOST_COMMENT: Final = 1000
_REFRESH: Final = ns0(ObjectIds.ConditionType_ConditionRefresh)
_REFRESH2: Final = ns0(ObjectIds.ConditionType_ConditionRefresh2)
_CONFIRM: Final = ns0(ObjectIds.AcknowledgeableConditionType_Confirm)
_SUPPRESS: Final = ns0(ObjectIds.AlarmConditionType_Suppress)
_UNSUPPRESS: Final = ns0(ObjectIds.AlarmConditionType_Unsuppress)
_UNSHELVE: Final = ns0(ObjectIds.ShelvedStateMachineType_Unshelve)
_ONE_SHOT: Final = ns0(ObjectIds.ShelvedStateMachineType_OneShotShelve)
_RESPOND: Final = ns0(ObjectIds.DialogConditionType_Respond)
_TIMED: Final = ns0(ObjectIds.ShelvedStateMachineType_TimedShelve)

Answer = list[ua.Variant]


class ConditionMethods:
    """Answers the Methods."""

    def __init__(
        self,
        server: HardenedServer,
        view: ScenarioView,
        scenarios: ScenarioService,
        nodes: AlarmNodes,
        alarms: AlarmService,
        carried: CarriedRuns,
    ) -> None:
        """Prepare to answer; `build` links the Methods.

        Args:
            server: whose Methods they are.
            view: of faults.
            scenarios: has the faults.
            nodes: of alarms.
            alarms: of values.
            carried: the runs that bridges carry.
        """
        self._server, self._view, self._scenarios = server, view, scenarios
        self._nodes, self._alarms, self._carried = nodes, alarms, carried

    def build(self) -> None:
        """Let the Methods be called."""
        observer, operator, engineer = Role.OBSERVER, Role.OPERATOR, Role.ENGINEER
        for method, call, role in (
            (ACKNOWLEDGE, self._acknowledge, operator),
            (_CONFIRM, self._confirm, operator),
            (ADD_COMMENT, self._add_comment, operator),
            (ENABLE, self._enable, operator),
            (DISABLE, self._disable, operator),
            (_SUPPRESS, partial(self._suppress, suppressed=True), engineer),
            (_UNSUPPRESS, partial(self._suppress, suppressed=False), engineer),
            (_TIMED, self._shelve_for, operator),
            (_ONE_SHOT, self._shelve_once, operator),
            (_UNSHELVE, self._unshelve, operator),
            (_RESPOND, self._respond, operator),
            (_REFRESH, self._refresh, observer),
            (_REFRESH2, self._refresh, observer),
        ):
            self._server.link_method(self._server.get_node(method), call)
            self._server.require_role(method, role)

    # Of all conditions.

    async def _acknowledge(self, owner: ua.NodeId, event_id: ua.Variant, comment: ua.Variant) -> Answer:
        """Acknowledge (5.7.3)."""
        by, alarm = caller().name, self._nodes.condition_of(owner)
        if alarm is not None:
            return self._do(alarm, lambda now: alarm.acknowledge(event_id.Value, _text_of(comment), by, now))
        fault_id = self._fault(owner, event_id)
        if self._view.is_acknowledged(fault_id):
            raise Refusal(StatusCodes.BadConditionBranchAlreadyAcked, f"{fault_id} is acknowledged")
        if (said := _text_of(comment)) is not None:
            self._view.comment(fault_id, said, by, tell=False)
        self._scenarios.fault_reports.acknowledge(fault_id, by)
        return []

    async def _add_comment(self, owner: ua.NodeId, event_id: ua.Variant, comment: ua.Variant) -> Answer:
        """AddComment (5.5.6)."""
        by, alarm = caller().name, self._nodes.condition_of(owner)
        if alarm is not None:
            return self._do(alarm, lambda now: alarm.add_comment(event_id.Value, _text_of(comment), by, now))
        fault_id = self._fault(owner, event_id)
        if (said := _text_of(comment)) is not None:
            self._view.comment(fault_id, said, by, tell=True)
        return []

    async def _enable(self, owner: ua.NodeId) -> Answer:
        """Enable (5.5.4)."""
        alarm = self._nodes.condition_of(owner)
        if alarm is not None:
            _check_engineer()
            return self._do(alarm, alarm.enable)
        raise Refusal(StatusCodes.BadConditionAlreadyEnabled)

    async def _disable(self, owner: ua.NodeId) -> Answer:
        """Disable (5.5.5). A robot that gets no tasks must say so."""
        alarm = self._nodes.condition_of(owner)
        if alarm is not None:
            _check_engineer()
            return self._do(alarm, lambda _now: alarm.disable())
        raise Refusal(StatusCodes.BadNotSupported, "alarms of faults are always enabled")

    async def _refresh(self, _owner: ua.NodeId, subscription_id: ua.Variant, item: ua.Variant | None = None) -> Answer:
        """ConditionRefresh and ConditionRefresh2 (5.5.7, 5.5.8): to the caller's own subscription alone.

        Good says that it has begun. Its end waits for Publish requests, which this session may send after the answer.
        """
        number = int(subscription_id.Value)
        subscription: Any = self._server.iserver.subscription_service.subscriptions.get(number)
        if subscription is None or subscription.session is not current_session.get():
            raise Refusal(StatusCodes.BadSubscriptionIdInvalid)
        item_id = None if item is None else int(item.Value)
        if item_id is not None and subscription.items.get(item_id) is None:
            raise Refusal(StatusCodes.BadMonitoredItemIdInvalid)
        if subscription.has_backlog:
            raise Refusal(StatusCodes.BadRefreshInProgress)
        await subscription.tell_by_and_by(self._view.refresh(number, item_id, self._nodes.refresh), item_id)
        return []

    # Of alarms of values alone.

    async def _confirm(self, owner: ua.NodeId, event_id: ua.Variant, comment: ua.Variant) -> Answer:
        """Confirm (5.7.4)."""
        alarm, by = self._alarm(owner), caller().name
        return self._do(alarm, lambda now: alarm.confirm(event_id.Value, _text_of(comment), by, now))

    async def _suppress(self, owner: ua.NodeId, *, suppressed: bool) -> Answer:
        """Suppress and Unsuppress (5.8.5, 5.8.7)."""
        alarm = self._alarm(owner)
        return self._do(alarm, lambda _now: alarm.suppress(suppressed=suppressed))

    async def _shelve_for(self, owner: ua.NodeId, time_ms: ua.Variant) -> Answer:
        """TimedShelve (5.8.17.3)."""
        alarm = self._alarm(owner)
        return self._do(alarm, lambda now: alarm.shelve_for(float(time_ms.Value) / 1000, now))

    async def _shelve_once(self, owner: ua.NodeId) -> Answer:
        """OneShotShelve (5.8.17.4)."""
        alarm = self._alarm(owner)
        return self._do(alarm, alarm.shelve_once)

    async def _unshelve(self, owner: ua.NodeId) -> Answer:
        """Unshelve (5.8.17.2)."""
        alarm = self._alarm(owner)
        return self._do(alarm, lambda _now: alarm.unshelve())

    # Of dialogs.

    async def _respond(self, owner: ua.NodeId, selected: ua.Variant) -> Answer:
        """Respond (5.6.3)."""
        dialog = self._view.dialogs.dialog_of(owner) if self._view.dialogs is not None else None
        if dialog is None:
            raise Refusal(StatusCodes.BadNodeIdInvalid, "no dialog")
        if not dialog.active:
            raise Refusal(StatusCodes.BadDialogNotActive, f"{dialog.id} is answered")
        response = int(selected.Value)
        if not 0 <= response < len(dialog.options):
            raise Refusal(StatusCodes.BadDialogResponseInvalid, f"{dialog.id} has {len(dialog.options)} responses")
        option, by = dialog.options[response], caller().name
        is_carried, run_id = self._carried.has(dialog.run_id), dialog.run_id
        before, dialog.last_response = dialog.last_response, response
        try:
            if is_carried and dialog.decision_id:
                await said_by_bridges(partial(self._carried.confirm, run_id, dialog.decision_id, option, by))
            elif is_carried:
                await said_by_bridges(partial(self._carried.answer, run_id, dialog.step, option, by))
            elif dialog.decision_id:
                self._scenarios.decisions.confirm(dialog.decision_id, option, by)
            else:
                self._scenarios.runs.answer(run_id, dialog.step, option, by)
        except UaFleetError:
            dialog.last_response = before
            raise
        return []

    # Within.

    def _do(self, alarm: Condition, work: Callable[[float], object]) -> Answer:
        self._alarms.do(alarm, work)
        return []

    def _alarm(self, owner: ua.NodeId) -> Condition:
        alarm = self._nodes.condition_of(owner)
        if alarm is None:
            raise Refusal(StatusCodes.BadNotSupported, "faults of robots have no such Method")
        return alarm

    def _fault(self, owner: ua.NodeId, event_id: ua.Variant) -> str:
        identifier: Any = owner.Identifier
        fault_id = self._view.fault_of(NodeId(int(owner.NamespaceIndex), identifier))
        if fault_id is None:
            raise Refusal(StatusCodes.BadNodeIdInvalid, "no alarm")
        if not self._view.has_told(fault_id, event_id.Value or b""):
            raise Refusal(StatusCodes.BadEventIdUnknown, f"no event of {fault_id}")
        return fault_id


def _check_engineer() -> None:
    """Faults answer operators, too: that they are always enabled."""
    if not caller().role.covers(Role.ENGINEER):
        raise Refusal(StatusCodes.BadUserAccessDenied)


def _text_of(comment: ua.Variant) -> str | None:
    """A comment; None for a null, which leaves the one before."""
    value: Any = getattr(comment.Value, "Text", None)
    return None if value is None else str(value)[:MOST_COMMENT]
