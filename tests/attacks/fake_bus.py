"""A D-Bus that forwards what no bus may: dbus-daemon and dbus-broker put out whoever sends a text that is no UTF-8."""

# pyright: reportUnknownMemberType=false, reportPrivateUsage=false

from __future__ import annotations

import contextlib
import socket
import threading
from pathlib import Path
from typing import Self

from dbus_fast import Message, MessageType
from dbus_fast._private.unmarshaller import Unmarshaller

__all__ = ["FakeBus"]

NOT_TEXT = b"\xff\xfe\xfd\xfc"


class FakeBus:
    """Its one program `trbots.tap` says a text, and then one that is none, to each who connects."""

    def __init__(self, path: Path) -> None:
        self.address = f"unix:path={path}"
        self.met = 0
        """Connections so far."""
        self._path = path

    def __enter__(self) -> Self:
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(self._path))
        self._listener.listen()
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                link, _ = self._listener.accept()
                self.met += 1
                threading.Thread(target=self._meet, args=(link,), daemon=True).start()

    def _meet(self, link: socket.socket) -> None:
        with link, link.makefile("rwb") as stream, contextlib.suppress(OSError, EOFError):
            for line in iter(stream.readline, b"BEGIN\r\n"):
                if not line:
                    return
                answer = b"OK 1234567890abcdef1234567890abcdef" if b"AUTH" in line else b"ERROR"
                link.sendall(answer + b"\r\n")
            while (asked := Unmarshaller(stream).unmarshall()) is not None:
                if asked.member in ("Hello", "GetNameOwner"):
                    link.sendall(_answer(asked, ":1.1" if asked.member == "Hello" else ":1.7"))
                if asked.member == "GetNameOwner":
                    link.sendall(_said("fine", 1000))
                    link.sendall(_said("abcd", 1001).replace(b"abcd", NOT_TEXT))


def _answer(asked: Message, text: str) -> bytes:
    message = Message.new_method_return(asked, "s", [text])
    message.sender, message.serial = "org.freedesktop.DBus", asked.serial
    return bytes(message._marshall(False))


def _said(text: str, serial: int) -> bytes:
    message = Message(
        message_type=MessageType.SIGNAL,
        path="/",
        interface="trbots.tap",
        member="Value",
        signature="s",
        body=[text],
        sender=":1.7",
        serial=serial,
    )
    return bytes(message._marshall(False))
