"""asyncua's secured connection, made strict: which policy it takes, which tokens it knows, and chunks one by one."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

from asyncua import ua
from asyncua.common.connection import MessageChunk, SecureConnection, TransportLimits
from asyncua.crypto.security_policies import SecurityPolicyFactory, SecurityPolicyNone
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding

from ua_fleet.endpoint.connection import FrameError
from ua_fleet.endpoint.stack import StatusCodes
from ua_fleet.endpoint.trust import MAX_KEY_BITS, MIN_KEY_BITS, CertificateRefused, split_chain

__all__ = ["NONE_URI", "CheckedConnection", "der"]

NONE_URI: Final = SecurityPolicyNone.URI
_NO_SECURITY: Final[Any] = SecurityPolicyNone
# asyncua declares it as an enumeration and uses it as the bytes that it is.
_MESSAGE: Final[Any] = ua.MessageType.SecureMessage
_MOST_RENEWED: Final = 4
"""Tokens that may wait for their first message; a client has two at most that it could use."""


def der(certificate: x509.Certificate) -> bytes:
    """A certificate as bytes."""
    return certificate.public_bytes(Encoding.DER)


@dataclass(frozen=True, slots=True)
class _Renewed:
    """A token of a renewal, and what its keys are made of."""

    token: Any
    local_nonce: Any
    remote_nonce: Any


class CheckedConnection(SecureConnection):
    """asyncua's, with a certificate that is looked at before its key is used, and tokens that are told apart."""

    def __init__(
        self,
        limits: TransportLimits,
        policies: Sequence[SecurityPolicyFactory],
        look: Callable[[str, list[x509.Certificate]], None],
    ) -> None:
        """Open channels with these policies; `look` raises for a chain of certificates that is not accepted."""
        super().__init__(_NO_SECURITY(), limits)
        self.set_policy_factories(list(policies))
        self.chain: list[x509.Certificate] = []
        self._look = look
        self.aborted = 0
        """Messages that the client has given up in the middle."""
        self._last_token_id = 0
        self._renewed: OrderedDict[int, _Renewed] = OrderedDict()
        """Tokens that were issued and not used yet, by their ids."""

    def open(self, params: Any, server: Any) -> Any:
        """Issue the channel's token, or renew it: each token has an id and nonces of its own."""
        first = not self._open
        result = super().open(params, server)
        if first:
            self._last_token_id = int(result.SecurityToken.TokenId)
            return result
        # asyncua counts from the token in use, so that two renewals in a row would share one id.
        self._last_token_id = self._last_token_id % 0xFFFF_FFFF + 1
        token: Any = self.next_security_token
        token.TokenId = self._last_token_id
        self._renewed[self._last_token_id] = _Renewed(token, self.local_nonce, self.remote_nonce)
        if len(self._renewed) > _MOST_RENEWED:
            self._renewed.popitem(last=False)
        return result

    def _check_sym_header(self, security_hdr: Any) -> None:
        used = self._renewed.get(int(security_hdr.TokenId))
        if used is not None:
            # The first message under a token: those before it are over.
            while self._renewed.popitem(last=False)[1] is not used:
                pass
            self.next_security_token = used.token
            self.local_nonce, self.remote_nonce = used.local_nonce, used.remote_nonce
        super()._check_sym_header(security_hdr)

    def most_bytes(self, chunks: int) -> int:
        """Bytes of a response that fits into so many chunks."""
        crypto = self.security_policy.symmetric_cryptography
        return chunks * MessageChunk.max_body_size(crypto, self._limits.max_send_buffer)

    def _receive(self, msg: Any) -> Any:
        if msg.MessageHeader.ChunkType != ua.ChunkType.Abort:
            return super()._receive(msg)
        # asyncua would write the client's reason into our log, 64 KiB of whatever it is.
        self._check_incoming_chunk(msg)
        self._drop_incoming_parts()
        self.aborted += 1
        return None

    def select_policy(
        self, uri: str, peer_certificate: bytes | None, mode: ua.MessageSecurityMode | None = None
    ) -> None:
        """Take the policy of an OpenSecureChannel; without `mode` it is the first look at the message."""
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
        if mode is None:
            # The first look at the message, before the server's private key is used for it.
            self.chain = chain
            self._look(uri, chain)
        self.chain = chain
        self.security_policy = matching.create(der(chain[0]))

    def chunks(self, data: bytes, request_id: int) -> Iterator[bytes]:
        """The chunks of a response, each made when it is asked for: encrypting takes most of the time."""
        made: list[Any] = MessageChunk.message_to_chunks(
            self.security_policy,
            data,
            self._limits.max_send_buffer,
            message_type=_MESSAGE,
            channel_id=self.security_token.ChannelId,
            request_id=request_id,
            token_id=self.security_token.TokenId,
        )
        for chunk in made:
            self._sequence_number = self._sequence_number % 0xFFFF_FFFF + 1
            chunk.SequenceHeader.SequenceNumber = self._sequence_number
            encoded: bytes = chunk.to_binary()
            yield encoded

    @property
    def pending(self) -> int:
        """Bytes of a message whose last chunk has not come."""
        return self._incoming_size
