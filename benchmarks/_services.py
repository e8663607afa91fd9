"""The processes of the benchmark `services`: a server of ours, a stock asyncua server, and a client that asks.

    python -m benchmarks._services ours PORT FOLDER | stock PORT FOLDER | client URL FOLDER POLICY
    python -m benchmarks._services watchers URL FOLDER POLICY

A server answers `cpu` with the CPU seconds of its process, `write HZ` by writing all values so often until `write 0`,
and `profile FILE` by profiling itself until the next line `profile`. The client answers `SERVICE COUNT REQUESTS`: it
sends so many requests of so many operations, one after the other, looks at the results of the first one, and decodes no
other.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
import contextlib
import cProfile
import functools
import logging
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import structlog
from asyncua import ua as standard

from benchmarks._ingest import serve_lines

ua: Any = standard
"""Its types are no help to those who fill in its structures."""
VALUES = 1_000
IN_FOLDER = 100
AT_ONCE = 50
"""Values that are written before others get their turn."""
URI = "urn:ua-fleet:benchmark"
USER, PASSWORD = "operator", "benchmark-1234"
OWNER, METHOD = "ns=2;s=Owner", "ns=2;s=Method"


class Cost:
    """CPU time of this process, and a profile of it where somebody asks for one; also writes the values of a server."""

    def __init__(self, server: Any) -> None:
        self._server = server
        self._profile: cProfile.Profile | None = None
        self._writing: asyncio.Task[None] | None = None

    async def _write(self, hertz: float) -> None:
        """Write all values at this rate; a round that is late is not made up for."""
        due, value = time.monotonic(), 0.0
        while True:
            value += 1.0
            for number in range(1, VALUES + 1):
                await self._server.write_attribute_value(ua.NodeId(number, 2), _fresh(value))
                if number % AT_ONCE == 0:
                    await asyncio.sleep(0)
            due = max(due + 1 / hertz, time.monotonic())
            await asyncio.sleep(due - time.monotonic())

    async def answer(self, line: str) -> str:
        if line.startswith("write"):
            hertz = float(line.split()[1])
            if self._writing is not None:
                self._writing.cancel()
                await asyncio.wait([self._writing])
            self._writing = asyncio.create_task(self._write(hertz)) if hertz else None
        if line.startswith("profile"):
            _, _, path = line.partition(" ")
            if self._profile is None:
                self._profile = cProfile.Profile(time.process_time)
                self._profile.enable()
            else:
                self._profile.disable()
                self._profile.dump_stats(path)
                self._profile = None
        return str(time.process_time())


async def ours(port: int, folder: Path) -> None:
    from ua_fleet.config.schema import ServerConfig
    from ua_fleet.endpoint.hardened_server import create_server
    from ua_fleet.endpoint.node_builder import NodeBuilder
    from ua_fleet.endpoint.users import USERS_FILE, Role, UserStore
    from ua_fleet.values import QualifiedName

    users = UserStore(folder / "state" / USERS_FILE)
    (folder / "state").mkdir(mode=0o700)
    users.add(USER, PASSWORD, Role.OPERATOR)
    config = ServerConfig.model_validate(
        {
            "port": port,
            "allow_none_security": True,
            "allow_anonymous": True,
            "trust_all_clients": True,
            "max_sessions": 100,
            "max_sessions_per_user": 100,
        }
    )
    server = await create_server(config, folder / "state", application_uri=URI, users=users)
    await server.register_namespace("urn:ua-fleet:fleet")
    builder = NodeBuilder(server.iserver.aspace)
    objects = ua.NodeId(ua.ObjectIds.ObjectsFolder)
    of_type, of_folder = ua.NodeId(ua.ObjectIds.BaseDataVariableType), ua.NodeId(ua.ObjectIds.FolderType)
    parent = objects
    for number in range(1, VALUES + 1):
        if number % IN_FOLDER == 1:
            name = f"G{number // IN_FOLDER}"
            parent = ua.NodeId(name, 2)
            builder.add_object(parent, QualifiedName(2, name), objects, of_folder)
        builder.add_variable(
            ua.NodeId(number, 2),
            QualifiedName(2, f"value{number}"),
            parent,
            of_type,
            data_type=ua.NodeId(ua.ObjectIds.Double),
            value=_fresh(),
            writable=True,
        )
    owner, method = ua.NodeId.from_string(OWNER), ua.NodeId.from_string(METHOD)
    builder.add_object(owner, QualifiedName(2, "Owner"), objects, ua.NodeId(ua.ObjectIds.BaseObjectType))
    builder.add_method(method, QualifiedName(2, "Method"), owner)
    server.iserver.aspace[method].call = _call
    await server.start()
    print("ready", flush=True)
    await serve_lines(Cost(server).answer)
    await server.stop()


def _fresh(value: float = 1.5) -> Any:
    from datetime import UTC, datetime

    now: Any = datetime.now(UTC)
    return ua.DataValue(ua.Variant(value, ua.VariantType.Double), ua.StatusCode(ua.UInt32(0)), now, now)


async def _call(_parent: Any) -> Any:
    return []


async def stock(port: int, folder: Path) -> None:
    """Asyncua as it comes."""
    from asyncua.server.server import Server

    from ua_fleet.endpoint.certificates import ensure_application_certificate

    files = ensure_application_certificate(folder / "stock", URI, ["127.0.0.1"])
    server: Any = Server()
    await server.init()
    await server.set_application_uri(URI)
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/ua_fleet")
    await server.load_certificate(files.certificate)
    await server.load_private_key(files.private_key)
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity, ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
    await server.register_namespace("urn:ua-fleet:fleet")
    parent = server.nodes.objects
    for number in range(1, VALUES + 1):
        if number % IN_FOLDER == 1:
            name = f"G{number // IN_FOLDER}"
            parent = await server.nodes.objects.add_folder(f"ns=2;s={name}", f"2:{name}")
        node = await parent.add_variable(f"ns=2;i={number}", f"2:value{number}", 0.0)
        await server.write_attribute_value(node.nodeid, _fresh())
        await node.set_writable()
    owner = await server.nodes.objects.add_object(OWNER, "2:Owner")
    await owner.add_method(METHOD, "2:Method", _call, [], [])
    await server.start()
    print("ready", flush=True)
    await serve_lines(Cost(server).answer)
    await server.stop()


class Asking:
    """Requests of one connected client."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._subscription = 0

    async def answer(self, line: str) -> str:
        service, count, requests = line.split()
        make, check = await self._service(service, int(count))
        request = make()
        check(await self._ask(request))
        began = time.perf_counter()
        for _ in range(int(requests)):
            await self._ask(request)
        seconds = time.perf_counter() - began
        await self._forget()
        return str(seconds)

    async def _ask(self, request: Any) -> Any:
        return await self._client.uaclient.protocol.send_request(request, 60)

    async def _forget(self) -> None:
        if self._subscription:
            await self._client.uaclient.delete_subscriptions([self._subscription])
            self._subscription = 0

    async def _service(self, service: str, count: int) -> tuple[Callable[[], Any], Callable[[Any], None]]:
        from asyncua.ua.ua_binary import struct_from_binary

        if service == "CreateMonitoredItems":
            request, response = await self._items(count)
        else:
            request, response = _REQUESTS[service](count)

        def check(data: Any) -> None:
            _check(struct_from_binary(response, data).Results, count)

        return lambda: request, check

    async def _items(self, count: int) -> tuple[Any, Any]:
        parameters = ua.CreateSubscriptionParameters(60_000, 10_000, 1_000, 1_000, False, 0)
        self._subscription = (await self._client.uaclient.create_subscription(parameters, None)).SubscriptionId
        request: Any = ua.CreateMonitoredItemsRequest()
        request.Parameters.SubscriptionId = self._subscription
        request.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Both
        request.Parameters.ItemsToCreate = [
            ua.MonitoredItemCreateRequest(
                ua.ReadValueId(node, ua.AttributeIds.Value),
                ua.MonitoringMode.Reporting,
                ua.MonitoringParameters(7, 100.0, None, 1, True),
            )
            for node in _nodes(count)
        ]
        return request, ua.CreateMonitoredItemsResponse


def _nodes(count: int) -> list[Any]:
    return [ua.NodeId(number % VALUES + 1, 2) for number in range(count)]


def _check(results: Any, count: int) -> None:
    assert len(results) == count, results
    for one in results:
        status = one if isinstance(one, ua.StatusCode) else one.StatusCode
        assert status is None or status.is_good(), one
        assert not isinstance(one, ua.BrowseResult) or len(one.References) >= IN_FOLDER, one


def _read(count: int) -> tuple[Any, Any]:
    request: Any = ua.ReadRequest()
    request.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Both
    request.Parameters.NodesToRead = [ua.ReadValueId(node, ua.AttributeIds.Value) for node in _nodes(count)]
    return request, ua.ReadResponse


def _write(count: int) -> tuple[Any, Any]:
    request: Any = ua.WriteRequest()
    value = ua.DataValue(ua.Variant(2.5, ua.VariantType.Double))
    wanted = ua.AttributeIds.Value
    request.Parameters.NodesToWrite = [ua.WriteValue(node, wanted, None, value) for node in _nodes(count)]
    return request, ua.WriteResponse


def _browse(count: int) -> tuple[Any, Any]:
    request: Any = ua.BrowseRequest()
    request.Parameters.RequestedMaxReferencesPerNode = 0
    request.Parameters.NodesToBrowse = [
        ua.BrowseDescription(
            ua.NodeId(f"G{number % (VALUES // IN_FOLDER)}", 2),
            ua.BrowseDirection.Forward,
            ua.NodeId(ua.ObjectIds.HierarchicalReferences),
            True,
            0,
            ua.BrowseResultMask.All,
        )
        for number in range(count)
    ]
    return request, ua.BrowseResponse


def _calls(count: int) -> tuple[Any, Any]:
    method = ua.CallMethodRequest(ua.NodeId.from_string(OWNER), ua.NodeId.from_string(METHOD), [])
    request: Any = ua.CallRequest()
    if hasattr(ua, "CallParameters"):
        request.Parameters.MethodsToCall = [method] * count
    else:
        request.Parameters = [method] * count
    return request, ua.CallResponse


_REQUESTS = {"Read": _read, "Write": _write, "Browse": _browse, "Call": _calls}


def connections(url: str, folder: Path, policy: str) -> Callable[..., Any]:
    """What makes clients that have not connected yet; with a user where they are `named`.

    Their key is read once in this process. OpenSSL examines one for 30 ms, and a server that rested so long before
    each connection begins it with cold caches: for other requests, too, one client asks as fast as it can.
    """
    from asyncua.client.client import Client
    from cryptography.hazmat.primitives import serialization

    from ua_fleet.endpoint.certificates import ensure_application_certificate

    files = ensure_application_certificate(folder / "client", "urn:ua-fleet:client", ["127.0.0.1"])
    loading: Any = serialization
    if not hasattr(loading.load_pem_private_key, "cache_info"):
        loading.load_pem_private_key = functools.cache(loading.load_pem_private_key)

    async def make(*, named: bool) -> Any:
        made: Any = Client(url, timeout=60, watchdog_intervall=600)
        made.application_uri = "urn:ua-fleet:client"
        if policy != "None":
            await made.set_security_string(f"{policy},SignAndEncrypt,{files.certificate},{files.private_key}")
        if named:
            made.set_user(USER)
            made.set_password(PASSWORD)
        return made

    return make


async def client(url: str, folder: Path, policy: str) -> None:
    """Connects once, and anew for `Connect`."""
    make = connections(url, folder, policy)

    asking: Asking | None = None
    async with contextlib.AsyncExitStack() as stack:
        asking = Asking(await stack.enter_async_context(await make(named=True)))

        async def answer(line: str) -> str:
            if not line.startswith("Connect"):
                return await asking.answer(line)
            for _ in range(int(line.split()[2])):
                async with await make(named=False):
                    pass
            return "0"

        print("ready", flush=True)
        await serve_lines(answer)


def main() -> None:
    logging.disable(logging.WARNING)
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    role, *arguments = sys.argv[1:]
    if role == "watchers":
        from benchmarks._watchers import watchers

        url, folder, policy = arguments
        asyncio.run(watchers(connections(url, Path(folder), policy)))
    elif role == "client":
        url, folder, policy = arguments
        asyncio.run(client(url, Path(folder), policy))
    else:
        port, folder = arguments
        asyncio.run({"ours": ours, "stock": stock}[role](int(port), Path(folder)))


if __name__ == "__main__":
    main()
