"""An observer who wants the lines about somebody else gone."""

from __future__ import annotations

import contextlib
from pathlib import Path

from tests.attacks.harness import Attacker, attacked, binary, ua
from ua_fleet.endpoint.audit.verification import verify


def test_refused_writes_do_not_push_others_lines_out(tmp_path: Path) -> None:
    """75,000 of them rotated all files in 3 s."""
    with attacked(tmp_path) as server:
        with server.logged_in("oscar") as operator:
            assert write(operator, 1) == 0
        with server.harm() as harm, server.logged_in("olga") as observer:
            for _ in range(80):
                assert write(observer, 1_000) == 1_000
            refused = [line for line in server.audit() if line["event"] == "write" and line["user"] == "olga"]
            assert 100 < len(refused) < 200
        harm.check()
        log = server.folder / "state" / "audit.log"
        assert not log.with_name("audit.log.1").exists()
        assert any(line["event"] == "write" and line["user"] == "oscar" for line in server.audit())
    assert not verify(log).problems
    written = server.audit()
    seen = sum(line["event"] == "write" and line["user"] == "olga" for line in written)
    sums = [line["of"].get("write BadUserAccessDenied", 0) for line in written if line["event"] == "omitted"]
    assert seen + sum(sums) == 80_000, "what was left out is in the sums"


def test_logins_do_not_either(tmp_path: Path) -> None:
    with attacked(tmp_path) as server:
        with server.harm() as harm:
            for _ in range(400):
                with contextlib.suppress(AssertionError), server.logged_in(None):
                    pass
            assert len(server.audit()) < 400
        harm.check()


def write(client: Attacker, count: int) -> int:
    """Write a node so many times in one request; how many were refused."""
    request = ua.WriteRequest()
    value = ua.DataValue(ua.Variant(0.5, ua.VariantType.Double))
    request.Parameters.NodesToWrite = [ua.WriteValue(ua.NodeId(1002, 2), ua.AttributeIds.Value, None, value)] * count
    return sum(not result.is_good() for result in client.call(request, ua.WriteResponse).Results)


def test_the_lines_of_many_writes_are_no_long_turn(tmp_path: Path) -> None:
    """The lines of a request were made and written in one piece, those of several sessions one after the other."""
    value = ua.DataValue(ua.Variant(0.5, ua.VariantType.Double))
    request = ua.WriteRequest()
    request.Parameters.NodesToWrite = [ua.WriteValue(ua.NodeId(1002, 2), ua.AttributeIds.Value, None, value)] * 4_000
    with attacked(tmp_path) as server:
        with server.harm() as harm, contextlib.ExitStack() as stack:
            clients = [stack.enter_context(server.logged_in("oscar")) for _ in range(4)]
            for client in clients:
                request.RequestHeader = client.header()
                client.send(binary.struct_to_binary(request))
            for client in clients:
                assert client.answer()
        harm.check()
    assert not verify(server.folder / "state" / "audit.log").problems
    assert sum(line["event"] == "write" for line in server.audit()) < 4_000
