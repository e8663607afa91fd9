# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
"""Keys of SecurityGroups from a key service over OPC UA, for a bridge that shows its own certificate."""

from __future__ import annotations

import asyncio
import math
from contextlib import AsyncExitStack
from typing import Any, Final, Self

from asyncua import ua
from asyncua.ua.status_codes import StatusCodes
from asyncua.ua.uaerrors import UaStatusCodeError

from ua_fleet.client.fleet_client import FleetClient
from ua_fleet.client.identity import ClientIdentity
from ua_fleet.errors import AccessRefused, KeySourceUnavailable, KeysRefused, TransportError, UaFleetError
from ua_fleet.printing import config_option
from ua_fleet.pubsub.security.keyring import GroupKeys
from ua_fleet.wire.security import SecurityPolicy

__all__ = ["ServiceKeySource"]

_PUBLISH_SUBSCRIBE: Final = "i=14443"
_GET_SECURITY_KEYS: Final = "i=15215"
"""Well-known NodeIds, the same in every key service (OPC 10000-14 8.3.2)."""

_CHANGES: Final = "ns=2;s=SecurityGroups.Changes"
"""Our own server's node that counts changes of keys before their time."""

_OF_GROUP: Final = (StatusCodes.BadNotFound, StatusCodes.BadNoMatch, StatusCodes.BadUserAccessDenied)
"""What a key service answers when it is well, and has no keys of this group for us."""
_NO_SERVICE: Final = (StatusCodes.BadNotImplemented, StatusCodes.BadMethodInvalid)
_NOT_KNOWN: Final = (
    StatusCodes.BadSecurityChecksFailed,
    StatusCodes.BadCertificateUntrusted,
    StatusCodes.BadIdentityTokenRejected,
    StatusCodes.BadIdentityTokenInvalid,
    StatusCodes.BadUserSignatureInvalid,
)
_SESSION_GONE: Final = (
    StatusCodes.BadSessionIdInvalid,
    StatusCodes.BadSessionClosed,
    StatusCodes.BadSessionNotActivated,
    StatusCodes.BadSecureChannelIdInvalid,
    StatusCodes.BadSecureChannelClosed,
)


class ServiceKeySource:
    """A KeySource over GetSecurityKeys. One connection is kept open, and made anew when it is lost.

    To be closed with `close`, or as an asynchronous context. May be used by one event loop only.
    """

    def __init__(self, endpoint: str, identity: ClientIdentity, bridge_name: str, *, timeout_s: float = 5.0) -> None:
        """Make a source, without connecting yet.

        Args:
            endpoint: URL of the key service.
            identity: the bridge's certificate, by which the service knows it, and the servers that it trusts.
            bridge_name: for what errors say.
            timeout_s: longest wait for any answer.
        """
        self._endpoint, self._identity, self._bridge_name = endpoint, identity, bridge_name
        self._timeout_s = timeout_s
        self._lock = asyncio.Lock()
        self._client: FleetClient | None = None
        self._changes: int | None = None
        """What the service's node `Changes` has said last."""
        self._generation = 0
        self._connection = AsyncExitStack()

    @property
    def refresh_s(self) -> float:
        """See KeySource: half of the KeyLifetime is often enough."""
        return math.inf

    @property
    def generation(self) -> int:
        """See KeySource: the service says so, or the connection was lost and it could not have said it."""
        return self._generation

    async def fetch(self, group_id: str, starting_token_id: int, count: int) -> GroupKeys:
        """See KeySource."""
        self._identity.tell_of_its_end()
        async with self._lock:
            try:
                if self._client is not None:
                    try:
                        return await self._ask(self._client, group_id, starting_token_id, count)
                    except UaFleetError as error:
                        if not _is_over(error):
                            raise
                        await self._disconnect()
                return await self._ask(await self._connected(), group_id, starting_token_id, count)
            except KeysRefused:
                raise
            except UaFleetError as error:
                if _is_over(error):
                    await self._disconnect()
                raise KeySourceUnavailable(self._explain(error)) from error
            except OSError as error:
                raise KeySourceUnavailable(
                    f"{self._identity.folder}: the bridge's certificate cannot be made or read ({error.strerror})"
                ) from error

    async def _connected(self) -> FleetClient:
        await self._identity.ensure()
        self._client = await self._connection.enter_async_context(
            FleetClient.connect(self._endpoint, identity=self._identity, as_application=True, timeout_s=self._timeout_s)
        )
        self._client.on_lost = self._lost
        try:
            await self._client.notify(_CHANGES, self._changed)
        except UaFleetError as error:
            if isinstance(error, TransportError):
                raise
            # Another product's key service: changes are heard of at half of the KeyLifetime.
        return self._client

    def _changed(self, value: Any) -> None:
        if self._changes is not None and value != self._changes:
            self._generation += 1
        self._changes = value

    def _lost(self) -> None:
        self._changes = None
        self._generation += 1

    async def _ask(self, client: FleetClient, group_id: str, starting_token_id: int, count: int) -> GroupKeys:
        try:
            answer = await client.call(
                _PUBLISH_SUBSCRIBE,
                _GET_SECURITY_KEYS,
                ua.Variant(group_id, ua.VariantType.String),
                ua.Variant(starting_token_id, ua.VariantType.UInt32),
                ua.Variant(count, ua.VariantType.UInt32),
            )
        except AccessRefused as error:
            if error.ua_status in _OF_GROUP:
                raise KeysRefused(group_id, self._refusal(error)) from error
            raise
        return self._read(group_id, answer)

    def _read(self, group_id: str, answer: list[Any]) -> GroupKeys:
        """What GetSecurityKeys has returned; raises KeysRefused for what no keys can be made of."""
        try:
            uri, first_token_id, keys, time_to_next_key_ms, lifetime_ms = answer
            policy = SecurityPolicy(uri)
            sound = keys and all(isinstance(key, bytes) and len(key) == policy.key_data_bytes for key in keys)
            times = (float(time_to_next_key_ms), float(lifetime_ms))
            if not sound or not 1 <= int(first_token_id) <= 0xFFFF_FFFF or not all(map(math.isfinite, times)):
                raise ValueError
        except (TypeError, ValueError):
            # Without the cause: it may show a key.
            raise KeysRefused(group_id, f"{self._endpoint} has answered with what are no keys of PubSub") from None
        return GroupKeys(
            policy=policy,
            first_token_id=int(first_token_id),
            keys=tuple(keys),
            # open62541's can be negative.
            time_to_next_key_s=max(times[0] / 1000, 0.0),
            key_lifetime_s=max(times[1] / 1000, 0.0),
        )

    def _refusal(self, error: AccessRefused) -> str:
        if error.ua_status == StatusCodes.BadUserAccessDenied:
            return f"bridge {self._bridge_name} may not have them; see `requestors` in the server's fleet.yaml"
        return (
            f"{self._endpoint} has no keys of such a group; give the server the same fleet.yaml, and restart it; with "
            "`source: pushed` its key service has to push them"
        )

    def _explain(self, error: UaFleetError) -> str:
        """Why there is no key service to ask now, and what to do about it."""
        told_by_server = isinstance(error.__cause__, UaStatusCodeError)
        if told_by_server and error.ua_status in _NO_SERVICE:
            return (
                f"{self._endpoint} is no key service; set `pubsub.security` and `pubsub.keys.source: service` in the "
                "server's fleet.yaml"
            )
        if told_by_server and error.ua_status in _NOT_KNOWN:
            name = self._bridge_name
            return (
                f"{self._endpoint} does not know bridge {name} by its certificate; on the server run: "
                f"ua-fleet cert trust --bridge {name} {self._identity.certificate}{config_option()}"
            )
        return str(error)

    async def _disconnect(self) -> None:
        if self._client is not None:
            self._client.on_lost = None
        connection, self._connection, self._client = self._connection, AsyncExitStack(), None
        await connection.aclose()

    async def close(self) -> None:
        """End the connection; a later `fetch` makes a new one."""
        async with self._lock:
            await self._disconnect()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_error: object) -> None:
        await self.close()


def _is_over(error: UaFleetError) -> bool:
    """Whether the connection is of no use any more: lost, or its session ended by the server."""
    return isinstance(error, TransportError) or error.ua_status in _SESSION_GONE
