"""The OPC UA Connection Protocol and the SecureChannel of one connection (OPC 10000-6 sections 6.7 and 7.1).

asyncua decodes, decrypts and verifies the chunks. This module decides what may be opened, with which certificate, for
how long, and how much a client may send.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, Final

from asyncua import ua
from asyncua.common.connection import SecureConnection, TransportLimits
from asyncua.common.utils import Buffer
from asyncua.crypto.security_policies import SecurityPolicyFactory, SecurityPolicyNone
from asyncua.server.internal_server import InternalServer
from asyncua.ua.ua_binary import header_from_binary, struct_from_binary, struct_to_binary, uatcp_to_binary
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding

from ua_fleet.server.endpoint.connection import FrameError
from ua_fleet.server.endpoint.limits import CHUNK_BYTES, MIN_CHUNK_BYTES, Limits
from ua_fleet.server.endpoint.stack import DECODE_ERRORS, StatusCodes, name_of, status
from ua_fleet.server.trust import MAX_KEY_BITS, MIN_KEY_BITS, CertificateRefused, TrustList, split_chain

__all__ = ["Channel"]

NONE_URI: Final = SecurityPolicyNone.URI
# asyncua declares these as an enumeration and uses them as the bytes that they are.
_HELLO: Final[Any] = ua.MessageType.Hello
_ACKNOWLEDGE: Final[Any] = ua.MessageType.Acknowledge
_ERROR: Final[Any] = ua.MessageType.Error
_OPEN: Final[Any] = ua.MessageType.SecureOpen
_CLOSE: Final[Any] = ua.MessageType.SecureClose
_MESSAGE: Final[Any] = ua.MessageType.SecureMessage
_NO_SECURITY: Final[Any] = SecurityPolicyNone
_CHUNKS_BEFORE_AUTHENTICATION: Final = 16


class _SecureConnection(SecureConnection):
    """asyncua's, with a certificate that is looked at before its key is used."""

    def __init__(self, limits: TransportLimits, policies: Sequence[SecurityPolicyFactory]) -> None:
        super().__init__(_NO_SECURITY(), limits)
        self.set_policy_factories(list(policies))
        self.chain: list[x509.Certificate] = []

    def select_policy(
        self, uri: str, peer_certificate: bytes | None, mode: ua.MessageSecurityMode | None = None
    ) -> None:
        matching = next((policy for policy in self._policies if policy.matches(uri, mode)), None)
        if uri == NONE_URI:
            if mode not in (None, ua.MessageSecurityMode.None_):
                raise FrameError(StatusCodes.BadSecurityModeRejected, f"mode {mode} without a policy")
            # Without an endpoint for it the channel serves discovery alone (OPC 10000-4 5.5.2).
            self.security_policy = matching.create(None) if matching else _NO_SECURITY()
            self.chain = []
            return
        if matching is None:
            raise FrameError(StatusCodes.BadSecurityPolicyRejected, f"policy {uri!r:.100}, mode {mode}")
        chain = split_chain(peer_certificate or b"")
        key = chain[0].public_key()
        if not isinstance(key, rsa.RSAPublicKey) or not MIN_KEY_BITS <= key.key_size <= MAX_KEY_BITS:
            raise CertificateRefused(StatusCodes.BadCertificatePolicyCheckFailed, "the key is too short or no RSA")
        self.chain = chain
        self.security_policy = matching.create(_der(chain[0]))

    @property
    def pending(self) -> int:
        """Bytes of a message whose last chunk has not come."""
        return self._incoming_size


def _der(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(Encoding.DER)


class Channel:
    """Hello, then one SecureChannel, then messages."""

    def __init__(
        self, iserver: InternalServer, limits: Limits, policies: Sequence[SecurityPolicyFactory], trust: TrustList
    ) -> None:
        self._iserver, self._limits, self._trust = iserver, limits, trust
        self._transport_limits = TransportLimits(
            max_recv_buffer=CHUNK_BYTES,
            max_send_buffer=CHUNK_BYTES,
            max_chunk_count=_CHUNKS_BEFORE_AUTHENTICATION,
            max_message_size=CHUNK_BYTES,
        )
        self._secure = _SecureConnection(self._transport_limits, policies)
        self._none_offered = any(policy.cls.URI == NONE_URI for policy in policies)
        self._hello = False
        self._response_bytes = 0
        self._authenticated = False
        self.expires_at = float("inf")
        self.output: list[bytes] = []
        """What is to be sent, in order; the owner takes it."""

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
        return self.secured or self._none_offered

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

    def receive(self, frame: bytes) -> Any:
        """A whole request, or None; raises FrameError or CertificateRefused, then the connection ends."""
        buffer = Buffer(frame)
        try:
            header: Any = header_from_binary(buffer)
            if header.MessageType == _HELLO:
                self._receive_hello(struct_from_binary(ua.Hello, buffer))
                return None
            if not self._hello or (header.MessageType != _OPEN and not self.is_open):
                raise FrameError(StatusCodes.BadTcpMessageTypeInvalid, "a message before Hello or an open channel")
            if header.MessageType == _OPEN and header.ChunkType != ua.ChunkType.Single:
                raise FrameError(StatusCodes.BadTcpMessageTypeInvalid, "an OpenSecureChannel in chunks")
            message: Any = self._secure.receive_from_header_and_body(header, buffer)
            if message is None:
                return None
            if header.MessageType == _CLOSE:
                self._secure.close()
                raise FrameError(0, "closed by the client")
            if header.MessageType == _OPEN:
                self._open(message)
                message = None
        except InvalidSignature as error:
            raise FrameError(StatusCodes.BadSecurityChecksFailed, "a wrong signature") from error
        except ua.UaStatusCodeError as error:
            raise FrameError(error.code, name_of(error.code)) from error
        except DECODE_ERRORS as error:
            code = StatusCodes.BadSecurityChecksFailed if self._hello else StatusCodes.BadDecodingError
            raise FrameError(code, f"{type(error).__name__}: {error!s:.100}") from error
        return message

    def _receive_hello(self, hello: ua.Hello) -> None:
        if self._hello:
            raise FrameError(StatusCodes.BadTcpMessageTypeInvalid, "a second Hello")
        if hello.ReceiveBufferSize < MIN_CHUNK_BYTES or hello.SendBufferSize < MIN_CHUNK_BYTES:
            raise FrameError(StatusCodes.BadConnectionRejected, "buffers below 8192 bytes")
        self._hello = True
        self._transport_limits.max_send_buffer = min(CHUNK_BYTES, hello.ReceiveBufferSize)
        self._transport_limits.max_recv_buffer = min(CHUNK_BYTES, hello.SendBufferSize)
        self._response_bytes = hello.MaxMessageSize
        acknowledge: Any = ua.Acknowledge()
        acknowledge.ProtocolVersion = 0
        acknowledge.ReceiveBufferSize = self._transport_limits.max_recv_buffer
        acknowledge.SendBufferSize = self._transport_limits.max_send_buffer
        acknowledge.MaxMessageSize = self._limits.message_bytes
        acknowledge.MaxChunkCount = self._limits.message_bytes // MIN_CHUNK_BYTES + 1
        self.output.append(uatcp_to_binary(_ACKNOWLEDGE, acknowledge))

    def _open(self, message: Any) -> None:
        """Issue or renew the channel's token, for a certificate that is trusted."""
        algorithm = message.SecurityHeader()
        request = struct_from_binary(ua.OpenSecureChannelRequest, message.body())
        parameters = request.Parameters
        issue = parameters.RequestType == ua.SecurityTokenRequestType.Issue
        if issue == self.is_open:
            raise FrameError(StatusCodes.BadRequestTypeInvalid, "a channel is issued once, then renewed")
        if issue:
            self._secure.select_policy(
                algorithm.SecurityPolicyURI, algorithm.SenderCertificate, parameters.SecurityMode
            )
        else:
            self._check_renewal(algorithm, parameters)
        if self._secure.security_policy.URI != NONE_URI:
            nonce = parameters.ClientNonce or b""
            if (
                len(nonce) != self._secure.security_policy.secure_channel_nonce_length
                or nonce == self._secure.remote_nonce
            ):
                raise FrameError(StatusCodes.BadNonceInvalid, "the client's nonce is used or too short")
            self._trust.check(self._secure.chain)
        least, most = self._limits.channel_lifetime_s
        lifetime = min(max(parameters.RequestedLifetime / 1000, least), most)
        parameters.RequestedLifetime = int(lifetime * 1000)
        # Messages under the old token are good for a quarter of its lifetime more (OPC 10000-4 5.5.2.1).
        self.expires_at = time.monotonic() + lifetime * 1.25
        response = ua.OpenSecureChannelResponse()
        response.Parameters = self._secure.open(parameters, self._iserver)
        response.ResponseHeader.RequestHandle = request.RequestHeader.RequestHandle
        self._send(struct_to_binary(response), message.SequenceHeader().RequestId, _OPEN)

    def _check_renewal(self, algorithm: Any, parameters: Any) -> None:
        policy = self._secure.security_policy
        if algorithm.SecurityPolicyURI != policy.URI or parameters.SecurityMode != policy.Mode:
            raise FrameError(StatusCodes.BadSecurityPolicyRejected, "a renewal with another policy")
        if self.secured:
            chain = split_chain(algorithm.SenderCertificate or b"")
            if _der(chain[0]) != self.client_certificate:
                raise FrameError(StatusCodes.BadSecurityChecksFailed, "a renewal with another certificate")

    def encode(self, response: Any, handle: int) -> bytes:
        """The bytes of a response; raises OverflowError when it is longer than the client takes."""
        response.ResponseHeader.RequestHandle = handle
        data = struct_to_binary(response)
        if len(data) > self._response_bytes >= MIN_CHUNK_BYTES:
            raise OverflowError(f"a response of {len(data)} bytes, the client takes {self._response_bytes}")
        return data

    def respond(self, data: bytes, request_id: int) -> None:
        """Put an encoded response out."""
        self._send(data, request_id, _MESSAGE)

    def _send(self, data: bytes, request_id: int, message_type: Any) -> None:
        self.output.append(self._secure.message_to_binary(data, message_type=message_type, request_id=request_id))

    @staticmethod
    def error_message(code: int, reason: str) -> bytes:
        """An Error message, the last one on a connection (OPC 10000-6 7.1.2.5)."""
        return uatcp_to_binary(_ERROR, ua.ErrorMessage(status(code), ua.String(reason)))
