"""The streams of the load benchmark, and the least that two processes need between them: bytes in UDP chunks."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import struct
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

__all__ = ["KEY_VARIABLE", "RATES_HZ", "Arrivals", "Bare", "ChunkReceiver", "ChunkSender", "due_times", "sizes"]

RATES_HZ = {"imu": 200.0, "image": 10.0, "scan": 20.0, "cloud": 5.0}
sizes = {"image": 1_000_000, "cloud": 2_000_000, "ranges": 1000}
"""Bytes of an image and of a point cloud, and numbers of a scan."""

_HEADER = struct.Struct("<HIII")
_DATA_BYTES = 65_507 - 56
"""Of a datagram of our own chunks, behind their headers."""
_NONCE = struct.Struct("<Q")
_TAG_BYTES = 32
KEY_VARIABLE = "LOAD_FLOOR_KEY"
"""In the environment: 64 bytes in hexadecimal, for AES-256 and HMAC-SHA256. Without it there is no security."""


class Bare:
    """The AES and HMAC calls that securing a datagram cannot do without, and nothing else of message security."""

    def __init__(self, key: bytes) -> None:
        # Not there in the environment of ROS 1, which has no use for it.
        from cryptography.hazmat.primitives.ciphers import Cipher
        from cryptography.hazmat.primitives.ciphers.algorithms import AES
        from cryptography.hazmat.primitives.ciphers.modes import CTR
        from cryptography.hazmat.primitives.hashes import SHA256
        from cryptography.hazmat.primitives.hmac import HMAC

        self._mac = HMAC(key[:32], SHA256()).copy
        self._cipher = Cipher(AES(key[32:]), CTR(bytes(16))).encryptor()
        self._number = 0

    @classmethod
    def of_environment(cls) -> Bare | None:
        key = os.environ.get(KEY_VARIABLE)
        return cls(bytes.fromhex(key)) if key else None

    def _crypt(self, nonce: bytes, data: Any) -> bytes:
        self._cipher.reset_nonce(nonce + bytes(8))
        return self._cipher.update(data)

    def protect(self, header: bytes, data: Any) -> tuple[bytes, ...]:
        """The parts of a datagram."""
        self._number += 1
        nonce = _NONCE.pack(self._number)
        ciphertext, mac = self._crypt(nonce, data), self._mac()
        for part in (header, nonce, ciphertext):
            mac.update(part)
        return header, nonce, ciphertext, mac.finalize()

    def unprotect(self, datagram: bytes) -> memoryview:
        """The data; raises InvalidSignature."""
        view, mac = memoryview(datagram), self._mac()
        mac.update(view[:-_TAG_BYTES])
        mac.verify(datagram[-_TAG_BYTES:])
        at = _HEADER.size + _NONCE.size
        return memoryview(self._crypt(datagram[_HEADER.size : at], view[at:-_TAG_BYTES]))


def due_times(seconds: float, names: Sequence[str]) -> Iterator[tuple[float, str]]:
    """When each stream publishes, in order, from now on."""
    start = time.monotonic()
    yield from sorted(
        (start + number / RATES_HZ[name], name) for name in names for number in range(int(seconds * RATES_HZ[name]))
    )


def serve_publisher(publish: Callable[[str, str], None], linked: Callable[[str], int]) -> None:
    """Do what comes on stdin: `SECONDS STREAM=TOPIC...` publishes, `links TOPIC` tells who listens."""
    print("ready", flush=True)
    for line in sys.stdin:
        first, *rest = line.split()
        if first == "links":
            print(f"links {linked(rest[0])}", flush=True)
            continue
        topics = dict(each.split("=") for each in rest)
        sent = dict.fromkeys(topics, 0)
        for due, name in due_times(float(first), tuple(topics)):
            left = due - time.monotonic()
            if left > 0:
                time.sleep(left)
            publish(name, topics[name])
            sent[name] += 1
        print(f"done {json.dumps(sent)}", flush=True)


class Arrivals:
    """Notes how old messages are by the stamp in their header, which stands in their bytes."""

    def __init__(self, stamp: struct.Struct, offset: int) -> None:
        self._unpack, self._offset = stamp.unpack_from, offset
        self._ages: dict[str, list[float]] = {}

    def heard(self, topic: str, content: bytes) -> None:
        now = time.time()
        seconds, nanoseconds = self._unpack(content, self._offset)
        self._ages.setdefault(topic, []).append(now - seconds - nanoseconds / 1e9)

    def serve(self) -> None:
        """For each line on stdin, what has arrived since the last one: `{topic: [ages in s]}`."""
        print("ready", flush=True)
        for _ in sys.stdin:
            taken, self._ages = self._ages, {}
            print(json.dumps({topic: [round(age, 6) for age in ages] for topic, ages in taken.items()}), flush=True)


class ChunkSender:
    """Sends the bytes of a message to a group, without a copy."""

    def __init__(self, group: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
        self._socket.connect((group, port))
        self._number = 0
        self._bare = Bare.of_environment()

    def send(self, topic: int, content: Any) -> None:
        self._number += 1
        total, view = len(content), memoryview(content)
        for offset in range(0, total, _DATA_BYTES):
            header = _HEADER.pack(topic, self._number & 0xFFFF_FFFF, offset, total)
            data = view[offset : offset + _DATA_BYTES]
            self._socket.sendmsg((header, data) if self._bare is None else self._bare.protect(header, data))


class ChunkReceiver:
    """Puts them together again; what lacks a chunk is lost with the next message of its topic."""

    def __init__(self, group: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        for option in (socket.SO_RCVBUF, 33):  # 33 is SO_RCVBUFFORCE
            with contextlib.suppress(OSError):
                self._socket.setsockopt(socket.SOL_SOCKET, option, 4 * 1024 * 1024)
        self._socket.bind((group, port))
        membership = socket.inet_aton(group) + socket.inet_aton("127.0.0.1")
        self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        self._parts: dict[int, tuple[int, list[memoryview], int]] = {}
        self._bare = Bare.of_environment()

    def receive(self) -> tuple[int, bytes | memoryview]:
        """The next whole message; blocks."""
        while True:
            datagram = self._socket.recv(65_536)
            topic, number, _, total = _HEADER.unpack_from(datagram)
            data = memoryview(datagram)[_HEADER.size :] if self._bare is None else self._bare.unprotect(datagram)
            if len(data) == total:
                return topic, bytes(data)
            known = self._parts.get(topic)
            if known is None or known[0] != number:
                known = (number, list[memoryview](), 0)
            parts, received = known[1], known[2] + len(data)
            parts.append(data)
            self._parts[topic] = (number, parts, received)
            if received == total:
                del self._parts[topic]
                return topic, b"".join(parts)
