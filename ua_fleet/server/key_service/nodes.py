"""The key service in the address space: SecurityGroups below PublishSubscribe, and the standard Methods.

PublishSubscribe (i=14443)
  GetSecurityKeys (i=15215), GetSecurityGroup (i=15440)
  SetSecurityKeys (i=17364)     where the keys are made elsewhere; then there are no Objects of groups
  SecurityGroups (i=15443)
    <group> : SecurityGroupType    SecurityGroupId, KeyLifetime, SecurityPolicyUri, MaxFutureKeyCount, MaxPastKeyCount,
                                   InvalidateKeys, ForceKeyRotation
    Changes : UInt32               ours: counts calls of these two, so that bridges hear of new keys at once

The two Methods of a group are the Nodes of its type, which all groups refer to (OPC 10000-3 6.4.4.2 lets instances
share them); the object that they are called on says which group is meant.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final

from asyncua import ua

from ua_fleet.endpoint.convert import data_value, raw_id
from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.endpoint.node_builder import HAS_COMPONENT, HAS_PROPERTY, NodeBuilder
from ua_fleet.endpoint.stack import AttributeIds, ObjectIds, Refusal, StatusCodes, ns0
from ua_fleet.endpoint.users import Role, User, current_user
from ua_fleet.server.key_service.pushed import Push
from ua_fleet.server.key_service.service import KeyService
from ua_fleet.values import BuiltinType, QualifiedName

__all__ = ["KeyServiceNodes"]

_GET_KEYS: Final = ns0(ObjectIds.PublishSubscribe_GetSecurityKeys)
_SET_KEYS: Final = ns0(ObjectIds.PublishSubscribe_SetSecurityKeys)
_GET_GROUP: Final = ns0(ObjectIds.PublishSubscribe_GetSecurityGroup)
_GROUPS: Final = ns0(ObjectIds.PublishSubscribe_SecurityGroups)
_GROUP_TYPE: Final = ns0(ObjectIds.SecurityGroupType)
_INVALIDATE: Final = ns0(ObjectIds.SecurityGroupType_InvalidateKeys)
_ROTATE: Final = ns0(ObjectIds.SecurityGroupType_ForceKeyRotation)
_PROPERTY_TYPE: Final = ns0(ObjectIds.PropertyType)
_DURATION: Final = ns0(ObjectIds.Duration)


class KeyServiceNodes:
    """Makes the nodes, and answers the Methods. They work in threads, since they may have to wait for the disk."""

    def __init__(self, server: HardenedServer, service: KeyService, namespace: int) -> None:
        """Prepare the nodes of a service.

        Args:
            server: not started yet.
            service: whose groups they are.
            namespace: index of the namespace that the groups' NodeIds are in.
        """
        self._server, self._service, self._namespace = server, service, namespace
        self._groups: dict[ua.NodeId, str] = {}
        self._changes = raw_id("SecurityGroups.Changes", namespace)

    async def build(self) -> None:
        """Make the nodes and let the Methods be called."""
        builder = NodeBuilder(self._server.iserver.aspace)
        methods: list[tuple[ua.NodeId, Callable[..., Any], Callable[[User], bool]]] = [
            (_GET_KEYS, self._get_keys, _is_bridge),
            (_GET_GROUP, self._get_group, _is_bridge_or_engineer),
        ]
        if self._service.pushed_by is None:
            for group_id in self._service.group_ids:
                self._add_group(builder, group_id)
            methods.append((_INVALIDATE, partial(self._change, self._service.invalidate), _is_engineer))
            methods.append((_ROTATE, partial(self._change, self._service.rotate), _is_engineer))
        else:
            methods.append((_SET_KEYS, self._set_keys, self._may_push))
        self._add_changes(builder)
        for method_id, call, rule in methods:
            self._server.link_method(self._server.get_node(method_id), call)
            self._server.restrict_method(method_id, rule)
        self._server.context.secret_methods.add(_GET_KEYS)

    def _add_changes(self, builder: NodeBuilder) -> None:
        builder.add_variable(
            self._changes,
            QualifiedName(self._namespace, "Changes"),
            _GROUPS,
            ns0(ObjectIds.BaseDataVariableType),
            data_type=raw_id(int(BuiltinType.UINT32)),
            value=self._count(),
        )

    def _count(self) -> ua.DataValue:
        now: Any = datetime.now(UTC)
        return data_value(int(BuiltinType.UINT32), self._service.changes, 0, now, now)

    def _add_group(self, builder: NodeBuilder, group_id: str) -> None:
        node = raw_id(f"SecurityGroups.{group_id}", self._namespace)
        self._groups[node] = group_id
        builder.add_object(node, QualifiedName(self._namespace, group_id), _GROUPS, _GROUP_TYPE)
        settings = self._service.settings(group_id)
        now: Any = datetime.now(UTC)
        for name, kind, data_type, value in (
            ("SecurityGroupId", BuiltinType.STRING, None, group_id),
            ("KeyLifetime", BuiltinType.DOUBLE, _DURATION, settings.lifetime_s * 1000),
            ("SecurityPolicyUri", BuiltinType.STRING, None, settings.policy.value),
            ("MaxFutureKeyCount", BuiltinType.UINT32, None, settings.max_future_keys),
            ("MaxPastKeyCount", BuiltinType.UINT32, None, settings.max_past_keys),
        ):
            builder.add_variable(
                raw_id(f"SecurityGroups.{group_id}.{name}", self._namespace),
                QualifiedName(0, name),
                node,
                _PROPERTY_TYPE,
                data_type=data_type or raw_id(int(kind)),
                value=data_value(int(kind), value, 0, now, now),
                reference=HAS_PROPERTY,
            )
        for method_id in (_INVALIDATE, _ROTATE):
            builder.add_reference(node, HAS_COMPONENT, method_id)

    def _get_keys(self, _parent: ua.NodeId, group: Any, starting: Any, count: Any) -> list[ua.Variant]:
        """GetSecurityKeys (OPC 10000-14 8.3.2)."""
        keys = self._service.keys_for_bridge(_caller().bridge, group.Value or "", int(starting.Value), int(count.Value))
        return [
            ua.Variant(keys.policy.value, ua.VariantType.String),
            ua.Variant(keys.first_token_id, ua.VariantType.UInt32),
            ua.Variant(list(keys.keys), ua.VariantType.ByteString),
            ua.Variant(keys.time_to_next_key_s * 1000, ua.VariantType.Double),
            ua.Variant(keys.key_lifetime_s * 1000, ua.VariantType.Double),
        ]

    def _get_group(self, _parent: ua.NodeId, group: Any) -> list[ua.Variant]:
        """GetSecurityGroup (OPC 10000-14 8.3.3)."""
        group_id = group.Value or ""
        if raw_id(f"SecurityGroups.{group_id}", self._namespace) not in self._groups:
            raise Refusal(StatusCodes.BadNoMatch)
        user = _caller()
        if user.bridge and not self._service.access.bridge_may(user.bridge, group_id):
            raise Refusal(StatusCodes.BadUserAccessDenied)
        return [ua.Variant(raw_id(f"SecurityGroups.{group_id}", self._namespace), ua.VariantType.NodeId)]

    async def _change(self, change: Callable[[str], None], parent: ua.NodeId) -> list[ua.Variant]:
        """InvalidateKeys or ForceKeyRotation (OPC 10000-14 8.4.2 and 8.4.3)."""
        group_id = self._groups.get(parent)
        if group_id is None:
            # The type has the Methods too, but no keys.
            raise Refusal(StatusCodes.BadNodeIdInvalid, "no SecurityGroup")
        await asyncio.to_thread(change, group_id)
        await self._tell_of_change()
        return []

    async def _set_keys(self, _parent: ua.NodeId, *arguments: Any) -> list[ua.Variant]:
        """SetSecurityKeys (OPC 10000-14 9.1.3.3)."""
        group, policy, token, current, future, time_to_next_ms, lifetime_ms = [given.Value for given in arguments]
        push = Push(
            group or "",
            policy or "",
            int(token),
            (current, *(future or ())),
            time_to_next_ms / 1000,
            lifetime_ms / 1000,
        )
        await asyncio.to_thread(self._service.push, push)
        await self._tell_of_change()
        return []

    def _may_push(self, user: User) -> bool:
        return not user.bridge and not user.anonymous and user.name == self._service.pushed_by

    async def _tell_of_change(self) -> None:
        await self._server.iserver.aspace.write_attribute_value(self._changes, AttributeIds.Value, self._count())


def _caller() -> User:
    user = current_user.get()
    assert user is not None
    return user


def _is_bridge(user: User) -> bool:
    return bool(user.bridge)


def _is_engineer(user: User) -> bool:
    return user.role.covers(Role.ENGINEER)


def _is_bridge_or_engineer(user: User) -> bool:
    return _is_bridge(user) or _is_engineer(user)
