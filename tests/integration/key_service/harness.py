"""A real server with a key service, people and bridges, and clients that show any certificate they like."""

from __future__ import annotations

import contextlib
import importlib
import json
import shutil
from collections.abc import AsyncGenerator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

from asyncua.client.client import Client as AsyncuaClient
from asyncua.crypto import security_policies

from tests.integration.server_security.harness import CHEAP, Identities, make_certificate
from tests.standard_space import quick_start
from tests.unit.server.key_service.fleet import fleet
from ua_fleet.client.identity import ClientIdentity
from ua_fleet.config.schema import FleetConfig
from ua_fleet.endpoint.certificates import CertificateFiles, own_files, trust, trust_bridge
from ua_fleet.endpoint.hardened_server import HardenedServer, create_server
from ua_fleet.endpoint.limits import EndpointLimits
from ua_fleet.endpoint.users import Role, UserStore
from ua_fleet.pubsub.application import bridge_application_uri
from ua_fleet.server.key_service.nodes import KeyServiceNodes
from ua_fleet.server.key_service.service import KeyService

# asyncua declares UInt32 where it takes an int; tests use it without types.
ua: Any = importlib.import_module("asyncua.ua")
Client: TypeAlias = Any

SERVER_URI: Final = "urn:test:ua-fleet"
PASSWORDS: Final = {"olga": "observe-1", "oscar": "operate-1", "eva": "engineer-1"}
ROLES: Final = {"olga": Role.OBSERVER, "oscar": Role.OPERATOR, "eva": Role.ENGINEER}
BRIDGES: Final = ("arm", "rover", "plc")
BASIC256SHA256: Final[Any] = security_policies.SecurityPolicyBasic256Sha256
AES128: Final[Any] = security_policies.SecurityPolicyAes128Sha256RsaOaep
AES256: Final[Any] = security_policies.SecurityPolicyAes256Sha256RsaPss
ENCRYPTED: Final = ua.MessageSecurityMode.SignAndEncrypt

PUBLISH_SUBSCRIBE: Final = "i=14443"
GET_KEYS: Final = "i=15215"
GET_GROUP: Final = "i=15440"
GROUPS: Final = "i=15443"
INVALIDATE: Final = "i=25624"
ROTATE: Final = "i=25625"


class Cards:
    """Certificates of bridges and strangers, each made once in a test run."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.identities = Identities(folder)

    def uri(self, name: str) -> str:
        return f"urn:ua-fleet:Fleet:bridge:{name}"

    def get(self, name: str, **options: Any) -> CertificateFiles:
        files = CertificateFiles(self.folder / f"{name}.der", self.folder / f"{name}-key.pem")
        if not files.certificate.exists():
            make_certificate(self.folder, name, uri=self.uri(name), **options)
        return files

    def identity(self, name: str, folder: Path) -> ClientIdentity:
        """The same certificate as a bridge has it in its own folder."""
        identity = ClientIdentity.of_bridge(folder, "Fleet", name)
        folder.mkdir(parents=True, exist_ok=True)
        files = self.get(name)
        shutil.copy(files.certificate, identity.certificate)
        shutil.copy(files.private_key, identity.key)
        identity.key.chmod(0o600)
        return identity


@dataclass
class Desk:
    """A running server with a key service."""

    server: HardenedServer
    service: KeyService
    state_dir: Path
    cards: Cards

    @property
    def url(self) -> str:
        return f"opc.tcp://127.0.0.1:{self.server.port}/ua_fleet"

    def audit_text(self) -> str:
        return (self.state_dir / "audit.log").read_text()

    def audit(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.audit_text().splitlines()]

    def group(self, group_id: str) -> str:
        return f"ns=2;s=SecurityGroups.{group_id}"

    async def client(
        self,
        *,
        card: str = "arm",
        user: str | None = None,
        certificate_login: bool = True,
        policy: Any = BASIC256SHA256,
        mode: Any = ENCRYPTED,
    ) -> Client:
        """A client, not connected: a person with `user`, else the bridge whose card it is."""
        client: Client = AsyncuaClient(self.url, timeout=60, watchdog_intervall=60)
        client.application_uri = self.cards.uri(card)
        files = self.cards.get(card)
        if policy is not None:
            server = own_files(self.state_dir).certificate
            await client.set_security(
                policy, files.certificate, files.private_key, server_certificate=str(server), mode=mode
            )
        if user is not None:
            client.set_user(user)
            client.set_password(PASSWORDS[user])
        elif certificate_login:
            await client.load_client_certificate(files.certificate)
            await client.load_private_key(files.private_key)
        return client

    @contextlib.asynccontextmanager
    async def connected(self, **options: Any) -> AsyncGenerator[Client]:
        client = await self.client(**options)
        async with client:
            yield client


async def call(client: Client, target: str, method: str, *arguments: Any) -> Any:
    """Call a Method; its CallMethodResult, good or bad."""
    request = ua.CallMethodRequest(ua.NodeId.from_string(target), ua.NodeId.from_string(method), list(arguments))
    (result,) = await client.uaclient.call([request])
    return result


def string(value: str) -> Any:
    return ua.Variant(value, ua.VariantType.String)


def uint32(value: int) -> Any:
    return ua.Variant(value, ua.VariantType.UInt32)


async def get_keys(client: Client, group: str, start: int = 0, count: int = 5) -> Any:
    """GetSecurityKeys; its CallMethodResult, good or bad."""
    return await call(client, PUBLISH_SUBSCRIBE, GET_KEYS, string(group), uint32(start), uint32(count))


def name(result: Any) -> str:
    return str(result.StatusCode.name)


def _act(_parent: Any) -> list[Any]:
    return []


@contextlib.asynccontextmanager
async def desk(
    folder: Path,
    cards: Cards,
    *,
    config: FleetConfig | None = None,
    port: int = 0,
    policies: list[Any] | None = None,
    **server_config: Any,
) -> AsyncGenerator[Desk]:
    """A running server that knows three people, three bridges and a client called `visitor`."""
    config = config or fleet()
    state_dir = folder / "state"
    if not state_dir.exists():
        cards.identities.install_server(state_dir)
        users = UserStore(state_dir / "users.yaml", CHEAP)
        for person, password in PASSWORDS.items():
            users.add(person, password, ROLES[person])
        for bridge in BRIDGES:
            trust_bridge(state_dir, bridge, cards.get(bridge).certificate)
        trust(state_dir, cards.get("visitor").certificate)
    with quick_start():
        server = await create_server(
            config.server.model_copy(update={"port": port, **server_config}),
            state_dir,
            application_uri=SERVER_URI,
            limits=EndpointLimits(tick_s=0.02),
            users=UserStore(state_dir / "users.yaml", CHEAP),
            bridges={bridge_application_uri(config.fleet.name, name): name for name in config.bridges},
            pushed_keys=config.pubsub.keys.pushed_by is not None,
        )
    if policies is not None:
        server.set_security_policy(policies)
    assert await server.register_namespace("urn:test:fleet") == 2
    goal = await server.nodes.objects.add_variable(ua.NodeId("goal", 2), "goal", 0.0)
    await goal.set_writable()
    await server.nodes.objects.add_method(ua.NodeId("act", 2), "act", _act, [], [])
    service = KeyService(config, state_dir)
    await KeyServiceNodes(server, service, 2).build()
    async with server:
        yield Desk(server, service, state_dir, cards)
