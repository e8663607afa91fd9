"""PubSub messages taken apart for the page: which bytes are called what, and say what."""

from __future__ import annotations

from typing import Any

from ua_fleet.dissect.annotate import annotate
from ua_fleet.dissect.kind_text import kind_text
from ua_fleet.errors import RemoteWireError
from ua_fleet.wire import Codec
from ua_fleet.wire.outline import is_chunk
from ua_fleet.wire.security import SecuredDatagram, SecurityMode, read_security, without_security

__all__ = ["dissected", "headline"]


def headline(message: bytes, *, is_open: bool = True) -> dict[str, Any]:
    """Whose a message is, by its headers; and of what kind, unless that is encrypted."""
    try:
        heard = read_security(message)
    except RemoteWireError:
        return {"publisher": None, "group": None, "writers": [], "kind": ""}
    return {
        "publisher": None if heard.publisher_id is None else str(heard.publisher_id),
        "group": heard.writer_group_id,
        "writers": list(heard.writer_ids),
        "kind": kind_text(message) if is_open or heard.mode is not SecurityMode.SIGN_AND_ENCRYPT else "",
    }


def dissected(message: bytes, *, is_open: bool, is_whole: bool) -> dict[str, Any]:
    """The spans of a message, in order, each byte in one of them; and why it cannot be decoded, where that is so.

    Args:
        message: as it was sent.
        is_open: with what was encrypted in plain.
        is_whole: else its end is missing.
    """
    try:
        heard = read_security(message)
    except RemoteWireError as error:
        return {"spans": _spans(message, is_open=is_open, error=error), "error": str(error)}
    refused = _refused(heard, is_open=is_open) if is_whole else None
    # Of a secured message the decoder sees the plain form, in which all stands elsewhere.
    told = refused if heard.mode is SecurityMode.NONE else None
    return {"spans": _spans(message, is_open=is_open, error=told), "error": "" if refused is None else str(refused)}


def _refused(heard: SecuredDatagram, *, is_open: bool) -> RemoteWireError | None:
    if is_chunk(heard.datagram) or (heard.mode is SecurityMode.SIGN_AND_ENCRYPT and not is_open):
        return None
    try:
        Codec().decode(heard.datagram if heard.mode is SecurityMode.NONE else without_security(heard))
    except RemoteWireError as error:
        return error
    return None


def _spans(message: bytes, *, is_open: bool, error: RemoteWireError | None) -> list[dict[str, Any]]:
    return [
        {
            "at": span.offset,
            "size": len(span.data),
            "section": span.section,
            "name": span.name,
            "text": span.meaning,
        }
        for span in annotate(message, is_open=is_open, error=error)
    ]
