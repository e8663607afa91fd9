# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""A typed OPC UA client for a fleet's server."""

from __future__ import annotations

import logging
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from datetime import datetime
from typing import Any, Final, Self, overload

from asyncua import Client, Node, ua
from asyncua.common.subscription import DataChangeNotif, Subscription
from asyncua.crypto import security_policies
from asyncua.crypto.uacrypto import CertProperties
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from cryptography.x509 import load_der_x509_certificate

from ua_fleet.client.all_events import EventInfo, all_events, past_events
from ua_fleet.client.attributes import NodeAttribute, read_attributes
from ua_fleet.client.batches import Batches
from ua_fleet.client.browsing import NodeInfo, browse_below
from ua_fleet.client.calls import call
from ua_fleet.client.conditions import (
    ConditionInfo,
    ConditionsKnown,
    DeclaredAlarm,
    conditions_told,
    declared_alarms,
)
from ua_fleet.client.convert import parse_value
from ua_fleet.client.details import ValueDetails, value_details
from ua_fleet.client.events import Told, told_by
from ua_fleet.client.finding import Finder, SelectedNode
from ua_fleet.client.history import HistoryWanted, read_history
from ua_fleet.client.identity import ClientIdentity, default_identity_folder
from ua_fleet.client.known_servers import Meeting, application_uri_of
from ua_fleet.client.model_changes import ModelChanges, model_changes
from ua_fleet.client.offers import OfferedSkill, offering
from ua_fleet.client.readings import Change, Changes, Reading, monitored_item, reading_of, with_fields
from ua_fleet.client.skill_nodes import SkillNode
from ua_fleet.client.skills import SkillCalls, SkillExecution, SkillInfo
from ua_fleet.client.structures import Structures
from ua_fleet.client.subscriptions import Subscriptions, subscribe
from ua_fleet.client.summaries import RobotSummary, SummariesChanged, read_summaries, watch_summaries
from ua_fleet.client.translated import NodeNotFound, quietly, translated
from ua_fleet.client.trends import Trend, read_trends
from ua_fleet.errors import AccessRefused, NotConnected, StorageUnavailable
from ua_fleet.values import StatusCode

__all__ = ["POLICIES", "AnotherServer", "Change", "FleetClient", "NodeInfo", "Reading"]

POLICIES: Final[dict[str, type[security_policies.SecurityPolicy]]] = {
    "Basic256Sha256": security_policies.SecurityPolicyBasic256Sha256,
    "Aes128Sha256RsaOaep": security_policies.SecurityPolicyAes128Sha256RsaOaep,
    "Aes256Sha256RsaPss": security_policies.SecurityPolicyAes256Sha256RsaPss,
}
"""Security policies by the end of their URI (OPC 10000-7)."""
_QUEUE: Final = 100_000
"""Changes that may wait for a slow consumer; then the oldest is dropped, and counted in `FleetClient.dropped`."""


class _Bell:
    """A subscription handler that calls a function with each value."""

    def __init__(self, heard: Callable[[Any], None]) -> None:
        self._heard = heard

    def datachange_notification(self, node: Node, val: Any, data: DataChangeNotif) -> None:
        """Called by asyncua with each change."""
        self._heard(val)

    def status_change_notification(self, status: ua.StatusChangeNotification) -> None:
        """Called by asyncua when the server ends the subscription; the connection's end says so too."""


class AnotherServer(AccessRefused):
    """Another server answers at an endpoint than the one that was meant."""

    remedy = "Log in to the server that answers now, or correct the endpoint."

    def __init__(self, endpoint: str, found: str, wanted: str) -> None:
        super().__init__(
            StatusCode.BAD_SECURITY_CHECKS_FAILED, f"another server answers at {endpoint}: {found}, not {wanted}"
        )


async def _ensured(identity: ClientIdentity) -> None:
    """Have the certificate and its key; an error of their folder is none of the server's."""
    try:
        await identity.ensure()
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise StorageUnavailable(
            f"{identity.certificate.parent}: the client's certificate cannot be kept there ({reason}); "
            "let this user write there, or name another folder (XDG_STATE_HOME; of a bridge: state_dir)"
        ) from error


class FleetClient:
    """A connected client; made by `FleetClient.connect`."""

    def __init__(self, client: Client, endpoint: str, *, meeting: Meeting, server_uri: str) -> None:
        self._client = client
        self.endpoint = endpoint
        self.server_uri = server_uri
        """ApplicationUri in the server's certificate; empty without security."""
        self.meeting = meeting
        """Whether the server's certificate was seen for the first time, and is trusted from now on."""
        self.on_lost: Callable[[], None] | None = None
        """Called when the connection is lost."""
        self._subscriptions = Subscriptions(client, endpoint)
        self.batches = Batches(client)
        """Browse and Read of many nodes; raises asyncua's errors."""
        self._structures = Structures(self.batches)
        self._finder = Finder(client, self.batches)
        self._node = self._finder.node
        self._skills = SkillCalls(client, self._node, self.batches, endpoint)
        client.connection_lost_callback = self._lost

    @property
    def dropped(self) -> int:
        """Changes, events and requests that `watch`, `told` and `offer_skill` dropped: nobody took them in time."""
        return self._subscriptions.dropped

    async def _lost(self, _error: Exception) -> None:
        self._subscriptions.lose()
        self._skills.lost()
        if self.on_lost is not None:
            self.on_lost()

    @classmethod
    @asynccontextmanager
    async def connect(
        cls,
        endpoint: str,
        *,
        user: str | None = None,
        password: str | None = None,
        identity: ClientIdentity | None = None,
        policy: str = "Basic256Sha256",
        insecure: bool = False,
        as_application: bool = False,
        server_uri: str = "",
        timeout_s: float = 10.0,
    ) -> AsyncGenerator[Self]:
        """Connect, signed and encrypted, and hand out the client.

        Args:
            endpoint: URL such as `opc.tcp://127.0.0.1:4840/ua_fleet`.
            user: user name; without it the client is anonymous, which most servers refuse.
            password: the user's password, or a session key of the user.
            identity: own certificate and known servers; by default those of this user of the machine.
            policy: security policy, one of POLICIES.
            insecure: neither sign nor encrypt, where the server allows that.
            as_application: log in by the identity's own certificate, as bridges do.
            server_uri: ApplicationUri of the server that may be given the password; empty: of any.
            timeout_s: longest wait for any answer.

        Raises:
            StorageUnavailable: the folder of the identity cannot be read or written.
            NotConnected: nobody answers there.
            SendTimeout: the server did not answer in time.
            AnotherServer: it has another ApplicationUri; it was not given the password.
            AccessRefused: the server refuses this client or user, or is not the server that it was.
        """
        # asyncua logs, some of it as critical, what is raised to us anyhow.
        logging.getLogger("asyncua").setLevel(logging.CRITICAL + 1)
        # asyncua's watchdog waits for an answer no longer than its interval: a busy server is not a lost one.
        client = Client(endpoint, timeout=timeout_s, watchdog_intervall=timeout_s)
        meeting, shown_uri = Meeting(is_first=False), ""
        if insecure and server_uri:
            raise AnotherServer(endpoint, "one that shows no certificate", server_uri)
        if not insecure:
            identity = identity or ClientIdentity(default_identity_folder())
            await _ensured(identity)
        with translated(endpoint):
            if identity is not None and not insecure:
                client.application_uri = identity.application_uri
                endpoints = await client.connect_and_get_server_endpoints()
                offer = _encrypted_endpoint(endpoint, endpoints, policy)
                shown_uri = application_uri_of(offer.ServerCertificate)
                if server_uri and shown_uri != server_uri:
                    raise AnotherServer(endpoint, shown_uri, server_uri)
                meeting = identity.check_server(endpoint, offer.ServerCertificate)
                # As bytes: asyncua's reading of files leaves them open when it is cancelled.
                await client.set_security(
                    POLICIES[policy],
                    CertProperties(identity.certificate.read_bytes()),
                    CertProperties(identity.key.read_bytes(), extension="pem"),
                    server_certificate=offer.ServerCertificate,
                    mode=ua.MessageSecurityMode.SignAndEncrypt,
                )
                if as_application:
                    _check_takes_certificates(endpoint, offer)
                    client.user_certificate = load_der_x509_certificate(identity.certificate.read_bytes())
                    client.user_private_key = load_pem_private_key(identity.key.read_bytes(), password=None)
            if user is not None:
                client.set_user(user)
                client.set_password(password or "")
            try:
                await client.connect()
            except BaseException:
                # asyncua leaves the socket open when it is cancelled.
                client.disconnect_socket()
                raise
        try:
            yield cls(client, endpoint, meeting=meeting, server_uri=shown_uri)
        finally:
            await _disconnect(client)

    async def browse(self, address: str = "Objects", *, depth: int = 1) -> list[NodeInfo]:
        """The nodes below a node, depth first, down to `depth` levels.

        Raises:
            NodeNotFound: there is no such node.
            NotConnected: the connection was lost.
        """
        with translated(self.endpoint):
            return await browse_below(self.batches, (await self._node(address)).nodeid, depth=depth)

    async def select(self, addresses: Sequence[str]) -> list[SelectedNode]:
        """The Variables that are meant, in the order of their addresses.

        Args:
            addresses: of Variables; of Objects, which stand for all Variables below them; names such as `rover` or
                `rover.battery` below the robots and bridges; and patterns of them, such as `rover.*.battery`.

        Raises:
            NodeNotFound: an address or a pattern stands for no Variable.
            NotConnected: the connection was lost.
        """
        with translated(self.endpoint):
            return await self._finder.select(addresses)

    async def details(self, node_ids: Sequence[str]) -> list[ValueDetails]:
        """Units of Variables, and the names that the values of enumerations have."""
        with translated(self.endpoint):
            return await value_details(self.batches, [ua.NodeId.from_string(one) for one in node_ids])

    @overload
    async def read(self, addresses: str) -> Reading: ...  # type: ignore[overload-overlap]  # a text is a sequence of texts too
    @overload
    async def read(self, addresses: Sequence[str]) -> list[Reading]: ...
    async def read(self, addresses: str | Sequence[str]) -> Reading | list[Reading]:
        """The value of a node, or those of some nodes in their order; one of Bad quality is a Reading too.

        Raises:
            NodeNotFound: there is no such node, or it has no value.
        """
        if isinstance(addresses, str):
            return (await self.read([addresses]))[0]
        with translated(self.endpoint):
            nodes = [await self._node(address) for address in addresses]
            values = await self.batches.read([node.nodeid for node in nodes])
            told = [reading_of(node.nodeid.to_string(), value) for node, value in zip(nodes, values, strict=True)]
            readings = [await with_fields(self._structures, reading) for reading in told]
        for address, reading in zip(addresses, readings, strict=True):
            if reading.status in (ua.StatusCodes.BadNodeIdUnknown, ua.StatusCodes.BadNodeIdInvalid):
                raise NodeNotFound(f"there is no node {address}; look with: ua-fleet browse")
            if reading.status == ua.StatusCodes.BadAttributeIdInvalid:
                raise NodeNotFound(f"{address} has no value; look below it with: ua-fleet browse {address}")
        return readings

    def history(self, node_id: str, wanted: HistoryWanted) -> AsyncGenerator[Reading]:
        """What the server has kept of a node's value; raises as `read_history`."""
        return read_history(self._client, self.endpoint, node_id, wanted)

    async def trends(self, node_ids: Sequence[str], since: datetime, until: datetime, most: int) -> dict[str, Trend]:
        """The courses of numbers that have a history, each in at most `most` points; raises as `read_trends`."""
        return await read_trends(self._client, self.endpoint, node_ids, since, until, most)

    async def attributes(self, address: str) -> list[NodeAttribute]:
        """All attributes of a node but its value; NodeNotFound where there is no such node."""
        with translated(self.endpoint):
            found = await read_attributes(self._client, (await self._node(address)).nodeid)
        if not found:
            raise NodeNotFound(f"there is no node {address}; look with: ua-fleet browse")
        return found

    async def write(self, address: str, text: str) -> Reading:
        """Write a value given as text, in the node's own type; the node's value after that.

        Raises:
            AccessRefused: the text is no such value, or the server refuses it.
        """
        with translated(self.endpoint, f"write {address}: "):
            node = await self._node(address)
            kind = await node.read_data_type_as_variant_type()
            array = (await node.read_value_rank()) >= ua.ValueRank.OneOrMoreDimensions
            value = parse_value(text, kind, array=array)
            # Without a time of ours: the server's is the one that counts.
            await node.write_attribute(ua.AttributeIds.Value, ua.DataValue(value))
        return await self.read(address)

    async def call(self, object_id: str, method_id: str, *arguments: ua.Variant) -> list[Any]:
        """Call a Method of an Object; its output arguments.

        Raises:
            AccessRefused: the server refuses the call; `ua_status` says why, and the text where the server has one.
            NotConnected: the connection was lost.
        """
        with translated(self.endpoint):
            request = ua.CallMethodRequest(
                ua.NodeId.from_string(object_id), ua.NodeId.from_string(method_id), list(arguments)
            )
            outputs = await call(self._client, request)
        return [variant.Value for variant in outputs]

    async def executable(self, method_ids: Sequence[str]) -> list[bool]:
        """Whether this user may call Methods; False for what is none."""
        with translated(self.endpoint):
            nodes = [ua.NodeId.from_string(one) for one in method_ids]
            told = await self.batches.read(nodes, ua.AttributeIds.UserExecutable)
        return [data.Value is not None and data.Value.Value is True for data in told]

    @property
    def server_certificate(self) -> bytes | None:
        """The certificate that the server shows, DER; None on a connection without security."""
        certificate = self._client.security_policy.peer_certificate
        return bytes(certificate) if certificate else None

    async def robots(self) -> dict[str, ua.NodeId]:
        """The nodes of all robots, by their names."""
        with translated(self.endpoint):
            return await self._finder.robots()

    async def summaries(self) -> list[RobotSummary]:
        """How all robots stand, in few requests and in the order of the server.

        Raises:
            NodeNotFound: the server is of a version without summaries.
            NotConnected: the connection was lost.
        """
        with translated(self.endpoint):
            return await read_summaries(self.batches)

    def watch_summaries(self, *, robot: str = "", period_ms: float = 500.0) -> AsyncGenerator[SummariesChanged]:
        """How all robots stand, a hundred together, then what changes, until the iteration is closed.

        The server tells of each robot once a second at most. Robots that come while it is watched are told too; a slow
        consumer gets the newest of each robot.

        Args:
            robot: tell this one alone, and watch no more than the Variable that it stands in.
            period_ms: publishing interval.

        Raises:
            NodeNotFound: the server is of a version without summaries; or there is no such robot, or no longer.
            NotConnected: the connection was lost.
        """
        return watch_summaries(self.batches, self._subscriptions, self.endpoint, period_ms, robot)

    async def skill_nodes(self) -> list[SkillNode]:
        """Where the skills of all robots stand."""
        return await self._skills.nodes_of(await self.robots())

    async def skills(self, robot: str | None = None) -> list[SkillInfo]:
        """The skills of a robot, or of all, with their arguments. NodeNotFound where there is no such robot."""
        if robot is None:
            return await self._skills.all_at(await self.skill_nodes())
        return await self._skills.all_of(robot)

    async def start_skill(self, robot: str, skill: str, /, **arguments: Any) -> SkillExecution:
        """Have a robot begin a skill, and go on at once.

        Args:
            robot: its name.
            skill: its name.
            arguments: by name, in the declared units; what has a default may be left out.

        Raises:
            NodeNotFound: there is no such robot or skill.
            SkillRejected: an argument is wrong, or the skill cannot be begun now; `ua_status` says why.
            RobotOffline: the robot is not heard.
            AccessRefused: this user may not command.
            NotConnected: the connection was lost.
        """
        return await self._skills.start(robot, skill, arguments)

    async def call_skill(
        self, robot: str, skill: str, /, *, timeout_s: float | None = None, **arguments: Any
    ) -> dict[str, Any]:
        """Have a robot do a skill, and wait for its results, by name.

        Args:
            robot: its name.
            skill: its name.
            timeout_s: longest wait; without it until the skill has ended, or was stopped because it took too long.
            arguments: as for `start_skill`.

        Raises:
            SkillFailed: it was begun, and did not succeed; with an Uncertain `ua_status` nobody knows.
            SkillTimeout: it did not end in time. The robot goes on.
            UaFleetError: what `start_skill` raises.
        """
        execution = await self.start_skill(robot, skill, **arguments)
        return await execution.result(timeout_s=timeout_s or execution.longest_wait_s)

    async def halt_skill(self, robot: str, skill: str) -> None:
        """Have a robot stop all that it does for a skill. How it ends is told as ever.

        Raises:
            NodeNotFound: there is no such robot or skill.
            SkillRejected: it is not under way, or the robot has no way to do that; `ua_status` says which.
            RobotOffline: the robot is not heard.
            AccessRefused: this user may not command.
            NotConnected: the connection was lost.
        """
        await self._skills.control(robot, skill, "Halt")

    async def suspend_skill(self, robot: str, skill: str) -> None:
        """Have a robot stand in the middle of what it does for a skill; its time goes on. Raises as `halt_skill`."""
        await self._skills.control(robot, skill, "Suspend")

    async def resume_skill(self, robot: str, skill: str) -> None:
        """Have a robot go on with the skill in which it stands. Raises as `halt_skill`."""
        await self._skills.control(robot, skill, "Resume")

    def offer_skill(
        self, robot: str, skill: str, definition: str | Mapping[str, Any] = ""
    ) -> AbstractAsyncContextManager[OfferedSkill]:
        """Do a skill from now on, as long as the context lasts; what is asked for is iterated, or served.

        Args:
            robot: the robot that this client stands for; it is made where there is none.
            skill: name of the skill.
            definition: the skill as in `fleet.yaml`, which needs an engineer where it is new; empty: as it is known.

        Raises:
            RobotInvalid: all mistakes of the definition, with their lines.
            NotDone: there is no such skill, or it is one of a robot behind a bridge.
            AccessRefused: this user may not offer it.
            NotConnected: the connection was lost.
        """
        return offering(self, self._client, self._subscriptions, robot, skill, definition)

    async def notify(self, address: str, heard: Callable[[Any], None], *, period_ms: float = 250.0) -> None:
        """Call a function with a node's value now, and whenever it changes, as long as the connection lasts.

        Raises:
            NodeNotFound: there is no such node.
            NotConnected: the connection was lost.
        """
        with translated(self.endpoint):
            node = await self._node(address)
            await subscribe(self._client, _Bell(heard), period_ms, lambda made: made.subscribe_data_change(node))

    def told(self) -> AbstractAsyncContextManager[AsyncIterator[Told]]:
        """What the server tells of runs, steps, decisions and faults, while the context lasts.

        All that happens once the context has been entered is told. The iterator raises NotConnected when the connection
        is lost.
        """
        return told_by(self._client, self.endpoint, self._subscriptions)

    def events(self) -> AbstractAsyncContextManager[AsyncIterator[EventInfo]]:
        """All events of the server that this user may see, while the context lasts.

        The iterator raises NotConnected when the connection is lost.
        """
        return all_events(self._client, self.batches, self.endpoint, self._subscriptions)

    async def past_events(self, since: datetime, until: datetime, most: int) -> list[EventInfo]:
        """Events that the server has kept, the newest first and at most `most`; raises as `past_events`."""
        return await past_events(self._client, self.batches, self.endpoint, since, until, most)

    def conditions(self) -> AbstractAsyncContextManager[AsyncIterator[ConditionInfo | ConditionsKnown]]:
        """Alarms, faults and dialogs: those there are, a ConditionsKnown, then each change, while the context lasts.

        The iterator raises NotConnected when the connection is lost.
        """
        return conditions_told(self._client, self.batches, self.endpoint, self._subscriptions)

    async def declared_alarms(self) -> list[DeclaredAlarm]:
        """All alarms that there are, whatever their state; raises as `declared_alarms`."""
        return await declared_alarms(self.batches, self.endpoint)

    def model_changes(self, *, period_ms: float = 250.0) -> AbstractAsyncContextManager[ModelChanges]:
        """That nodes have come or gone, while the context lasts: await `wait()` of what is entered."""
        return model_changes(self.endpoint, self._subscriptions, period_ms)

    async def watch(
        self,
        addresses: Sequence[str],
        *,
        period_ms: float = 100.0,
        with_times: bool = False,
        newest_only: bool = False,
    ) -> AsyncGenerator[Change]:
        """The current values of some nodes, then each change, until the iteration is closed.

        Args:
            addresses: of the nodes.
            period_ms: publishing interval.
            with_times: whether a value counts as changed where its SourceTimestamp alone is another.
            newest_only: tell nothing but the last of what changes within a period, as of images.

        Raises:
            NodeNotFound: one of the nodes does not exist.
            NotConnected: the connection was lost.
        """
        changes = Changes(_QUEUE)
        with translated(self.endpoint):
            nodes = [await self._node(address) for address in addresses]

        async def begin(subscription: Subscription) -> None:
            at_once = await self.batches.monitored_items_at_once()
            for at in range(0, len(nodes), at_once):
                part = nodes[at : at + at_once]
                items = [
                    monitored_item(node.nodeid, at + place, with_times, newest_only=newest_only)
                    for place, node in enumerate(part)
                ]
                results = await subscription.create_monitored_items(items)
                for address, result in zip(addresses[at:], results, strict=False):
                    if isinstance(result, ua.StatusCode):
                        raise NodeNotFound(f"{address} cannot be watched: {result.name}; look with: ua-fleet browse")

        async with self._subscriptions.open(changes, period_ms, begin):
            while (change := await changes.next()) is not None:
                with translated(self.endpoint):
                    change = await with_fields(self._structures, change)
                yield change
            raise NotConnected(f"the connection to {self.endpoint} was lost")


def _encrypted_endpoint(
    endpoint: str, endpoints: Sequence[ua.EndpointDescription], policy: str
) -> ua.EndpointDescription:
    wanted = POLICIES[policy].URI
    for offer in endpoints:
        if offer.SecurityPolicyUri == wanted and offer.SecurityMode == ua.MessageSecurityMode.SignAndEncrypt:
            return offer
    there = ", ".join(
        sorted({offer.SecurityPolicyUri.rpartition("#")[2] for offer in endpoints if offer.SecurityPolicyUri})
    )
    raise AccessRefused(
        StatusCode.BAD_SECURITY_CHECKS_FAILED,
        f"{endpoint} offers no endpoint with {policy}, Sign & Encrypt, but: {there or 'nothing'}; "
        "choose another --policy, or --insecure for None",
    )


def _check_takes_certificates(endpoint: str, offer: ua.EndpointDescription) -> None:
    if all(policy.TokenType != ua.UserTokenType.Certificate for policy in offer.UserIdentityTokens or ()):
        raise AccessRefused(
            StatusCode.BAD_IDENTITY_TOKEN_REJECTED,
            f"{endpoint} accepts no login by certificate, so it is no key service; set `pubsub.security` and "
            "`pubsub.keys.source: service` in the server's fleet.yaml",
        )


async def _disconnect(client: Client) -> None:
    await quietly(client.disconnect())
