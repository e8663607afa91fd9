"""For whom a transport over a broker speaks: what it has to know of the process above it."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from ua_fleet.transport.addresses import answer_address
from ua_fleet.transport.base import Address, Receive, Sends

__all__ = ["Answers", "Brokered", "NamesOf", "Party", "answers_of", "tool_party"]

Answers = Callable[[str | None, Address], Address | None]
"""Where the response to a request goes, of its ResponseAddress and where it came from; None where none may go."""


NamesOf = Callable[[int | str, int], tuple[str, str] | None]
"""The names of the WriterGroup and the DataSetWriter of a PublisherId with an id; None where there is none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Party:
    """One process, as its transport needs it."""

    publisher_id: int | None
    """None for a tool that only listens and asks."""
    seal: Callable[[bytes, float], list[bytes]]
    """Secures a plain message: `Envelope.seal`."""
    token: Callable[[float], int]
    """The SecurityTokenId with which it is secured now: `Envelope.sending_token`."""
    is_secured: bool
    """Whether there is nothing to say without keys."""
    names_of: Callable[[int], tuple[str, str] | None]
    """The names of the WriterGroup and the DataSetWriter with an id: `Publisher.names_of`."""
    names_of_origin: NamesOf | None = None
    """Of a relay, which speaks for others, in place of `names_of`."""
    receive_kept: Receive
    """Takes what the broker had kept, as `receive` takes what is fresh."""
    taken_over: Callable[[], None] = lambda: None
    """Told that another process has connected to the broker as this one."""
    setpoint_groups: Collection[int] = ()
    """WriterGroups of setpoints."""

    def names(self, publisher_id: int | str, writer_id: int) -> tuple[str, str] | None:
        """The names of a DataSetWriter that it speaks for."""
        return (
            self.names_of(writer_id) if self.names_of_origin is None else self.names_of_origin(publisher_id, writer_id)
        )


@runtime_checkable
class Brokered(Protocol):
    """A transport over a broker, which finds out from a message where it goes."""

    def speak_for(self, party: Party) -> None:
        """Learn for whom it speaks; before `start`."""
        ...

    def send_part(self, part: bytes, plain: bytes, address: Address | None = None) -> None:
        """Send a datagram of a message, which is given as it was before it was secured and split."""
        ...

    def answer_address(self, response_address: str | None, sender: Address) -> Address | None:
        """Where the response to a request goes; None where none may go there."""
        ...


def answers_of(transport: Sends) -> Answers:
    """Where the responses to requests go that came by a transport."""
    return transport.answer_address if isinstance(transport, Brokered) else answer_address


def tool_party(receive_kept: Receive) -> Party:
    """A tool that has no PublisherId and secures nothing: it listens, and sends probes."""
    return Party(
        publisher_id=None,
        seal=lambda plain, _now: [plain],
        token=lambda _now: 0,
        is_secured=False,
        names_of=lambda _writer_id: None,
        receive_kept=receive_kept,
    )
