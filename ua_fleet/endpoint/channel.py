"""The OPC UA Connection Protocol and the SecureChannel of one connection (OPC 10000-6 sections 6.7 and 7.1).

asyncua decodes, decrypts and verifies the chunks. This module decides what may be opened, with which certificate, for
how long, and how much a client may send.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, NoReturn

from asyncua import ua
from asyncua.common.connection import TransportLimits
from asyncua.common.utils import Buffer
from asyncua.crypto import uacrypto
from asyncua.crypto.security_policies import SecurityPolicyFactory
from asyncua.server.internal_server import InternalServer
from asyncua.ua.ua_binary import header_from_binary, uatcp_to_binary
from cryptography import x509
from cryptography.exceptions import InvalidSignature

from ua_fleet.endpoint.answers import EncodedResponse
from ua_fleet.endpoint.audit_events import ChannelOpened
from ua_fleet.endpoint.binary.builtin import encode_string
from ua_fleet.endpoint.binary.encoders import encode
from ua_fleet.endpoint.connection import FrameError
from ua_fleet.endpoint.convert import ticks_of
from ua_fleet.endpoint.decoding import Hello, OpenRequest, decode_hello, decode_open
from ua_fleet.endpoint.limits import CHUNK_BYTES, MIN_CHUNK_BYTES, EndpointLimits
from ua_fleet.endpoint.opening import OPENING, OpenHeader, Opening, check_open_header
from ua_fleet.endpoint.secure_connection import NONE_URI, CheckedConnection, Message, der
from ua_fleet.endpoint.stack import DECODE_ERRORS, Refusal, StatusCodes, name_of, status
from ua_fleet.endpoint.trust import (
    MAX_CHAIN_BYTES,
    TrustList,
    split_chain,
)
from ua_fleet.errors import RemoteWireError

__all__ = ["Channel"]

# asyncua declares these as an enumeration and uses them as the bytes that they are.
_HELLO: Final = b"HEL"
_HELLO_AT: Final = 8
"""Where the body of a Hello begins."""
_CHANNEL_ID: Final = slice(8, 12)
"""Where the SecureChannelId of an OpenSecureChannel is (OPC 10000-6 6.7.2)."""
_ACKNOWLEDGE: Final = struct.Struct("<4sI5I")
"""Message type and kind of chunk, size, ProtocolVersion, sizes of buffers, MaxMessageSize, MaxChunkCount."""
_OPENED: Final = struct.Struct("<IIIqI")
"""ServerProtocolVersion; ChannelId, TokenId, CreatedAt and RevisedLifetime of the token."""
_ERROR: Final[Any] = ua.MessageType.Error
_OPEN: Final[Any] = ua.MessageType.SecureOpen
_CLOSE: Final[Any] = ua.MessageType.SecureClose
_uacrypto: Final[Any] = uacrypto
"""Its types do not have its exception."""
_WRONG_SIGNATURE: Final = (InvalidSignature, _uacrypto.InvalidSignature)
"""Of a message that opens a channel, and of any other: asyncua has a class of its own for those."""
_CHUNKS_BEFORE_AUTHENTICATION: Final = 16
_ABORTS_BEFORE_AUTHENTICATION: Final = 16


def _parameters(request: OpenRequest, lifetime_ms: int) -> Any:
    """What asyncua renews a token by."""
    parameters: Any = ua.OpenSecureChannelParameters()
    parameters.RequestType = ua.SecurityTokenRequestType.Renew
    parameters.ClientNonce = request.nonce
    parameters.RequestedLifetime = lifetime_ms
    return parameters


def _opened(token: Any, nonce: Any) -> EncodedResponse:
    """The response to an OpenSecureChannel (OPC 10000-4 5.6.2)."""
    times = ticks_of(token.CreatedAt), int(token.RevisedLifetime)
    head = _OPENED.pack(0, token.ChannelId, token.TokenId, *times)
    return EncodedResponse(ua.OpenSecureChannelResponse, head + encode_string(nonce))


class Channel:
    """Hello, then one SecureChannel, then messages."""

    def __init__(
        self,
        iserver: InternalServer,
        limits: EndpointLimits,
        policies: Sequence[SecurityPolicyFactory],
        trust: TrustList,
        check_shown: Callable[[Sequence[x509.Certificate]], None] = lambda _chain: None,
    ) -> None:
        """Wait for a Hello; `check_shown` raises FrameError for a chain of certificates whose client is not served."""
        self._check_shown = check_shown
        self._iserver, self._limits, self._trust = iserver, limits, trust
        self._transport_limits = TransportLimits(
            max_recv_buffer=CHUNK_BYTES,
            max_send_buffer=CHUNK_BYTES,
            max_chunk_count=_CHUNKS_BEFORE_AUTHENTICATION,
            max_message_size=CHUNK_BYTES,
        )
        self._secure = CheckedConnection(self._transport_limits, policies, self._look)
        self._policies = policies
        self._hello = False
        self._asked: ChannelOpened | None = None
        self._most_chunks = 0
        self.response_bytes = 0
        """Bytes that the client takes in one response (Hello, OPC 10000-6 7.1.2.3); 0 for any number."""
        self._authenticated = False
        self.expires_at = float("inf")
        """When the token that was issued last has expired, used or not; then the connection ends."""
        self.output: list[bytes] = []
        """What is to be sent, in order; the owner takes it."""

    @property
    def greeted(self) -> bool:
        """Whether the client has said Hello."""
        return self._hello

    @property
    def is_open(self) -> bool:
        """Whether there is a SecureChannel."""
        return bool(self._secure.is_open())

    @property
    def secured(self) -> bool:
        """Whether the channel is signed and encrypted."""
        return self.is_open and self._secure.security_policy.URI != NONE_URI

    @property
    def encrypted(self) -> bool:
        """Whether messages are encrypted, and not only signed."""
        mode: Any = self._secure.security_policy.Mode
        return self.secured and mode == ua.MessageSecurityMode.SignAndEncrypt

    @property
    def sessions_allowed(self) -> bool:
        """Whether more than discovery may be done on this channel."""
        return self.secured or any(policy.cls.URI == NONE_URI for policy in self._policies)

    @property
    def channel_id(self) -> int:
        """SecureChannelId; 0 before there is a channel."""
        return int(self._secure.security_token.ChannelId) if self.is_open else 0

    def take_opened(self) -> ChannelOpened | None:
        """What the last OpenSecureChannel asked for, granted or not; once."""
        opened, self._asked = self._asked, None
        return opened

    @property
    def policy(self) -> Any:
        """The security policy, with its keys."""
        return self._secure.security_policy

    @property
    def client_certificate(self) -> bytes:
        """The client's certificate (DER), empty without security."""
        return bytes(self._secure.security_policy.peer_certificate or b"") if self.secured else b""

    @property
    def chain(self) -> list[x509.Certificate]:
        """The client's certificate and what it sent of its issuers."""
        return self._secure.chain

    @property
    def authenticated(self) -> bool:
        """Whether a user has proved who he is on this channel."""
        return self._authenticated

    @authenticated.setter
    def authenticated(self, value: bool) -> None:
        self._authenticated = value
        self._transport_limits.max_message_size = self._limits.message_bytes if value else CHUNK_BYTES
        chunks = self._limits.message_bytes // MIN_CHUNK_BYTES + 1
        self._transport_limits.max_chunk_count = chunks if value else _CHUNKS_BEFORE_AUTHENTICATION

    def room(self) -> int:
        """Bytes that the next frame may have, so that no message grows beyond its limit."""
        if self._authenticated:
            return CHUNK_BYTES
        return CHUNK_BYTES - int(self._secure.pending)

    def check_certificate(self) -> None:
        """Raise CertificateRefused when the client's certificate is no longer accepted."""
        if self.secured:
            self._trust.check(self._secure.chain)

    def receive(self, frame: bytes) -> Message | None:
        """A whole request, or None; raises FrameError or CertificateRefused, then the connection ends."""
        if (taken := self._take(frame)) is not None:
            return taken
        buffer = Buffer(frame)
        try:
            if frame.startswith(_HELLO):
                self._receive_hello(decode_hello(frame[_HELLO_AT:]))
                return None
            if frame.startswith(OPENING) and self._hello and not self.is_open:
                self._open(self._secure.take_opening(frame, self._check_receiver(frame)))
                return None
            header: Any = header_from_binary(buffer)
            if not self._hello or (header.MessageType != _OPEN and not self.is_open):
                raise FrameError(StatusCodes.BadTcpMessageTypeInvalid, "a message before Hello or an open channel")
            if header.MessageType == _OPEN and header.ChunkType != ua.ChunkType.Single:
                raise FrameError(StatusCodes.BadTcpMessageTypeInvalid, "an OpenSecureChannel in chunks")
            if header.MessageType == _OPEN:
                self._check_receiver(frame)
            message: Any = self._secure.receive_from_header_and_body(header, buffer)
            if self._secure.aborted > _ABORTS_BEFORE_AUTHENTICATION and not self._authenticated:
                raise FrameError(StatusCodes.BadTcpNotEnoughResources, "too many aborted messages")
            if message is None:
                return None
            if header.MessageType == _CLOSE:
                self._close()
            if header.MessageType == _OPEN:
                algorithm: Any = message.SecurityHeader()
                self._open(
                    Opening(
                        algorithm.SecurityPolicyURI or "",
                        algorithm.SenderCertificate or b"",
                        Message(int(message.SequenceHeader().RequestId), bytes(message.body())),
                    )
                )
                return None
        except _WRONG_SIGNATURE as error:
            raise FrameError(StatusCodes.BadSecurityChecksFailed, "a wrong signature") from error
        except ua.UaStatusCodeError as error:
            raise FrameError(error.code, name_of(error.code)) from error
        except Refusal as error:
            raise FrameError(error.ua_status, str(error)) from error
        except (RemoteWireError, *DECODE_ERRORS) as error:
            code = StatusCodes.BadSecurityChecksFailed if self._hello else StatusCodes.BadDecodingError
            raise FrameError(code, f"{type(error).__name__}: {error!s:.100}") from error
        return Message(int(message.SequenceHeader().RequestId), bytes(message.body()))

    def _check_receiver(self, frame: bytes) -> OpenHeader:
        """The header of an OpenSecureChannel for our certificate and this channel; another is refused, and told of."""
        header = check_open_header(frame)
        try:
            if self.is_open and int.from_bytes(frame[_CHANNEL_ID], "little") != self.channel_id:
                raise FrameError(StatusCodes.BadTcpSecureChannelUnknown, "a renewal of another channel")
            self._secure.check_receiver(header)
        except FrameError:
            certificate = (header.certificate or b"")[:MAX_CHAIN_BYTES]
            self._asked = ChannelOpened(0, certificate, self.is_open, header.policy_uri[:255], 0, 0.0)
            raise
        return header

    def _take(self, frame: bytes) -> Message | None:
        """The message of a frame under the channel's keys; None for any other frame."""
        taken = self._secure.take(frame) if self._secure.is_open() else None
        if taken is not None and frame.startswith(_CLOSE):
            self._close()
        return taken

    def _close(self) -> NoReturn:
        self._secure.close()
        raise FrameError(0, "closed by the client")

    def _receive_hello(self, hello: Hello) -> None:
        if self._hello:
            raise FrameError(StatusCodes.BadTcpMessageTypeInvalid, "a second Hello")
        if hello.receive_buffer < MIN_CHUNK_BYTES or hello.send_buffer < MIN_CHUNK_BYTES:
            raise FrameError(StatusCodes.BadConnectionRejected, "buffers below 8192 bytes")
        self._hello = True
        self._transport_limits.max_send_buffer = min(CHUNK_BYTES, hello.receive_buffer)
        self._transport_limits.max_recv_buffer = min(CHUNK_BYTES, hello.send_buffer)
        self.response_bytes = hello.max_message
        self._most_chunks = hello.max_chunks
        receive, send = self._transport_limits.max_recv_buffer, self._transport_limits.max_send_buffer
        most = self._limits.message_bytes
        answer = _ACKNOWLEDGE.pack(b"ACKF", _ACKNOWLEDGE.size, 0, receive, send, most, most // MIN_CHUNK_BYTES + 1)
        self.output.append(answer)

    def _look(self, uri: str, certificate: bytes, chain: list[x509.Certificate]) -> None:
        """Raise CertificateRefused before the server's private key is used for a stranger's message."""
        self._check_shown(chain)
        # What else it asks for is encrypted yet.
        self._asked = ChannelOpened(
            0, certificate[:MAX_CHAIN_BYTES], renewal=False, policy_uri=uri, mode=0, lifetime_ms=0.0
        )
        self._trust.check(chain)

    def _open(self, opening: Opening) -> None:
        """Issue or renew the channel's token, for a certificate that is trusted."""
        request = decode_open(opening.message.body)
        mode = ua.MessageSecurityMode(request.mode)
        self._asked = ChannelOpened(
            self.channel_id,
            opening.certificate[:MAX_CHAIN_BYTES],
            request.renewal,
            opening.policy_uri[:255],
            request.mode,
            float(request.lifetime_ms),
        )
        if request.renewal != self.is_open:
            raise FrameError(StatusCodes.BadRequestTypeInvalid, "a channel is issued once, then renewed")
        if request.renewal:
            self._check_renewal(opening, mode)
        else:
            self._secure.select_policy(opening.policy_uri, opening.certificate, mode)
        if self._secure.security_policy.URI != NONE_URI:
            if (
                len(request.nonce) != self._secure.security_policy.secure_channel_nonce_length
                or request.nonce == self._secure.remote_nonce
            ):
                raise FrameError(StatusCodes.BadNonceInvalid, "the client's nonce is used or too short")
            if request.renewal:
                self._trust.check(self._secure.chain)
        least, most = self._limits.channel_lifetime_s
        lifetime = min(max(request.lifetime_ms / 1000, least), most)
        # Messages under the old token are good for a quarter of its lifetime more (OPC 10000-4 5.5.2.1).
        self.expires_at = time.monotonic() + lifetime * 1.25
        lifetime_ms = int(lifetime * 1000)
        if request.renewal:
            result = self._secure.renew(_parameters(request, lifetime_ms), self._iserver, self.expires_at)
            opened = _opened(result.SecurityToken, result.ServerNonce)
        else:
            self._secure.issue(request.nonce, lifetime_ms, self._iserver.get_new_channel_id(), self.expires_at)
            opened = _opened(self._secure.security_token, self._secure.local_nonce)
        if self._most_chunks:
            # How much a chunk holds depends on the policy.
            in_chunks = self._secure.most_bytes(self._most_chunks)
            self.response_bytes = min(self.response_bytes or in_chunks, in_chunks)
        data = opened.encode(request.head.handle)
        self.output.append(self._secure.seal_opening(data, opening.message.request_id))

    def _check_renewal(self, opening: Opening, mode: ua.MessageSecurityMode) -> None:
        policy = self._secure.security_policy
        if opening.policy_uri != policy.URI or mode != policy.Mode:
            raise FrameError(StatusCodes.BadSecurityPolicyRejected, "a renewal with another policy")
        if self.secured:
            chain = split_chain(opening.certificate)
            if der(chain[0]) != self.client_certificate:
                raise FrameError(StatusCodes.BadSecurityChecksFailed, "a renewal with another certificate")

    def encode(self, response: Any, handle: int) -> bytes:
        """The bytes of a response; raises OverflowError when it is longer than the client takes."""
        if isinstance(response, EncodedResponse):
            data = response.encode(handle)
        else:
            response.ResponseHeader.RequestHandle = handle
            data = encode(response)
        if len(data) > self.response_bytes > 0 and not isinstance(response, ua.ServiceFault):
            raise OverflowError(f"a response of {len(data)} bytes, the client takes {self.response_bytes}")
        return data

    def respond(self, data: bytes, request_id: int) -> None:
        """Put an encoded response out."""
        self.output.append(self._secure.message(data, request_id))

    def chunks(self, data: bytes, request_id: int) -> Iterator[bytes]:
        """An encoded response as chunks. Nothing else may be sent between the first one and the last (OPC 10000-6)."""
        return self._secure.chunks(data, request_id)

    @staticmethod
    def error_message(code: int, reason: str) -> bytes:
        """An Error message, the last one on a connection (OPC 10000-6 7.1.2.5)."""
        return uatcp_to_binary(_ERROR, ua.ErrorMessage(status(code), ua.String(reason)))
