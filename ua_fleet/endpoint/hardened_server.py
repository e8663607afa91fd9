"""The OPC UA server that the fleet stands on: asyncua's address space behind our own, closed door."""

# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import structlog
from asyncua import ua
from asyncua.crypto import security_policies
from asyncua.server.server import Server

from ua_fleet.config.audit_schema import AuditConfig
from ua_fleet.config.schema import ServerConfig
from ua_fleet.endpoint.asyncua_internals import check_internals
from ua_fleet.endpoint.attributes import WRITE
from ua_fleet.endpoint.audit import AuditLog
from ua_fleet.endpoint.audit.log import LOG_FILE
from ua_fleet.endpoint.audit.syslog_message import parse_destination
from ua_fleet.endpoint.audit.syslog_sender import SyslogSender, tls_context
from ua_fleet.endpoint.bridge_trust import BridgeTrust
from ua_fleet.endpoint.certificates import ensure_application_certificate, load_certificate
from ua_fleet.endpoint.context import EndpointContext, NodeGate, Statistics
from ua_fleet.endpoint.diagnostics import Diagnostics
from ua_fleet.endpoint.kept_events import EventKeeper
from ua_fleet.endpoint.limits import CHUNK_BYTES, EndpointLimits
from ua_fleet.endpoint.listener import EndpointListener
from ua_fleet.endpoint.named_hosts import warn_of_missing_hosts
from ua_fleet.endpoint.node_builder import nodes_of, paused_collection, release_collection
from ua_fleet.endpoint.queues import Queues
from ua_fleet.endpoint.server_methods import ServerMethods
from ua_fleet.endpoint.services import Services
from ua_fleet.endpoint.session_keys import DAY_S, KEYS_FILE, SessionKeys
from ua_fleet.endpoint.stack import AttributeIds
from ua_fleet.endpoint.standard_model import (
    close_declarations,
    fill_pubsub,
    fill_standard_nodes,
    remove_unsupported,
)
from ua_fleet.endpoint.standard_nodes import share_attributes
from ua_fleet.endpoint.subscriptions import SubscriptionRegistry
from ua_fleet.endpoint.trust import TrustList
from ua_fleet.endpoint.users import USERS_FILE, Role, User, UserStore
from ua_fleet.errors import ServerStartError
from ua_fleet.printing import config_option
from ua_fleet.storage.files import make_private_folder
from ua_fleet.transport.addresses import host_and_port

__all__ = ["HardenedServer", "NodeGate", "create_server"]

_log = structlog.get_logger("ua_fleet.server")

_ENCRYPTED = [
    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
    ua.SecurityPolicyType.Aes128Sha256RsaOaep_SignAndEncrypt,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
]
_ACCESS = (AttributeIds.AccessLevel, AttributeIds.UserAccessLevel)
_POLICY_URIS = (
    security_policies.SecurityPolicyBasic256Sha256.URI,
    security_policies.SecurityPolicyAes128Sha256RsaOaep.URI,
    security_policies.SecurityPolicyAes256Sha256RsaPss.URI,
    security_policies.SecurityPolicyNone.URI,
)


class HardenedServer(Server):
    """asyncua's server with our own listener, sessions and services; made by `create_server`."""

    def __init__(self) -> None:
        super().__init__()
        self._context: EndpointContext | None = None
        self._listener: EndpointListener | None = None
        self._services: Services | None = None

    @property
    def context(self) -> EndpointContext:
        """What all connections share."""
        assert self._context is not None
        return self._context

    @property
    def gate(self) -> NodeGate | None:
        """The model behind the nodes; without one AccessLevel alone decides on writes."""
        return self.context.gate

    @gate.setter
    def gate(self, gate: NodeGate | None) -> None:
        self.context.gate = gate

    @property
    def statistics(self) -> Statistics:
        """Counters of what came through the door, and what did not."""
        return self.context.statistics

    @property
    def sessions(self) -> int:
        """Number of active sessions."""
        return self._services.sessions.active if self._services is not None else 0

    @property
    def port(self) -> int:
        """The port that is listened on."""
        return self._listener.port if self._listener is not None else self.endpoint.port or 0

    def require_role(self, method_id: ua.NodeId, role: Role) -> None:
        """Let only users of this role call a method; without it operators may."""
        self.context.method_rules[method_id] = lambda user: user.role.covers(role)

    def restrict_method(self, method_id: ua.NodeId, rule: Callable[[User], bool]) -> None:
        """Let only users that fit a rule call a method, and only over an encrypted channel."""
        self.context.method_rules[method_id] = rule
        self.context.encrypted_methods.add(method_id)

    @property
    def queues(self) -> Queues:
        """What waits for clients."""
        registry: Any = self.iserver.subscription_service
        queues: Queues = registry.queues
        return queues

    def keep_events(self, keeper: EventKeeper) -> None:
        """Have all events kept from now on."""
        registry: Any = self.iserver.subscription_service
        registry.keeper = keeper

    @property
    def events_left_out(self) -> int:
        """Events that were told and not kept, since one user had too many of them."""
        registry: Any = self.iserver.subscription_service
        keeper: EventKeeper | None = registry.keeper
        return 0 if keeper is None else keeper.left_out

    async def prepare(self, context: EndpointContext, host: str, port: int) -> None:
        """Put our services over asyncua's; `init` has been called."""
        self._context = context
        subscriptions = SubscriptionRegistry(self.iserver.aspace, self.iserver, context.misfit, context.limits)
        self.iserver.subscription_service = subscriptions
        # asyncua's own session was made before, with the registry that we replace.
        self.iserver.isession.subscription_service = subscriptions
        # Looked up when it happens: the process may have put its own in place of the context's.
        subscriptions.failed = lambda error, number: self.context.mistakes.caught(
            "subscriptions", error, subscription=number
        )
        self._services = Services(context, subscriptions)
        ServerMethods(subscriptions).link(self.iserver.aspace, context)
        self._listener = EndpointListener(self._services, host, port)
        sessions = self._services.session
        diagnostics = Diagnostics(self.iserver.aspace, context, self._services.sessions, subscriptions)
        diagnostics.build()
        sessions.activated, sessions.ended = diagnostics.add, diagnostics.remove
        subscriptions.created, subscriptions.ended = diagnostics.add_subscription, diagnostics.remove_subscription
        context.housekeeping.append(diagnostics.tell)
        await context.limits.advertise(self)
        _close_standard_nodes(self)

    async def start(self) -> None:
        """Listen, with endpoints that name the port that is really listened on."""
        assert self._listener is not None
        _warn(self.context)
        await self._listener.bind()
        self.endpoint = self.endpoint._replace(netloc=host_and_port(self.endpoint.hostname or "", self._listener.port))
        await self._setup_server_nodes()
        self.context.policies = self._policies
        await self.iserver.start()
        await self._listener.start()

    async def stop(self) -> None:
        """Close the door, then asyncua's inside."""
        if self._listener is not None:
            await self._listener.stop()
        if self._services is not None:
            await self._services.methods.close()
        clock = self.iserver.time_task
        if clock is not None:
            # asyncua would wait for its clock's next second.
            clock.cancel()
            await asyncio.wait([clock])
            self.iserver.time_task = None
        for subscription in list[Any](self.iserver.subscription_service.subscriptions.values()):
            await subscription.stop()
        await self.iserver.stop()
        self.context.audit.close()
        release_collection()


def _close_standard_nodes(server: Server) -> None:
    """Take the right to write from the nodes of the base namespace: nothing stands behind them."""
    for node_id, node in nodes_of(server.iserver.aspace).items():
        if node_id.NamespaceIndex != 0:
            continue
        for attribute in _ACCESS:
            held = node.attributes.get(attribute)
            variant = held.value.Value if held is not None and held.value is not None else None
            if held is not None and variant is not None and variant.Value and variant.Value & WRITE:
                held.value = ua.DataValue(ua.Variant(variant.Value & ~WRITE, ua.VariantType.Byte))


def _warn(context: EndpointContext) -> None:
    if context.allow_none_security:
        _log.warning(
            "endpoint without security is open: all traffic can be read and changed", setting="allow_none_security"
        )
    if context.allow_anonymous:
        _log.warning("clients are let in without a user, as observers", setting="allow_anonymous")
    if context.trust.trusts_all:
        _log.warning("every client certificate is accepted", setting="trust_all_clients")
    if context.bridges is not None and (unknown := context.bridges.unknown):
        _log.warning(
            "no certificate is trusted for some bridges, so they get no keys; "
            f"run: ua-fleet cert create --bridge NAME --trust{config_option()}, "
            f"or ua-fleet cert trust --bridge NAME FILE{config_option()}",
            bridges=", ".join(unknown),
        )
    if not context.users.list() and not context.allow_anonymous:
        _log.warning(
            f"no user exists yet; add a user with: ua-fleet user add NAME{config_option()}",
            file=str(context.users.path),
        )


def _audit_log(config: AuditConfig, state_dir: Path, files_dir: Path) -> AuditLog:
    """The audit log, with a copy at a syslog server if there is one; raises ServerStartError."""
    copy: SyslogSender | None = None
    if (syslog := config.syslog) is not None:
        try:
            to = parse_destination(syslog.url)
        except ValueError as error:
            raise ServerStartError(f"server.audit.syslog.url: {syslog.url}: {error}") from error
        names = (syslog.ca_file, syslog.certificate_file, syslog.key_file)
        ca_file, certificate_file, key_file = (files_dir / name if name is not None else None for name in names)
        copy = SyslogSender(to, tls_context(ca_file, certificate_file, key_file) if to.scheme == "tls" else None)
        if to.scheme in ("tcp", "udp"):
            _log.warning(
                "the audit log goes to syslog in plain text: it can be read and changed on the way", to=str(to)
            )
    try:
        return AuditLog(state_dir / LOG_FILE, max_bytes=config.max_file_bytes, backups=config.files - 1, copy=copy)
    except ServerStartError:
        if copy is not None:
            copy.close()
        raise


async def create_server(
    config: ServerConfig,
    state_dir: Path,
    *,
    application_uri: str,
    limits: EndpointLimits | None = None,
    users: UserStore | None = None,
    bridges: Mapping[str, str] | None = None,
    pushed_keys: bool = False,
    files_dir: Path | None = None,
) -> HardenedServer:
    """A server that is initialised and not started, with its certificates, users and limits in place.

    Args:
        config: the part `server` of `fleet.yaml`.
        state_dir: folder for users, certificates and the audit log.
        application_uri: the server's; its certificate carries it.
        limits: in place of those of the configuration.
        users: in place of the file in `state_dir`.
        bridges: names of bridges that may log in by a certificate, by their ApplicationUris.
        pushed_keys: whether a foreign key service pushes keys to it.
        files_dir: what paths in the configuration are relative to; `state_dir` if left out.

    Raises ServerStartError, in one line, for what must not be started.
    """
    check_internals()
    try:
        make_private_folder(state_dir)
    except OSError as error:
        raise ServerStartError(
            f"{state_dir}: cannot be made ({error.strerror}); set server.state_dir to a folder of this user"
        ) from error
    store = users or UserStore(state_dir / USERS_FILE)
    store.check()
    session_keys = SessionKeys(state_dir / KEYS_FILE, store, config.max_session_key_days * DAY_S)
    session_keys.check()
    files = ensure_application_certificate(state_dir, application_uri, [config.host])
    warn_of_missing_hosts(load_certificate(files.certificate), config.host)
    trust = TrustList(state_dir, trust_all=config.trust_all_clients, bridges=bridges)
    server = HardenedServer()
    server.name = "ua_fleet"
    server.manufacturer_name = "ua_fleet"
    server.product_uri = "urn:ua-fleet"
    server.application_type = ua.ApplicationType.Server
    with paused_collection():
        await server.init()
    await server.set_application_uri(application_uri)
    server.set_endpoint(f"opc.tcp://{host_and_port(config.host, config.port)}/{config.path}")
    await server.load_certificate(files.certificate)
    await server.load_private_key(files.private_key)
    server.allow_remote_admin(False)
    none = [ua.SecurityPolicyType.NoSecurity] if config.allow_none_security else []
    server.set_security_policy([*_ENCRYPTED, *none])
    anonymous = [ua.AnonymousIdentityToken] if config.allow_anonymous else []
    names = tuple((bridges or {}).values())
    certificate = [ua.X509IdentityToken] if names else []
    server.set_identity_tokens([ua.UserNameIdentityToken, *certificate, *anonymous])
    server.limits.max_recv_buffer = server.limits.max_send_buffer = CHUNK_BYTES
    context = EndpointContext(
        iserver=server.iserver,
        limits=limits or EndpointLimits.from_config(config),
        trust=trust,
        users=store,
        session_keys=session_keys,
        audit=_audit_log(config.audit, state_dir, files_dir or state_dir),
        private_key=server.iserver.private_key,
        allow_none_security=config.allow_none_security,
        allow_anonymous=config.allow_anonymous,
        server_id=application_uri,
        bridges=BridgeTrust(state_dir, names) if names else None,
    )
    space = server.iserver.aspace
    remove_unsupported(space, key_service=bridges is not None, pushed_keys=pushed_keys)
    fill_standard_nodes(space, context.limits, _POLICY_URIS[: None if config.allow_none_security else -1])
    fill_pubsub(space, key_service=bridges is not None, pushed_keys=pushed_keys)
    close_declarations(space)
    await server.prepare(context, config.host, config.port)
    share_attributes(nodes_of(space))
    return server
