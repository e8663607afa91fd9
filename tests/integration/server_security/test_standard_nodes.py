"""What the standard's own nodes say of this server, read by asyncua's client: all of these were Null and Good."""

from __future__ import annotations

from typing import Any

import pytest

from tests.integration.server_security.harness import Door, ua
from tests.integration.server_security.test_services import read

pytestmark = pytest.mark.asyncio(loop_scope="module")

CAPABILITIES = "Server_ServerCapabilities_"
STATUS = "Server_ServerStatus_"
VALUES: dict[str, Any] = {
    "Server_Auditing": True,
    "Server_ServerDiagnostics_EnabledFlag": True,
    "Server_ServerRedundancy_RedundancySupport": 0,
    f"{STATUS}SecondsTillShutdown": 0,
    f"{STATUS}ShutdownReason": ua.LocalizedText(""),
    f"{CAPABILITIES}MaxQueryContinuationPoints": 0,
    f"{CAPABILITIES}MaxHistoryContinuationPoints": 0,
    f"{CAPABILITIES}SoftwareCertificates": [],
}


def node(name: str) -> Any:
    return ua.NodeId(getattr(ua.ObjectIds, name))


@pytest.mark.parametrize("name", VALUES)
async def test_mandatory_variables_have_their_values(name: str, hardened: Door) -> None:
    async with hardened.connected("olga") as client:
        found = await read(client, node(name))
        assert (found.StatusCode.name, found.Value.Value) == ("Good", VALUES[name])


async def test_profiles_are_those_of_the_endpoints(hardened: Door) -> None:
    async with hardened.connected("olga") as client:
        profiles = (await read(client, node(f"{CAPABILITIES}ServerProfileArray"))).Value.Value
        offered = {endpoint.SecurityPolicyUri for endpoint in await client.get_endpoints()}
        assert offered == {profile for profile in profiles if "/SecurityPolicy#" in profile}
        assert "http://opcfoundation.org/UA-Profile/Transport/uatcp-uasc-uabinary" in profiles
        assert "en" in (await read(client, node(f"{CAPABILITIES}LocaleIdArray"))).Value.Value


async def test_the_status_says_the_same_as_its_parts(hardened: Door) -> None:
    async with hardened.connected("olga") as client:
        status = (await read(client, node("Server_ServerStatus"))).Value.Value
        for name in ("StartTime", "State", "SecondsTillShutdown"):
            assert (await read(client, node(f"{STATUS}{name}"))).Value.Value == getattr(status, name), name


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("BaseVariableType", "BadAttributeIdInvalid"),
        ("PropertyType", "BadAttributeIdInvalid"),
        ("DataItemType", "BadAttributeIdInvalid"),
        ("ServerStatusType_SecondsTillShutdown", "BadNotReadable"),
        ("ServerType_Auditing", "BadNotReadable"),
    ],
)
async def test_types_have_no_value_that_says_nothing(name: str, code: str, hardened: Door) -> None:
    """A VariableType without a default has no Value (OPC 10000-3 5.6.5), and a declaration without one is not read."""
    async with hardened.connected("olga") as client:
        found = await read(client, node(name))
        assert (found.StatusCode.name, found.Value.Value) == (code, None)
