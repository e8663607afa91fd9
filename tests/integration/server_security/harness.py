"""A hardened server, a stock asyncua server with the same nodes, and clients that do not keep to the rules."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import json
import shutil
from collections.abc import AsyncGenerator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final, TypeAlias

from asyncua.client.client import Client as AsyncuaClient
from asyncua.common.methods import uamethod
from asyncua.crypto import security_policies
from asyncua.server.server import Server
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from tests.standard_space import quick_start
from ua_fleet.config.schema import ServerConfig
from ua_fleet.endpoint.certificates import CertificateFiles, create_certificate, own_files, trust
from ua_fleet.endpoint.hardened_server import HardenedServer, create_server
from ua_fleet.endpoint.limits import EndpointLimits
from ua_fleet.endpoint.users import Role, ScryptCost, UserStore, current_user
from ua_fleet.errors import SkillRejected

# asyncua declares UInt32 where it takes an int; tests use it without types.
ua: Any = importlib.import_module("asyncua.ua")
binary: Any = importlib.import_module("asyncua.ua.ua_binary")
# Attackers reach into asyncua's client wherever they like.
Client: TypeAlias = Any

SERVER_URI: Final = "urn:test:ua-fleet"
CLIENT_URI: Final = "urn:test:client"
PASSWORDS: Final = {"olga": "observe-1", "oscar": "operate-1", "oliver": "operate-2", "eva": "engineer-1"}
ROLES: Final = {"olga": Role.OBSERVER, "oscar": Role.OPERATOR, "oliver": Role.OPERATOR, "eva": Role.ENGINEER}
CHEAP: Final = ScryptCost(2**8, 8, 1)
BASIC256SHA256: Final[Any] = security_policies.SecurityPolicyBasic256Sha256


def make_certificate(
    folder: Path,
    name: str,
    *,
    uri: str = CLIENT_URI,
    bits: int = 2048,
    days: tuple[int, int] = (-1, 30),
    issuer: tuple[x509.Certificate, Any] | None = None,
    ca: bool = False,
    client: bool = True,
) -> CertificateFiles:
    """A certificate with any fault that a test needs."""
    key = rsa.generate_private_key(public_exponent=65537, key_size=bits)
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now = datetime.now(UTC)
    usage = ExtendedKeyUsageOID.CLIENT_AUTH if client else ExtendedKeyUsageOID.SERVER_AUTH
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer[0].subject if issuer else subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now + timedelta(days=days[0]))
        .not_valid_after(now + timedelta(days=days[1]))
        .add_extension(x509.SubjectAlternativeName([x509.UniformResourceIdentifier(uri)]), critical=False)
        .add_extension(x509.BasicConstraints(ca=ca, path_length=None), critical=True)
        .add_extension(
            x509.KeyUsage(
                digital_signature=True,
                content_commitment=True,
                key_encipherment=True,
                data_encipherment=True,
                key_agreement=False,
                key_cert_sign=ca,
                crl_sign=ca,
                encipher_only=False,
                decipher_only=False,
            ),
            critical=True,
        )
        .add_extension(x509.ExtendedKeyUsage([usage]), critical=False)
    )
    certificate = builder.sign(issuer[1] if issuer else key, hashes.SHA256())
    files = CertificateFiles(folder / f"{name}.der", folder / f"{name}-key.pem")
    files.certificate.write_bytes(certificate.public_bytes(serialization.Encoding.DER))
    files.private_key.write_bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    return files


def load(files: CertificateFiles) -> tuple[x509.Certificate, Any]:
    """A certificate with its key, to sign others with."""
    certificate = x509.load_der_x509_certificate(files.certificate.read_bytes())
    return certificate, serialization.load_pem_private_key(files.private_key.read_bytes(), password=None)


class Identities:
    """Certificates, each made once in a test run."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._made: dict[str, CertificateFiles] = {}

    def get(self, name: str, **options: Any) -> CertificateFiles:
        """The certificate of that name, made with these options if it is new."""
        if name not in self._made:
            self._made[name] = make_certificate(self._folder, name, **options)
        return self._made[name]

    @property
    def client(self) -> CertificateFiles:
        """The certificate that servers trust."""
        return self.get("client")

    @property
    def other(self) -> CertificateFiles:
        """Another one that they trust."""
        return self.get("other", uri="urn:test:other")

    def install_server(self, state_dir: Path) -> None:
        """Give a server its certificate, the same one for all, since a key takes its time."""
        files = own_files(state_dir)
        if "server" not in self._made:
            made = CertificateFiles(self._folder / "server.der", self._folder / "server-key.pem")
            create_certificate(
                made, application_uri=SERVER_URI, common_name="test", hostnames=["127.0.0.1"], server=True
            )
            self._made["server"] = made
        files.certificate.parent.mkdir(parents=True)
        shutil.copy(self._made["server"].certificate, files.certificate)
        shutil.copy(self._made["server"].private_key, files.private_key)


@dataclass
class Nodes:
    """NodeIds of the nodes that both servers have."""

    value: Any = None
    plain: Any = None
    hidden: Any = None
    array: Any = None
    text: Any = None
    folder: Any = None
    methods: dict[str, Any] = field(default_factory=dict[str, Any])
    called: list[Any] = field(default_factory=list[Any])
    """What the methods have been called with."""


async def build(server: Server) -> Nodes:
    """Variables, a folder of 30 and methods."""
    index = await server.register_namespace("urn:test:nodes")
    objects = server.nodes.objects
    nodes = Nodes()

    async def variable(name: str, value: Any, kind: Any = None, *, writable: bool = False) -> Any:
        node = await objects.add_variable(ua.NodeId(name, index), name, value, kind)
        if writable:
            await node.set_writable()
        return node.nodeid

    nodes.value = await variable("value", 1.5, writable=True)
    nodes.plain = await variable("plain", 7.0)
    nodes.array = await variable("array", list(range(10)), ua.VariantType.Int32)
    nodes.text = await variable("text", "abcdef")
    nodes.hidden = await variable("hidden", 42)
    for attribute in (ua.AttributeIds.AccessLevel, ua.AttributeIds.UserAccessLevel):
        byte = ua.DataValue(ua.Variant(0, ua.VariantType.Byte))
        await server.get_node(nodes.hidden).write_attribute(attribute, byte)
    folder = await objects.add_folder(ua.NodeId("folder", index), "folder")
    nodes.folder = folder.nodeid
    for number in range(30):
        await folder.add_variable(ua.NodeId(f"child{number}", index), f"child{number}", number)

    @uamethod
    async def add(_parent: Any, a: int, b: int) -> int:
        nodes.called.append((a, b))
        return a + b

    @uamethod
    async def fails(_parent: Any) -> None:
        raise LookupError("a mistake in a method")

    @uamethod
    async def refuses(_parent: Any) -> None:
        raise SkillRejected("not now")

    @uamethod
    async def sleeps(_parent: Any) -> None:
        await asyncio.sleep(60)

    @uamethod
    def who(_parent: Any) -> str:
        user = current_user.get()
        return user.name if user is not None else "nobody"

    int64 = ua.VariantType.Int64
    for name, function, inputs, outputs in (
        ("add", add, [int64, int64], [int64]),
        ("locked", add, [int64, int64], [int64]),
        ("engineering", add, [int64, int64], [int64]),
        ("fails", fails, [], []),
        ("refuses", refuses, [], []),
        ("sleeps", sleeps, [], []),
        ("who", who, [], [ua.VariantType.String]),
    ):
        node = await objects.add_method(ua.NodeId(name, index), name, function, inputs, outputs)
        nodes.methods[name] = node.nodeid
    no = ua.DataValue(ua.Variant(False, ua.VariantType.Boolean))
    await server.get_node(nodes.methods["locked"]).write_attribute(ua.AttributeIds.Executable, no)
    return nodes


@dataclass
class Door:
    """A running hardened server."""

    server: HardenedServer
    state_dir: Path
    users: UserStore
    nodes: Nodes
    identities: Identities

    @property
    def url(self) -> str:
        """Its endpoint."""
        return f"opc.tcp://127.0.0.1:{self.server.port}/ua_fleet"

    def audit(self) -> list[dict[str, Any]]:
        """The lines of the audit log."""
        return [json.loads(line) for line in (self.state_dir / "audit.log").read_text().splitlines()]

    async def client(
        self,
        user: str | None = "oscar",
        files: CertificateFiles | None = None,
        *,
        uri: str = CLIENT_URI,
        policy: Any = BASIC256SHA256,
        password: str | None = None,
    ) -> Client:
        """A client, not connected."""
        client: Client = AsyncuaClient(self.url, timeout=60, watchdog_intervall=60)
        client.application_uri = uri
        client.session_timeout = 60_000
        if user is not None:
            client.set_user(user)
            client.set_password(PASSWORDS.get(user, "") if password is None else password)
        if policy is not None:
            chosen: Any = files or self.identities.client
            server = own_files(self.state_dir).certificate
            await client.set_security(policy, chosen.certificate, chosen.private_key, server_certificate=str(server))
        return client

    @contextlib.asynccontextmanager
    async def connected(self, user: str | None = "oscar", **options: Any) -> AsyncGenerator[Client]:
        """A connected client."""
        client = await self.client(user, **options)
        async with client:
            yield client


@contextlib.asynccontextmanager
async def door(
    folder: Path, identities: Identities, *, limits: dict[str, Any] | None = None, **config: Any
) -> AsyncGenerator[Door]:
    """A running hardened server with users, trusted certificates and nodes."""
    state_dir = folder / "state"
    identities.install_server(state_dir)
    users = UserStore(state_dir / "users.yaml", CHEAP)
    for name, password in PASSWORDS.items():
        users.add(name, password, ROLES[name])
    for files in (identities.client, identities.other):
        trust(state_dir, files.certificate)
    small: dict[str, Any] = {"tick_s": 0.02, "publishing_interval_ms": (10.0, 1000.0), **(limits or {})}
    with quick_start():
        server = await create_server(
            ServerConfig(port=0, **config),
            state_dir,
            application_uri=SERVER_URI,
            users=users,
            limits=EndpointLimits(**small),
        )
    nodes = await build(server)
    server.require_role(nodes.methods["engineering"], Role.ENGINEER)
    async with server:
        yield Door(server, state_dir, users, nodes, identities)


@dataclass
class Stock:
    """A running asyncua server as it comes, to show that an attack is real."""

    server: Server
    nodes: Nodes
    port: int

    @property
    def url(self) -> str:
        """Its endpoint."""
        return f"opc.tcp://127.0.0.1:{self.port}/"

    def client(self, user: str = "") -> Client:
        """A client, not connected."""
        client: Client = AsyncuaClient(self.url, timeout=60, watchdog_intervall=60)
        if user:
            client.set_user(user)
            client.set_password("anything")
        return client


@contextlib.asynccontextmanager
async def stock(port: int) -> AsyncGenerator[Stock]:
    """Asyncua's own server with its own defaults and our nodes."""
    server = Server()
    with quick_start():
        await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    nodes = await build(server)
    async with server:
        yield Stock(server, nodes, port)


async def send(client: Client, request: Any, response: Any) -> Any:
    """Send any request as the client's session and decode the response; a fault raises."""
    protocol: Any = client.uaclient.protocol
    return binary.struct_from_binary(response, await protocol.send_request(request))


async def bad(awaitable: Any) -> str:
    """The name of the StatusCode that something fails with; `Good` when it does not, `closed` without an answer."""
    try:
        result = await awaitable
    except ua.UaStatusCodeError as error:
        return str(ua.StatusCode(error.code).name)
    except (ConnectionError, TimeoutError, asyncio.CancelledError):
        return "closed"
    return "Good" if result is None or not hasattr(result, "name") else str(result.name)


async def lose(client: Client) -> None:
    """Lose the connection without closing the session."""
    await client._cancel_task(client._stale_watchdog_task)
    await client._cancel_task(client._supervisor_task)
    await client._cancel_task(client._renew_channel_task)
    client.disconnect_socket()
    await asyncio.sleep(0.05)


def recorded(client: Client) -> list[bytes]:
    """What a client sends from now on; it has a socket."""
    sent: list[bytes] = []
    transport: Any = client.uaclient.protocol.transport
    write = transport.write

    def keep(data: bytes) -> None:
        sent.append(bytes(data))
        write(data)

    transport.write = keep
    return sent


class Raw:
    """A TCP connection whose owner writes whatever bytes they like."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    @classmethod
    @contextlib.asynccontextmanager
    async def open(cls, port: int) -> AsyncGenerator[Raw]:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        try:
            yield cls(reader, writer)
        finally:
            writer.close()
            with contextlib.suppress(ConnectionError):
                await writer.wait_closed()

    def write(self, data: bytes) -> None:
        self.writer.write(data)

    def hello(self, *, buffers: int = 65_536) -> None:
        """Send a Hello."""
        hello = ua.Hello(0, buffers, buffers, 0, 0, "opc.tcp://127.0.0.1")
        self.write(binary.uatcp_to_binary(ua.MessageType.Hello, hello))

    def open_channel(self) -> None:
        """Send an OpenSecureChannel without security."""
        request = ua.OpenSecureChannelRequest()
        request.Parameters.RequestedLifetime = 60_000
        request.Parameters.SecurityMode = ua.MessageSecurityMode.None_
        self.write(self.chunk(b"OPN", b"F", binary.struct_to_binary(request), sequence=1))

    @staticmethod
    def chunk(kind: bytes, final: bytes, body: bytes, *, sequence: int, channel: int = 0, request: int = 1) -> bytes:
        """A chunk without security, as its parts."""
        header = ua.AsymmetricAlgorithmHeader() if kind == b"OPN" else ua.SymmetricAlgorithmHeader()
        if kind == b"OPN":
            header.SecurityPolicyURI = "http://opcfoundation.org/UA/SecurityPolicy#None"
        else:
            header.TokenId = 13
        rest = binary.struct_to_binary(header) + sequence.to_bytes(4, "little") + request.to_bytes(4, "little") + body
        chunk: bytes = kind + final + (12 + len(rest)).to_bytes(4, "little") + channel.to_bytes(4, "little") + rest
        return chunk

    async def answer(self) -> bytes:
        """The next message, empty when the server has closed."""
        try:
            head = await self.reader.readexactly(8)
            return head + await self.reader.readexactly(int.from_bytes(head[4:], "little") - 8)
        except (asyncio.IncompleteReadError, ConnectionError):
            return b""

    async def closed(self, within_s: float = 3) -> bool:
        """Whether the server closes the connection in time."""
        try:
            async with asyncio.timeout(within_s):
                while await self.answer():
                    pass
        except TimeoutError:
            return False
        return True
