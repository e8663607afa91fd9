"""PubSub over an MQTT broker: the event loop and the library around `core.py`.

MQTT 5 is asked for, and 3.1.1 where the broker refuses 5. Each connection is a new client with a clean session, so that
nothing waits at the broker for a process that is away, and all that waits here waits in the outbox, by its rules. A
connection that breaks, or on which nothing is acknowledged any more, is made anew after a random pause.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from random import Random
from typing import Any, Final

import structlog
from mqttium import (
    BrokerDisconnectError,
    ConnectRefusedError,
    FlowControlError,
    MalformedPacketError,
    MQTTError,
    MQTTProtocolVersion,
    NotConnectedError,
    ProtocolError,
    PublishRejectedError,
    QoS,
    SubscribeError,
)
from mqttium.api import AsyncClient, Properties, PublishMessage, PublishReceipt, SubscribeOptions

from ua_fleet.counters import Drop
from ua_fleet.errors import TransportError
from ua_fleet.transport.base import Address, Receive, TransportStats
from ua_fleet.transport.mqtt.address import parse_broker_url
from ua_fleet.transport.mqtt.carried import Carried
from ua_fleet.transport.mqtt.complaints import Complaints
from ua_fleet.transport.mqtt.core import Heard, MqttCore, Outgoing
from ua_fleet.transport.mqtt.credentials import Credentials
from ua_fleet.transport.mqtt.json import JsonSettings
from ua_fleet.transport.mqtt.outbox import WINDOW_BYTES, Outbox
from ua_fleet.transport.mqtt.patience import Patience
from ua_fleet.transport.mqtt.pauses import Pauses
from ua_fleet.transport.mqtt.topics import Kind, TopicTree
from ua_fleet.transport.party import Party
from ua_fleet.values import ticks_from_unix_ns

__all__ = ["MqttTransport"]

_REFUSED_AGAIN_S: Final = 5.0
_REFUSED_LATEST_S: Final = 60.0
"""What the broker refused to deliver is asked for again after a pause, which doubles from the one to the other."""
_LASTED_S: Final = 10.0
"""A connection that lasted so long worked: the next one is tried soon."""
_RIVALS_AFTER: Final = 3
"""So many that did not last may be those of two processes with one ClientID: not every broker says so."""
_CHECK_S: Final = 0.25
_FLUSH_S: Final = 1.0
"""So long the last messages have at the end."""
_CANCEL_AGAIN_S: Final = 0.5
_KEY_WAIT_S: Final = 0.1
_MARGIN_BYTES: Final = 64 * 1024
_CLIENT_BYTES: Final = 4 * WINDOW_BYTES
"""Bound of the client: above that of the outbox, which so decides alone what waits."""
_UNACCEPTABLE_VERSION: Final = frozenset({0x84, 1})
"""Of CONNACK: Unsupported Protocol Version of MQTT 5, and unacceptable protocol version of 3.1.1."""
_TAKEN_OVER: Final = 0x8E
_LATE: Final = ("", 0)
"""In place of the topic of what was held back."""
_NOT_AUTHORIZED: Final = frozenset({0x87, 0x86, 4, 5})
_LOOK_AT_RIGHTS: Final = "look at this user's rights there, or whether the broker is too slow"
_CONTENT_TYPE: Final = "application/opcua+uadp"
_JSON_TYPE: Final = "application/json"

_log = structlog.get_logger(__name__)


class MqttTransport:
    """A Transport, and Brokered."""

    def __init__(
        self,
        url: str,
        tree: TopicTree | None = None,
        credentials: Credentials | None = None,
        *,
        more_urls: Sequence[str] = (),
        client_id: str | None = None,
        qos: int = 1,
        keep_alive_s: int = 5,
        answer_timeout_s: float | None = None,
        receive_timeout_s: float = 3.0,
        most_waiting_s: float | None = None,
        most_waiting_bytes: int = 64 * 1024 * 1024,
        max_message_bytes: int = 4 * 1024 * 1024,
        hears_itself: bool = True,
        json: JsonSettings | None = None,
        random: Random | None = None,
    ) -> None:
        """Prepare a transport; nothing is opened before `start`.

        Args:
            url: `mqtt://<host>:<port>`, or `mqtts://`.
            tree: the topics of PubSub; those of `TopicTree()` where there is none.
            credentials: how to log in.
            more_urls: other nodes of the same broker, a cluster: the next one is tried when a connection is lost or
                cannot be made.
            client_id: of the process; a random one for a tool.
            qos: of data.
            keep_alive_s: a lost connection is noticed within 1.5 of it.
            answer_timeout_s: so long the broker may take for an answer; by default 5, and 20 for a cluster.
            receive_timeout_s: a keep-alive that is older is not delivered any more.
            most_waiting_s: so long values wait in their order; by default 2, and 30 for a cluster.
            most_waiting_bytes: of values, while the broker is away or slow.
            max_message_bytes: larger messages are not received.
            hears_itself: whether what it sends comes back to it; with MQTT 3.1.1 it does.
            json: how JSON is spoken, in place of UADP; `tree` has to be one of JSON then.
            random: makes the pauses.
        """
        self._nodes = deque([(each, parse_broker_url(each)) for each in (url, *more_urls)])
        self._url, self._address = self._nodes[0]
        self._tree, self._credentials = tree or TopicTree(), credentials or Credentials()
        self._client_id = client_id or f"ua-fleet-tool-{secrets.token_hex(8)}"
        self._qos, self._keep_alive_s, self._receive_timeout_s = qos, keep_alive_s, receive_timeout_s
        self._patience = Patience.of(answer_timeout_s, most_waiting_s, is_cluster=bool(more_urls))
        self._most_waiting_bytes, self._max_message_bytes = most_waiting_bytes, max_message_bytes
        self._hears_itself, self._json = hears_itself, json
        self._content_type = _CONTENT_TYPE if json is None else _JSON_TYPE
        self._pauses = Pauses(random or Random())  # noqa: S311 - keeps no secret
        self.stats = TransportStats(problem=f"{url}: not connected yet")
        self._party: Party | None = None
        self._core: Carried | None = None
        self._speaker: MqttCore | None = None
        """The same, where it is PubSub."""
        self._receive: Receive | None = None
        self._task: asyncio.Task[None] | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._is_behind, self._behind = False, list[Any]()
        """Whether a message was taken in this turn of the event loop, and what came with it."""
        self._client: AsyncClient | None = None
        """Connected and subscribed."""
        self._lost: asyncio.Future[str] | None = None
        """Why the present connection is over."""
        self._version = MQTTProtocolVersion.MQTTv5
        self._is_closing = False
        self._short = 0
        """Connections one after the other that were made and did not last."""
        self._was_stuck = False
        """Whether the last one was ended here, since nothing was acknowledged."""
        self._has_told_version = False
        self._can_retain = True
        self._most_qos = 2
        self._complaints = Complaints()
        self._emptied = asyncio.Event()
        """Whether there is nothing to wait for at the end."""
        self._clock: Callable[[], float] = time.monotonic

    def speak_for(self, party: Party) -> None:
        """See Brokered."""
        self._party = party
        answer_s, ordered_s = self._patience
        outbox = Outbox(most_bytes=self._most_waiting_bytes, most_age_s=ordered_s, stuck_s=answer_s)
        self._core = self._speaker = MqttCore(
            party,
            self._tree,
            outbox,
            qos=self._qos,
            keep_alive_expiry_s=self._receive_timeout_s,
            max_text_bytes=self._max_message_bytes,
            json=self._json,
        )

    def carry(self, core: Carried) -> None:
        """Carry something else than PubSub, as JSON; before `start`, in place of `speak_for`."""
        self._core, self._content_type = core, _JSON_TYPE

    def is_own(self, sender: Address) -> bool:
        """Whether a message with our PublisherId and no signature of another may be our own, which comes back to us.

        With MQTT 5 a broker can be told not to send it back; with 3.1.1 it cannot.
        """
        return self._hears_itself or self._version is not MQTTProtocolVersion.MQTTv5

    def answer_address(self, response_address: str | None, sender: Address) -> Address | None:
        """See Brokered."""
        return None if self._speaker is None else self._speaker.answer_address(response_address, sender)

    async def start(self, receive: Receive) -> None:
        """Connect from now on, and again whenever the connection is lost; a broker that is away is waited for."""
        if self._core is None:
            raise TransportError(f"{self._url}: no publisher was set for this connection before its start")
        loop = asyncio.get_running_loop()
        self._receive, self._clock = receive, loop.time
        self._task = loop.create_task(self._keep_connected(), name=f"broker {self._url}")
        self._timer = loop.call_later(_CHECK_S, self._check)

    def send(self, datagram: bytes, address: Address | None = None) -> None:
        """Send a message that is not secured."""
        self.send_part(datagram, datagram, address)

    def send_part(self, part: bytes, plain: bytes, address: Address | None = None) -> None:
        """See Brokered."""
        if self._speaker is None:
            return
        self._speaker.send(part, plain, address, self._clock(), ticks_from_unix_ns(time.time_ns()))
        self.pump()

    async def close(self) -> None:
        """Send what is left for a moment, and disconnect. Safe to call twice."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._client is not None and self._core is not None:
            if self._version is not MQTTProtocolVersion.MQTTv5:
                self._core.clear_all(self._clock())
            self.pump()
            if not self._core.is_empty:
                self._emptied.clear()
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(_FLUSH_S):
                        await self._emptied.wait()
        self._is_closing = True
        task, self._task = self._task, None
        while task is not None and not task.done():
            task.cancel()  # once is not enough: the client may take it for the end of what it was at
            await asyncio.wait([task], timeout=_CANCEL_AGAIN_S)
        self._count()

    async def _keep_connected(self) -> None:
        while not self._is_closing:
            began, made = self._clock(), self._short
            self._was_stuck = False
            try:
                reason = await self._connect_and_stay()
            except (MQTTError, OSError, TimeoutError, ValueError) as error:
                reason = self._reason(error)
            except Exception as error:  # noqa: BLE001 - it costs this connection, and the next one is made
                reason = self._reason(error)
                _log.error("a mistake has ended the connection to the MQTT broker", url=self._url, exc_info=error)
            if not reason:
                continue
            if self._clock() - began > _LASTED_S:
                self._pauses.begin_anew()
                self._short = 0
            # A rival has connections closed that were made: a broker that is down, or acknowledges nothing, does not.
            if self._short >= _RIVALS_AFTER and self._short > made and not self._was_stuck:
                reason = (
                    f"{reason}; it is closed each time: is there another process with the ClientID {self._client_id}?"
                )
                if self._party is not None:
                    self._party.taken_over()
            self.stats.problem = f"{self._url}: {reason}"
            self._tell(reason)
            self._nodes.rotate(-1)
            self._url, self._address = self._nodes[0]
            await asyncio.sleep(self._pauses.next_s())

    async def _connect_and_stay(self) -> str:
        """Have one connection until it is over; why, or nothing where the next one is to be tried at once."""
        assert self._core is not None
        will = self._core.will(self._clock())
        if will is None and self._core.status_topic is not None:
            self.stats.problem = f"{self._url}: it waits for the keys of its own data"
            await asyncio.sleep(_KEY_WAIT_S)
            return ""
        lost: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._lost = lost
        client = self._make_client(will)
        try:
            try:
                await client.connect(self._address.host, self._address.port, ssl=self._credentials.tls)
            except (MalformedPacketError, ProtocolError) as error:
                if not self._falls_back(error):
                    raise
                return ""
            refused = await self._subscribe(client, self._core.filters)
            if refused and len(refused) == len(self._core.filters):
                return f"the broker refuses to deliver anything; {_LOOK_AT_RIGHTS}"
            self._opened(client)
            if refused:
                await self._subscribe_again(client, refused, lost)
            return await lost
        finally:
            self._closed()
            await _end(client)

    async def _subscribe(self, client: AsyncClient, filters: Mapping[str, int]) -> dict[str, int]:
        """Subscribe to each, one after the other, and return those that were refused.

        A cluster needs a while for each of them, and would answer one SUBSCRIBE with all of them too late. One of
        MQTT 3.1.1, as nats-server, is asked for no acknowledged delivery: that is a group of three there, which chooses
        who leads; where a node has died, that takes longer than the others wait, for each third of them (ADR 95).
        """
        is_5 = self._version is MQTTProtocolVersion.MQTTv5
        no_local, no_groups = is_5 and not self._hears_itself, len(self._nodes) > 1 and not is_5
        refused: dict[str, int] = {}
        for each, qos in filters.items():
            try:
                options = SubscribeOptions(qos=QoS(0 if no_groups and qos == 1 else qos), no_local=no_local)
                await client.subscribe([(each, options)], timeout=self._patience.answer_s)
            except SubscribeError:
                refused[each] = qos
        if refused:
            self._tell(f"the broker refuses to deliver {', '.join(refused)}; {_LOOK_AT_RIGHTS}")
        return refused

    async def _subscribe_again(self, client: AsyncClient, refused: dict[str, int], lost: asyncio.Future[str]) -> None:
        """Ask for what was refused until it is granted or the connection is lost: a busy cluster grants it later."""
        pause_s = _REFUSED_AGAIN_S
        while refused:
            await asyncio.wait([lost], timeout=pause_s)
            if lost.done():
                return
            pause_s = min(2.0 * pause_s, _REFUSED_LATEST_S)
            refused = await self._subscribe(client, refused)
        _log.info("the MQTT broker delivers what it had refused", url=self._url)

    def _make_client(self, will: bytes | None) -> AsyncClient:
        assert self._core is not None
        is_5 = self._version is MQTTProtocolVersion.MQTTv5
        topic = self._core.status_topic
        last: PublishMessage | None = None
        if will is not None and topic is not None:
            kind = None if self._speaker is None else Kind.STATUS
            properties = _properties(kind, self._content_type, None) if is_5 else None
            last = PublishMessage(topic, will, qos=1, retain=True, properties=properties)
        client = AsyncClient(
            self._client_id,
            protocol=self._version,
            clean_start=True,
            keepalive=self._keep_alive_s,
            username=self._credentials.user,
            password=self._credentials.password,
            will=last,
            maximum_packet_size=self._max_message_bytes + _MARGIN_BYTES,
            max_write_queue_bytes=_CLIENT_BYTES,
            max_unacknowledged_bytes=_CLIENT_BYTES,
            message_delivery="callback",
            ping_timeout=max(float(self._keep_alive_s), self._patience.answer_s),
            connect_timeout=self._patience.answer_s,
        )
        client.on_message = self._heard
        client.on_disconnect = self._disconnected
        return client

    def _falls_back(self, error: MQTTError) -> bool:
        """Go on with MQTT 3.1.1 where a broker refuses 5, also with a CONNACK of 3.1.1; and back where that fails too.

        What refuses with another reason than the version is left as it is.
        """
        if isinstance(error, ConnectRefusedError) and error.reason_code not in _UNACCEPTABLE_VERSION:
            return False
        if self._version is not MQTTProtocolVersion.MQTTv5:
            self._version = MQTTProtocolVersion.MQTTv5
            return False
        self._version = MQTTProtocolVersion.MQTTv311
        return True

    def _opened(self, client: AsyncClient) -> None:
        assert self._core is not None
        negotiated = client.negotiated
        self._can_retain, self._most_qos = negotiated.retain_available, negotiated.maximum_qos
        self._client = client
        self._short += 1
        self.stats.problem = "" if self._can_retain else f"{self._url}: the broker retains nothing"
        self._complaints.forget()
        if self._version is not MQTTProtocolVersion.MQTTv5 and not self._has_told_version:
            self._has_told_version = True
            _log.warning("the MQTT broker refuses MQTT 5, so 3.1.1 is used, where nothing expires", url=self._url)
        version = "5" if self._version is MQTTProtocolVersion.MQTTv5 else "3.1.1"
        _log.info("connected to the MQTT broker", url=self._url, mqtt=version, client_id=self._client_id)
        self._core.connected(self._clock(), negotiated.receive_maximum)
        self.pump()

    def _closed(self) -> None:
        if self._client is not None and self._core is not None:
            self._core.disconnected()
        self._client = self._lost = None
        self._emptied.set()

    def _disconnected(self, error: BaseException | None) -> None:
        if isinstance(error, BrokerDisconnectError) and error.reason_code == _TAKEN_OVER and self._party is not None:
            self._party.taken_over()
        self._end("the connection was closed" if error is None else self._reason(error))

    def _end(self, reason: str) -> None:
        if self._lost is not None and not self._lost.done():
            self._lost.set_result(reason)

    def _heard(self, message: Any) -> None:
        """Take a message at once, or, if it is not the first one of a turn of the event loop, in the next turn.

        The client has written the acknowledgement of the first one when it calls this, and writes those of the others
        after this turn. A broker has few messages in flight, mosquitto 20: it would wait until all of them are taken.
        """
        if self._is_behind:
            self._behind.append(message)
            return
        self._is_behind = True
        asyncio.get_running_loop().call_soon(self._catch_up)
        self._take(message)

    def _catch_up(self) -> None:
        behind, self._behind = self._behind, []
        self._is_behind = False
        if self._task is not None:
            for message in behind:
                self._take(message)

    def _take(self, message: Any) -> None:
        core, receive = self._core, self._receive
        assert core is not None
        assert receive is not None
        self.stats.received += 1
        topic, payload, sender = message.topic, message.payload, (message.topic, 0)
        try:
            if self._speaker is not None and not message.retain and self._speaker.is_usual(topic, payload):
                receive(payload, sender)  # most are values, and cost the least so
            else:
                self._hand_on(core.received(topic, payload, self._clock(), is_retained=message.retain), sender)
        except Exception as error:  # noqa: BLE001 - whatever is wrong with one message, others are behind it
            self.stats.malformed["mistake"] += 1
            _log.error("a mistake has cost a message of the MQTT broker", topic=topic[:200], exc_info=error)

    def _hand_on(self, found: Iterable[Heard], sender: Address) -> None:
        party, receive = self._party, self._receive
        for datagram, is_fresh in found:
            assert party is not None
            assert receive is not None
            if is_fresh:
                receive(datagram, sender)
            else:
                party.receive_kept(datagram, sender)

    def pump(self) -> None:
        """Send what may be sent now."""
        client, core = self._client, self._core
        if client is None or core is None:
            return
        for outgoing in core.take(self._clock()):
            self._publish(client, core, outgoing)

    def _publish(self, client: AsyncClient, core: Carried, outgoing: Outgoing) -> None:
        is_5 = self._version is MQTTProtocolVersion.MQTTv5
        try:
            receipt = client.publish_nowait(
                outgoing.topic,
                outgoing.payload,
                qos=min(outgoing.qos, self._most_qos),
                retain=outgoing.is_retained and self._can_retain,
                properties=_properties(outgoing.kind, self._content_type, outgoing.expiry_s) if is_5 else None,
            )
        except (FlowControlError, NotConnectedError) as error:
            self._end(self._reason(error))  # what is in flight waits again, in its place
        except (MQTTError, ValueError) as error:
            core.acknowledged(outgoing.parcel, is_refused=True)
            self._tell(f"a message to {outgoing.topic} was refused: {self._reason(error)}")
        else:
            self.stats.sent += 1
            receipt.add_done_callback(partial(self._done, client, outgoing))

    def _done(self, client: AsyncClient, outgoing: Outgoing, receipt: PublishReceipt) -> None:
        if client is not self._client or self._core is None:
            return  # of a connection that is over: what was in flight waits again
        error = receipt.exception()
        if error is not None and not isinstance(error, PublishRejectedError):
            return
        if error is not None:
            self._tell(f"the broker refused a message to {outgoing.topic} with reason code {error.reason_code:#04x}")
        self._core.acknowledged(outgoing.parcel, is_refused=error is not None)
        self.pump()
        if self._core.is_empty:
            self._emptied.set()

    def _check(self) -> None:
        """Four times a second: what is due, and whether the broker still answers."""
        assert self._core is not None
        self._timer = asyncio.get_running_loop().call_later(_CHECK_S, self._check)
        now = self._clock()
        self._core.poll(now)
        self._hand_on(self._core.late(now), _LATE)
        if self._client is not None and self._core.is_stuck(now):
            self._was_stuck = True
            self._end("the broker does not acknowledge what it is sent")
        self.pump()
        self._count()

    def _count(self) -> None:
        core = self._core
        if core is None:
            return
        for cause, count in core.take_drops().items():
            self.stats.drops[Drop(cause)] += count
        self.stats.malformed += core.malformed
        self.stats.forgiven += core.take_forgiven()
        core.malformed.clear()
        for name, detail in core.details.items():
            self._tell("a message was dropped", cause=name, detail=detail)
        core.details.clear()

    def _reason(self, error: BaseException) -> str:
        return _reason(error, self._credentials.section)

    def _tell(self, reason: str, **details: str) -> None:
        self._complaints.tell(self._url, reason, self._clock(), **details)


def _properties(kind: Kind | None, content_type: str, expiry_s: int | None) -> Properties:
    """The properties of a message (OPC 10000-14 table 207)."""
    values: dict[str, Any] = {"content_type": content_type}
    if kind is not None:
        values["user_property"] = ("UAMessageType", f"ua-{kind.value}")
    if expiry_s is not None:
        values["message_expiry_interval"] = expiry_s
    return Properties(values)


def _reason(error: BaseException, section: str) -> str:
    if isinstance(error, ConnectRefusedError) and error.reason_code in _NOT_AUTHORIZED:
        return f"the broker refuses this user or certificate; look at `{section}` and at the broker's users"
    if isinstance(error, BrokerDisconnectError) and error.reason_code == _TAKEN_OVER:
        return "another process has connected to the broker as this one"
    return " ".join(str(error).split()) or type(error).__name__


async def _end(client: AsyncClient) -> None:
    """Leave a broker in order, as far as it answers."""
    try:
        async with asyncio.timeout(_FLUSH_S):
            await client.disconnect()
    except (MQTTError, OSError, TimeoutError):
        pass
    finally:
        # A connection that breaks as this process ends it leaves its reason there, and asyncio calls that a mistake.
        answer: asyncio.Future[Any] | None = getattr(client, "_connack_fut", None)
        if answer is not None and answer.done() and not answer.cancelled():
            answer.exception()
