"""Nodes of the standard: none without anything behind it, none that refers to one that has left."""

from __future__ import annotations

from typing import Any

import pytest
from asyncua.server.server import Server

from tests.standard_space import quick_start
from ua_fleet.endpoint.limits import EndpointLimits
from ua_fleet.endpoint.stack import AttributeIds, ObjectIds, ns0
from ua_fleet.endpoint.standard_model import (
    close_declarations,
    fill_pubsub,
    fill_standard_nodes,
    remove_unsupported,
)

POLICY = "http://opcfoundation.org/UA/SecurityPolicy#Basic256Sha256"


async def _space(*, key_service: bool) -> Any:
    with quick_start():
        server: Any = Server()
        await server.init()
    space = server.iserver.aspace
    remove_unsupported(space, key_service=key_service)
    fill_standard_nodes(space, EndpointLimits(), [POLICY])
    fill_pubsub(space, key_service=key_service)
    close_declarations(space)
    return space


@pytest.mark.parametrize("key_service", [False, True])
async def test_no_node_refers_to_one_that_has_left(key_service: bool) -> None:
    space = await _space(key_service=key_service)
    assert ns0(ObjectIds.Aliases) not in space
    assert ns0(ObjectIds.Server_ServerCapabilities_RoleSet_AddRole) not in space
    assert (ns0(ObjectIds.PublishSubscribe_GetSecurityKeys) in space) is key_service
    assert (ns0(ObjectIds.PublishSubscribe_SecurityGroups) in space) is key_service
    assert ns0(ObjectIds.PublishSubscribe_Status_State) in space
    assert ns0(ObjectIds.PublishSubscribe_Status_Enable) not in space
    assert ns0(ObjectIds.PublishSubscribe_AddConnection) not in space
    dangling = [
        (node_id.to_string(), reference.NodeId.to_string())
        for node_id in space.keys()  # noqa: SIM118 - an AddressSpace is no mapping
        for reference in space[node_id].references
        if reference.NodeId not in space
    ]
    assert dangling == []


async def test_a_declaration_without_a_value_cannot_be_read_and_a_type_without_a_default_has_none() -> None:
    space = await _space(key_service=False)

    def value(identifier: int, attribute: AttributeIds) -> Any:
        return space.read_attribute_value(ns0(identifier), attribute)

    declared = ObjectIds.ServerStatusType_SecondsTillShutdown
    assert value(declared, AttributeIds.AccessLevel).Value.Value == 0
    assert value(declared, AttributeIds.UserAccessLevel).Value.Value == 0
    arguments = ObjectIds.ServerType_GetMonitoredItems_InputArguments
    assert value(arguments, AttributeIds.AccessLevel).Value.Value == 1
    assert [argument.Name for argument in value(arguments, AttributeIds.Value).Value.Value] == ["SubscriptionId"]
    assert value(ObjectIds.BaseVariableType, AttributeIds.Value).StatusCode.name == "BadAttributeIdInvalid"
    support = ObjectIds.Server_ServerRedundancy_RedundancySupport
    assert value(support, AttributeIds.Value).Value.Value == 0
    profiles = value(ObjectIds.Server_ServerCapabilities_ServerProfileArray, AttributeIds.Value).Value.Value
    assert profiles[0].endswith("uatcp-uasc-uabinary")
    assert profiles[-1] == POLICY
