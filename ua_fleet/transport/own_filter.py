"""A socket filter for what a process has itself sent to its group: the kernel drops it before it wakes the process.

A member of a multicast group hears itself, and the subscriber drops that by the loop rule. Until then each datagram
has cost a wake-up, a copy, and a place in the receive buffer: of a large message as much as to receive a foreign one.
The filter goes by the address and port that the datagram came from, which are the sender's own as long as it is open.
So whatever another process sends comes through, with our PublisherId too; the loop rule judges it as before.

The kernel counts what a filter drops among the drops of the socket: who reads those has to take our own away.
"""

from __future__ import annotations

import ctypes
import socket
import struct
from typing import Final

__all__ = ["attach_own_filter"]

# Linux's numbers, which Python has no names for.
_SO_ATTACH_FILTER: Final = 26
_NETWORK_HEADER: Final = 0xFFF0_0000
"""SKF_NET_OFF: offsets from here on count from the IP header; others from the UDP header."""
_SOURCE_ADDRESS_AT: Final = {4: 12, 16: 8}
"""Where the source address stands in the header of IPv4 and of IPv6, by its length."""
_SOURCE_PORT_AT: Final = 0
# Instructions of classic BPF (linux/bpf_common.h).
_LOAD_HALF, _LOAD_WORD, _JUMP_IF_EQUAL, _RETURN = 0x28, 0x20, 0x15, 0x06
_ALL: Final = 0xFFFF_FFFF
_INSTRUCTION: Final = struct.Struct("HBBI")


def _program(address: bytes, port: int) -> bytes:
    """Drop what comes from there. The last instruction lets in; each comparison that fails jumps to it."""
    at = _NETWORK_HEADER + _SOURCE_ADDRESS_AT[len(address)]
    words = [
        (_LOAD_WORD, at + start, int.from_bytes(address[start : start + 4], "big"))
        for start in range(0, len(address), 4)
    ]
    compared = [(_LOAD_HALF, _SOURCE_PORT_AT, port), *words]
    instructions: list[tuple[int, int, int, int]] = []
    for left, (load, offset, wanted) in zip(reversed(range(len(compared))), compared, strict=True):
        instructions += [(load, 0, 0, offset), (_JUMP_IF_EQUAL, 0, 2 * left + 1, wanted)]
    instructions += [(_RETURN, 0, 0, 0), (_RETURN, 0, 0, _ALL)]
    return b"".join(_INSTRUCTION.pack(*each) for each in instructions)


def attach_own_filter(receiver: socket.socket, sender: socket.socket) -> bool:
    """Have a UDP socket not hear what another one sends, from now on; False where this kernel has no filters.

    A filter that the receiver had before is replaced.
    """
    host, port, *_ = sender.getsockname()
    program = _program(socket.inet_pton(sender.family, host), port)
    buffer = ctypes.create_string_buffer(program, len(program))
    described = struct.pack("HP", len(program) // _INSTRUCTION.size, ctypes.addressof(buffer))
    try:
        receiver.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, described)
    except OSError:
        return False
    return True
