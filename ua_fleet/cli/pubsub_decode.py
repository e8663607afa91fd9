"""`ua-fleet pubsub decode`: the bytes of PubSub messages, and what each of them says."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ua_fleet.cli.endings import EXIT_FAILED, UsageError
from ua_fleet.cli.options import Json
from ua_fleet.cli.output import message, print_json, print_line

if TYPE_CHECKING:
    from ua_fleet.cli.inspection import Inspected
    from ua_fleet.dissect.spans import ByteSpan
    from ua_fleet.wire.security import MessageKey

__all__ = ["EXAMPLES", "decode", "key_of", "table"]

EXAMPLES = (
    "ua-fleet pubsub decode 'f1 01 ba08 01 6400 01 4df4 01 0100 0b 0000000000803540'",
    "ua-fleet pubsub decode --key KEYDATA_HEX --json f111ba08016400014df403...",
    "xxd -p -c 0 datagram.bin | ua-fleet pubsub decode -",
)

BYTES_IN_A_ROW: Final = 8
"""Longer values go on in the next rows."""


def decode(
    encoded: Annotated[
        list[str],
        typer.Argument(metavar="HEX...", help="Messages in hexadecimal; - reads them from stdin, one a line."),
    ],
    key: Annotated[
        str | None,
        typer.Option(
            metavar="KEYDATA_HEX",
            envvar="UA_FLEET_PUBSUB_KEY",
            help="Key data as GetSecurityKeys gives it: 52 bytes for PubSub-Aes128-CTR, 68 for PubSub-Aes256-CTR.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Name every byte of PubSub messages (UADP), with its offset and what it says.

    With the key of its SecurityGroup, a secured message is verified and decrypted. Without, one that is only signed is
    shown (its `verified` is null), and of an encrypted one the headers. Chunks given together are put together. Exit
    code 1, with the reason, if a message is malformed, does not verify, or is encrypted and there is no key; 2 for what
    is no hexadecimal, and for a key of a wrong length.
    """
    from ua_fleet.cli.inspection import Inspector
    from ua_fleet.cli.message_json import inspected_as_json

    inspector = Inspector(None if key is None else key_of(key))
    datagrams = list(_datagrams(encoded))
    failed = False
    for number, datagram in enumerate(datagrams, 1):
        inspected = inspector.inspect(datagram)
        label = f"message {number} of {len(datagrams)}: " if len(datagrams) > 1 else ""
        if as_json:
            print_json(inspected_as_json(inspected))
        else:
            _print(inspected, label)
        if inspected.error is not None:
            message(f"{label}{inspected.error}")
        elif inspected.is_unverified:
            message(f"{label}signed, not verified: no --key was given")
        failed = failed or inspected.error is not None
    if inspector.incomplete:
        message(f"chunks are missing of {inspector.incomplete} message{'s' * (inspector.incomplete > 1)}")
    if failed:
        raise typer.Exit(EXIT_FAILED)


def _print(inspected: Inspected, label: str) -> None:
    print_line(f"{label}{len(inspected.datagram)} bytes{_security_text(inspected)}")
    for line in table(inspected.spans):
        print_line(line)
    whole = inspected.whole
    if whole is not None:
        print_line(f"put together: {len(whole.datagram)} bytes")
        for line in table(whole.spans):
            print_line(line)


def _security_text(inspected: Inspected) -> str:
    from ua_fleet.cli.message_json import MODES
    from ua_fleet.wire.security import SecurityMode

    heard = inspected.security
    if heard is None:
        return ""
    if heard.mode is SecurityMode.NONE:
        return ", not secured"
    verified = {True: "verified", False: "does not verify", None: "not verified, no key"}[inspected.verified]
    opened = ", shown decrypted" if inspected.verified and heard.mode is SecurityMode.SIGN_AND_ENCRYPT else ""
    return f", {MODES[heard.mode]}, token {heard.token_id}, {verified}{opened}"


def key_of(text: str) -> MessageKey:
    """The key that an option names; the error never repeats it."""
    from ua_fleet.wire.security import MessageKey, SecurityPolicy

    try:
        key_data = _bytes_of(text)
    except ValueError:
        raise UsageError("--key: this is no hexadecimal; give the key data as pairs of 0-9, a-f") from None
    for policy in SecurityPolicy:
        if policy.key_data_bytes == len(key_data):
            return MessageKey(policy, key_data)
    sizes = ", ".join(f"{policy.key_data_bytes} ({policy.rpartition('#')[2]})" for policy in SecurityPolicy)
    raise UsageError(f"--key: key data of {len(key_data)} bytes; there are keys of {sizes}")


def _bytes_of(text: str) -> bytes:
    return bytes.fromhex(text.lower().replace("0x", ""))


def _datagrams(encoded: Sequence[str]) -> Iterator[bytes]:
    for argument in encoded:
        for line in _lines_of_stdin() if argument == "-" else [argument]:
            try:
                yield _bytes_of(line)
            except ValueError:
                shown = line.strip()
                shown = f"{shown[:40]}..." if len(shown) > 40 else shown
                raise UsageError(
                    f"{shown!r} is no hexadecimal; give the bytes of one message as pairs of 0-9, a-f"
                ) from None


def _lines_of_stdin() -> list[str]:
    # What is no text, a datagram itself for one, has to be told of as no hexadecimal.
    lines = [line for line in sys.stdin.buffer.read().decode("ascii", "replace").splitlines() if line.strip()]
    if not lines:
        raise UsageError("stdin holds no message; write one a line, as pairs of 0-9, a-f")
    return lines


def table(spans: Sequence[ByteSpan]) -> Iterator[str]:
    """The lines that show the bytes of a message: offset, length, bytes, name and meaning, under the part's name."""
    if not spans:
        return
    names = max(len(span.name) for span in spans)
    row = f"{{:>6}}  {{:>6}}  {{:{3 * BYTES_IN_A_ROW - 1}}}  {{:{names}}}  {{}}"
    yield row.format("offset", "length", "bytes", "field", "value").rstrip()
    section = ""
    for span in spans:
        if span.section != section:
            section = span.section
            yield f"{section}:"
        rows = [span.data[at : at + BYTES_IN_A_ROW].hex(" ") for at in range(0, len(span.data), BYTES_IN_A_ROW)]
        yield row.format(span.offset, len(span.data), rows[0], span.name, span.meaning).rstrip()
        for at, more in enumerate(rows[1:], 1):
            yield row.format(span.offset + at * BYTES_IN_A_ROW, "", more, "", "").rstrip()
