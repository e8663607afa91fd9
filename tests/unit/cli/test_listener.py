"""`ua-fleet pubsub listen` without a network: what it prints of secured, refused and plain messages."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from tests.unit.cli.conftest import Invoke
from tests.unit.pubsub.publishing import TOPIC, Writing
from tests.unit.pubsub.security.securing import SIGN, action, data, envelope, group_keys, probe
from tests.unit.wire.discovery_samples import ANNOUNCEMENTS
from tests.unit.wire.everything import ACTIONS
from ua_fleet.cli.listener import MessagePrinter, figures_text
from ua_fleet.cli.opening import TOOL_SPACE, Opener, ToolKeys, lacks_keys, tool_envelope
from ua_fleet.config import load
from ua_fleet.counters import Counters
from ua_fleet.errors import KeySourceUnavailable, KeysRefused
from ua_fleet.pubsub import PubSubTiming
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.keyring import GroupKeys
from ua_fleet.teleoperation import Setpoint, SetpointAddress
from ua_fleet.teleoperation.messages import encode_setpoint
from ua_fleet.transport.base import Address, Receive, TransportStats
from ua_fleet.wire import Codec
from ua_fleet.wire.actions import encode_action
from ua_fleet.wire.announcements import encode_announcement
from ua_fleet.wire.security import MessageKey

FOR_EVER = 1e12
SETPOINT_GROUPS = {1001: TOPIC.space}
SETPOINT = encode_setpoint(Codec(), SetpointAddress(1001, 7), Setpoint(3, 5, 9, (0.5, float("nan"))))
GROUPS = (f"t-{TOPIC.space}", f"c-{TOPIC.space}")


class Recorded:
    """A transport that delivers what it was given, and remembers what is sent."""

    def __init__(self, datagrams: Iterable[bytes]) -> None:
        self.stats = TransportStats()
        self.sent: list[bytes] = []
        self._datagrams = list(datagrams)

    async def start(self, receive: Receive) -> None:
        for datagram in self._datagrams:
            self.stats.received += 1
            receive(datagram, ("127.0.0.1", 4840))

    def send(self, datagram: bytes, address: Address | None = None) -> None:
        self.sent.append(datagram)

    async def close(self) -> None:
        pass


def listener(opener: Opener, *, as_json: bool = True, count: int | None = None) -> MessagePrinter:
    return MessagePrinter(PubSubTiming(), opener, count=count, as_json=as_json, setpoint_groups=SETPOINT_GROUPS)


def heard(
    datagrams: Iterable[bytes], opener: Opener, capsys: pytest.CaptureFixture[str]
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The lines that are printed for these datagrams, and the figures at the end."""
    listening = listener(opener)

    async def listen() -> None:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0):
                await listening.listen(Recorded(datagrams))

    asyncio.run(listen())
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()], listening.figures()


def without_keys() -> Opener:
    counters = Counters()
    return Opener(counters, tool_envelope(None, counters))


def with_key(data_of_key: bytes) -> Opener:
    counters = Counters()
    keys = group_keys(seed=f"0{GROUPS[0]}")
    return Opener(counters, tool_envelope(None, counters), MessageKey(keys.policy, data_of_key))


def with_keys(*groups: str) -> Opener:
    """An opener with keys that do not end while a test runs."""
    counters = Counters()
    opened = envelope(TOOL_SPACE, counters=counters, setpoint_groups=SETPOINT_GROUPS)
    for group_id in groups or GROUPS:
        opened.install(group_id, group_keys(seed=f"0{group_id}", next_s=FOR_EVER, lifetime_s=FOR_EVER), 0.0)
    return Opener(counters, opened)


def sealed(*plain: bytes, **more: Any) -> list[bytes]:
    sender = envelope(TOPIC.space, *GROUPS, **more)
    return [datagram for message in plain for datagram in sender.seal(message, 0.0)]


def published() -> list[bytes]:
    writing = Writing()
    return [*writing.announce(), *writing.publish(1.5)]


def test_plain_messages(capsys: pytest.CaptureFixture[str]) -> None:
    lines, figures = heard(
        [*published(), probe(), encode_announcement(ANNOUNCEMENTS["status"])], without_keys(), capsys
    )
    unsecured = {"mode": "None", "token_id": None, "verified": None}
    assert [line["event"] for line in lines] == ["metadata", "data", "announcement"]
    assert lines[1]["fields"] == {"level": 1.5, "name": "a"}
    assert lines[1]["security"] == unsecured
    assert lines[2]["announcement"]["state"] == 0
    assert figures["kinds"] == {"metadata": 1, "keep-alive": 1, "key": 1, "probe": 1, "announcement": 1}
    assert figures["drops"] == {}


def test_setpoints_are_shown_by_who_has_the_keys_of_commands(capsys: pytest.CaptureFixture[str]) -> None:
    server = envelope(0, "t-0", GROUPS[1], setpoint_groups=SETPOINT_GROUPS)
    datagrams = [server.seal(SETPOINT, 0.0)[0] for _ in range(2)]
    for opener, sent in ((with_keys(), datagrams[:1]), (without_keys(), [SETPOINT])):
        (line,), figures = heard(sent, opener, capsys)
        assert (line["event"], line["space"], line["data_set_writer_ids"]) == ("setpoint", TOPIC.space, [7])
        assert line["fields"] == {"Lease": 3, "Number": 5, "Echo": 9, "Values": [0.5, "nan"]}
        assert (figures["kinds"], figures["drops"]) == ({"setpoint": 1}, {})
    (line,), figures = heard(datagrams[1:], with_keys(GROUPS[0]), capsys)
    assert line["event"] == "secured"
    assert figures["drops"] == {"secured": 1}


@pytest.mark.parametrize("make", [with_keys, lambda: with_key(group_keys(seed=f"0{GROUPS[0]}").keys[0])])
def test_secured_messages_with_keys(make: Any, capsys: pytest.CaptureFixture[str]) -> None:
    lines, figures = heard(sealed(*published()), make(), capsys)
    assert [line["event"] for line in lines] == ["metadata", "data"]
    assert lines[1]["fields"] == {"level": 1.5, "name": "a"}
    assert lines[1]["security"] == {"mode": "SignAndEncrypt", "token_id": 1, "verified": True}
    assert figures["kinds"] == {"metadata": 1, "keep-alive": 1, "key": 1}


def test_without_keys_the_headers_are_shown(capsys: pytest.CaptureFixture[str]) -> None:
    lines, figures = heard(sealed(*published(), data("large" * 100), max_datagram_bytes=576), without_keys(), capsys)
    assert {line["event"] for line in lines} == {"secured"}
    assert [line["sequence_number"] for line in lines] == list(range(1, len(lines) + 1))
    last = lines[-1]
    assert (last["publisher_id"], last["writer_group_id"], last["data_set_writer_ids"]) == (1, 2, [1001])
    assert last["security"] == {"mode": "SignAndEncrypt", "token_id": 1, "verified": None}
    assert figures["drops"] == {"secured": len(lines)}
    assert figures["kinds"] == {}


def test_what_is_signed_only_is_not_shown_as_data_without_its_key(capsys: pytest.CaptureFixture[str]) -> None:
    lines, _ = heard(sealed(*published(), mode=SIGN), without_keys(), capsys)
    assert {line["event"] for line in lines} == {"secured"}


def test_a_wrong_key(capsys: pytest.CaptureFixture[str]) -> None:
    opener = with_key(group_keys(seed="another").keys[0])
    lines, figures = heard(sealed(*published()), opener, capsys)
    assert {(line["event"], line["drop"], line["security"]["verified"]) for line in lines} == {
        ("refused", "bad_signature", False)
    }
    assert figures["drops"] == {"bad_signature": len(lines)}


def test_what_a_process_of_the_fleet_would_refuse(capsys: pytest.CaptureFixture[str]) -> None:
    good = sealed(data())[0]
    forged = good[:-1] + bytes((good[-1] ^ 1,))
    lines, figures = heard([good, good, forged, data(), sealed(action())[0]], with_keys(), capsys)
    assert [(line.get("drop"), line["security"]["verified"]) for line in lines] == [
        ("replayed", True),
        ("bad_signature", False),
        ("not_secured", None),
    ]
    assert all(line["reason"] for line in lines)
    assert figures["drops"]["replayed"] == figures["drops"]["not_secured"] == 1


def test_an_action_of_a_group_that_we_are_not_in(capsys: pytest.CaptureFixture[str]) -> None:
    lines, _ = heard(sealed(action()), with_keys(GROUPS[0]), capsys)
    assert [line["event"] for line in lines] == ["secured"]


def test_chunks(capsys: pytest.CaptureFixture[str]) -> None:
    datagrams = sealed(data("large" * 200), max_datagram_bytes=576)
    assert len(datagrams) > 1
    for opener in (with_keys(), with_key(group_keys(seed=f"0{GROUPS[0]}").keys[0])):
        lines, figures = heard(datagrams, opener, capsys)
        assert (lines, figures["kinds"]) == ([], {"key": 1})


def test_actions(capsys: pytest.CaptureFixture[str]) -> None:
    request, *_, response = (encode_action(action) for action in ACTIONS[:5])
    lines, figures = heard([request, response], without_keys(), capsys)
    assert [(line["event"], line["messages"][0]["kind"]) for line in lines] == [
        ("action", "action-request"),
        ("action", "action-response"),
    ]
    assert figures["kinds"] == {"action-request": 1, "action-response": 1}


def test_malformed_messages_are_counted(capsys: pytest.CaptureFixture[str]) -> None:
    lines, figures = heard([b"\x00garbage", b"", data()[:-2]], without_keys(), capsys)
    assert lines == []
    assert sum(figures["malformed"].values()) == figures["drops"]["malformed"] == 3


def test_lines_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    async def listen(opener: Opener, datagrams: list[bytes], count: int) -> MessagePrinter:
        listening = listener(opener, as_json=False, count=count)
        await listening.listen(Recorded(datagrams))
        return listening

    listening = asyncio.run(listen(with_keys(), [*sealed(*published()), data()], 3))
    shown = capsys.readouterr().out.splitlines()
    secured = "[SignAndEncrypt, token 1, verified]"
    assert shown[0] == f"metadata  {TOPIC.name}  (arm)  level=double  name=string  {secured}"
    assert shown[1].startswith(f'{TOPIC.name}  (arm)  level=1.5  name="a"')
    assert shown[2].startswith("refused  not_secured  PublisherId=1  WriterGroupId=2")
    text = figures_text({**listening.figures(), "kernel_drops": 0})
    assert text.endswith("dropped: not_secured 1, kinds: keep-alive 1, key 1, metadata 1")

    asyncio.run(listen(without_keys(), sealed(data()), 1))
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("secured  PublisherId=1  WriterGroupId=2  sequence=1  bytes=")
    assert line.endswith("DataSetWriterIds=1001  [SignAndEncrypt, token 1, not verified]")
    asyncio.run(listen(without_keys(), published(), 2))
    assert capsys.readouterr().out.splitlines()[1].endswith("unsecured")


class Source:
    """A source of keys that a test sets."""

    refresh_s = 0.5
    generation = 0

    def __init__(self, *groups: str, problem: Exception | None = None) -> None:
        self.groups, self.problem = groups, problem
        self.asked: list[str] = []

    async def fetch(self, group_id: str, starting_token_id: int, count: int) -> GroupKeys:
        self.asked.append(group_id)
        if self.problem is not None:
            raise self.problem
        if group_id not in self.groups:
            raise KeysRefused(group_id, "not there")
        return group_keys(seed=f"0{group_id}")


def tool(*groups: str) -> Envelope:
    made = Envelope(TOOL_SPACE, Counters(), mode=SIGN, nonces=envelope(1)._nonces)  # pyright: ignore[reportPrivateUsage]
    for group_id in groups:
        made.want(group_id)
    return made


def test_keys_of_a_tool(capsys: pytest.CaptureFixture[str]) -> None:
    opened, source = tool(*GROUPS), Source(GROUPS[0])
    keys = ToolKeys(opened, source)

    async def refresh() -> None:
        await keys.refresh()
        await keys.refresh()

    asyncio.run(refresh())
    assert source.asked == list(GROUPS), "not the tool's own group, and not again at once"
    assert opened.open(sealed(data())[0], 0.0) is not None
    assert capsys.readouterr().err == f"no keys of {GROUPS[1]}: not there\n"


def test_a_source_of_keys_that_is_away(capsys: pytest.CaptureFixture[str]) -> None:
    source = Source(problem=KeySourceUnavailable("the key service is away"))
    asyncio.run(ToolKeys(tool(*GROUPS), source).refresh())
    assert source.asked == [GROUPS[0]]
    assert capsys.readouterr().err == "the key service is away\n"


FLEET = """\
version: 1
pubsub: {{security: {security}, keys: {{source: {source}}}}}
bridges: {{cell: {{kind: ros1, status_id: 1}}}}
"""


@pytest.mark.parametrize(
    ("security", "source", "as_bridge", "lacks"),
    [
        ("none", "service", None, False),
        ("sign", "files", None, False),
        ("sign", "service", None, True),
        ("sign", "service", "cell", False),
    ],
)
def test_who_lacks_keys(security: str, source: str, as_bridge: str | None, lacks: bool, tmp_path: Path) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text(FLEET.format(security=security, source=source))
    fleet = load(path, {})
    assert lacks_keys(fleet, as_bridge) is lacks
    groups = tool_envelope(fleet, Counters()).groups_wanted()
    assert set(groups) == (set() if security == "none" else {"t-255", "t-0", "t-1", "c-1"})


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--key", "00"], "--key: key data of 1 bytes"),
        (["--as-bridge", "nobody"], "there is no bridge 'nobody'"),
    ],
)
def test_usage(options: list[str], said: str, invoke: Invoke, tmp_path: Path) -> None:
    (tmp_path / "fleet.yaml").write_text(FLEET.format(security="sign", source="service"))
    ended = invoke("pubsub", "listen", *options, "--timeout", "0.2")
    assert ended.code == 2
    assert said in ended.stderr
