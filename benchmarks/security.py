"""Securing and opening a datagram, beside the AES and HMAC calls that it cannot do without.

The floor makes the same ciphertext and tag over the same bytes, or checks the tag and decrypts, in the fastest way that
`cryptography` has: one cipher context with `reset_nonce`, a copy of one HMAC state. All that it is given is cut out for
it beforehand, and it puts nothing together. Before anything is timed, both have to agree. Times are those of the
processor, in short turns.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any, Final, NamedTuple

from cryptography.hazmat.primitives.ciphers import Cipher
from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.ciphers.modes import CTR
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.hmac import HMAC

from benchmarks.harness import Figure, at_most, interleaved, shown
from ua_fleet.wire import (
    Codec,
    MessageKey,
    SecuredDatagram,
    SecurityMode,
    SecurityPolicy,
    payload_offset,
    read_security,
)

GOAL: Final = 1.5
ROUNDS: Final = 20
MESSAGES: Final = 16
"""So few that they stay in the fastest cache, as a datagram does that was received or encoded a moment ago."""
REPEATS: Final = 160
NOON: Final = 133_500_000_000_000_000
TOKEN_ID: Final = 7
FIRST_BLOCK: Final = b"\0\0\0\1"

SIGN, ENCRYPT = SecurityMode.SIGN, SecurityMode.SIGN_AND_ENCRYPT
FORMS: Final = {
    "SignAndEncrypt Aes256": (SecurityPolicy.AES256_CTR, ENCRYPT),
    "SignAndEncrypt Aes128": (SecurityPolicy.AES128_CTR, ENCRYPT),
    "Sign": (SecurityPolicy.AES256_CTR, SIGN),
}

_Types = tuple[int, ...]
_Make = Callable[[int], tuple[Any, ...]]


def _ten(index: int) -> tuple[Any, ...]:
    return (True, index, 7, -index, 0.5, 1.5, -2.5, float(index), NOON + index, "robot-7")


def _fifty(index: int) -> tuple[Any, ...]:
    return tuple(float(index + field) for field in range(50))


LAYOUTS: Final[dict[str, tuple[_Types, _Make]]] = {
    "1x10": ((1, 6, 7, 8, 10, 11, 11, 11, 13, 12), _ten),
    "1x50": ((11,) * 50, _fifty),
}


class _Message(NamedTuple):
    """One message, and what the raw calls take and give."""

    plain: bytes
    nonce: bytes
    secured: bytes
    counter_block: bytes
    payload: bytes
    ciphertext: bytes
    signed: bytes
    tag: bytes


def _messages(key: MessageKey, key_data: bytes, mode: SecurityMode, types: _Types, make: _Make) -> list[_Message]:
    plan = Codec().writer_plan(2, 2, 1001, types, 8, 9)
    messages: list[_Message] = []
    for index in range(MESSAGES):
        plain = plan.encode(index, NOON + 10_000 * index, 0, make(index))
        nonce = b"\2\0\7\7" + (index + 1).to_bytes(4, "little")
        secured = key.protect(plain, payload_offset(plain), TOKEN_ID, nonce, mode)
        heard = read_security(secured)
        assert key.unprotect(heard) == plain
        block = key_data[-4:] + nonce + FIRST_BLOCK
        payload, ciphertext = plain[payload_offset(plain) :], secured[heard.payload_offset : -32]
        messages.append(_Message(plain, nonce, secured, block, payload, ciphertext, secured[:-32], secured[-32:]))
    return messages


class _Floor:
    """The raw calls, timed with nothing between them."""

    def __init__(self, key_data: bytes, messages: list[_Message], mode: SecurityMode) -> None:
        self._mac = HMAC(key_data[:32], SHA256()).copy
        context = Cipher(AES(key_data[32:-4]), CTR(bytes(16))).encryptor()
        self._reset_nonce, self._update = context.reset_nonce, context.update
        self._messages, self._encrypted = messages, mode is ENCRYPT

    def check(self) -> None:
        """That the calls make what ours made."""
        for message in self._messages:
            mac = self._mac()
            mac.update(message.signed)
            assert mac.finalize() == message.tag
            if self._encrypted:
                self._reset_nonce(message.counter_block)
                assert self._update(message.payload) == message.ciphertext

    def protect(self) -> float:
        new_mac, reset_nonce, update, encrypted = self._mac, self._reset_nonce, self._update, self._encrypted
        messages = [(message.counter_block, message.payload, message.signed) for message in self._messages]
        started = time.process_time()
        for _ in range(REPEATS):
            for block, payload, signed in messages:
                if encrypted:
                    reset_nonce(block)
                    update(payload)
                mac = new_mac()
                mac.update(signed)
                mac.finalize()
        return (time.process_time() - started) / (REPEATS * MESSAGES)

    def unprotect(self) -> float:
        new_mac, reset_nonce, update, encrypted = self._mac, self._reset_nonce, self._update, self._encrypted
        messages = [(part.counter_block, part.ciphertext, part.signed, part.tag) for part in self._messages]
        started = time.process_time()
        for _ in range(REPEATS):
            for block, ciphertext, signed, tag in messages:
                mac = new_mac()
                mac.update(signed)
                mac.verify(tag)
                if encrypted:
                    reset_nonce(block)
                    update(ciphertext)
        return (time.process_time() - started) / (REPEATS * MESSAGES)


def _protect(key: MessageKey, messages: list[_Message], mode: SecurityMode) -> float:
    offset = payload_offset(messages[0].plain)
    pairs = [(message.plain, message.nonce) for message in messages]
    started = time.process_time()
    for _ in range(REPEATS):
        for plain, nonce in pairs:
            key.protect(plain, offset, TOKEN_ID, nonce, mode)
    return (time.process_time() - started) / (REPEATS * MESSAGES)


def _send(key: MessageKey, messages: list[_Message], mode: SecurityMode) -> float:
    """As `_protect`, with the search for the payload."""
    pairs = [(message.plain, message.nonce) for message in messages]
    started = time.process_time()
    for _ in range(REPEATS):
        for plain, nonce in pairs:
            key.protect(plain, payload_offset(plain), TOKEN_ID, nonce, mode)
    return (time.process_time() - started) / (REPEATS * MESSAGES)


def _unprotect(key: MessageKey, heard: list[SecuredDatagram]) -> float:
    started = time.process_time()
    for _ in range(REPEATS):
        for secured in heard:
            key.unprotect(secured)
    return (time.process_time() - started) / (REPEATS * MESSAGES)


def _receive(key: MessageKey, messages: list[_Message]) -> float:
    """As `unprotect`, with the reading of the SecurityHeader, which finds out what key it needs."""
    datagrams = [message.secured for message in messages]
    started = time.process_time()
    for _ in range(REPEATS):
        for datagram in datagrams:
            key.unprotect(read_security(datagram))
    return (time.process_time() - started) / (REPEATS * MESSAGES)


def _figures(form: str, layout: str, rounds: int) -> list[Figure]:
    policy, mode = FORMS[form]
    key_data = bytes(range(policy.key_data_bytes))
    key = MessageKey(policy, key_data)
    messages = _messages(key, key_data, mode, *LAYOUTS[layout])
    floor = _Floor(key_data, messages, mode)
    floor.check()
    heard = [read_security(message.secured) for message in messages]
    protect, send, unprotect, receive, least_to_protect, least_to_unprotect = interleaved(
        ROUNDS * rounds,
        [
            partial(_protect, key, messages, mode),
            partial(_send, key, messages, mode),
            partial(_unprotect, key, heard),
            partial(_receive, key, messages),
            floor.protect,
            floor.unprotect,
        ],
    )
    reference = "raw AES and HMAC calls" if mode is ENCRYPT else "raw HMAC calls"

    def row(what: str, value: float, least: float, goal: float | None = None) -> Figure:
        name = f"{what} {form} {layout}"
        if goal is None:
            return shown(name, value * 1e6, "us", reference=reference, reference_value=least * 1e6)
        return at_most(name, value * 1e6, "us", reference=reference, reference_value=least * 1e6, goal=goal)

    # A signed message has no AES call, and half of an HMAC is less than one Python call that cuts and joins bytes.
    goal = GOAL if mode is ENCRYPT else None
    return [
        row("protect", protect, least_to_protect, goal),
        row("unprotect", unprotect, least_to_unprotect, goal),
        row("find the payload and protect", send, least_to_protect),
        row("read the header and unprotect", receive, least_to_unprotect),
    ]


def figures(rounds: int) -> list[Figure]:
    return [figure for form in FORMS for layout in LAYOUTS for figure in _figures(form, layout, rounds)]
