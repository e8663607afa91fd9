"""asyncua's secured connection, made strict: which policy it takes, which tokens it knows, and chunks one by one."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import functools
import secrets
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final

from asyncua import ua
from asyncua.common.connection import SecureConnection, TransportLimits
from asyncua.crypto.security_policies import CryptographyNone, SecurityPolicyFactory, SecurityPolicyNone
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding

from ua_fleet.endpoint.certificates import UNREADABLE, thumbprint
from ua_fleet.endpoint.channel_keys import make_keys, policy_of
from ua_fleet.endpoint.chunks import (
    HEAD,
    LAST,
    MORE,
    NO_KEYS,
    SEQUENCE,
    ChunkKeys,
    most_body,
    open_chunk,
    opening_keys,
    seal_chunk,
    sealing_keys,
)
from ua_fleet.endpoint.connection import FrameError
from ua_fleet.endpoint.opening import (
    NONE_URI,
    Message,
    OpenHeader,
    Opening,
    open_opening,
    seal_opening,
)
from ua_fleet.endpoint.stack import StatusCodes
from ua_fleet.endpoint.trust import MAX_KEY_BITS, MIN_KEY_BITS, CertificateRefused, split_chain

__all__ = ["NONE_URI", "CheckedConnection", "Message", "der"]

_NO_SECURITY: Final[Any] = SecurityPolicyNone
_NOTHING_YET: Final[Any] = _NO_SECURITY()
"""The policy of a channel that has none, or none of this server; it has nothing that a channel would change."""
_TAKEN: Final = (LAST, b"CLOF")
"""Messages, and CloseSecureChannel, of one chunk."""
_FIRST_TOKEN_ID: Final = 13
"""As asyncua has it; any number but 0 would do."""
_MOST_RENEWED: Final = 4
"""Tokens that may wait for their first message; a client has two at most that it could use."""


def der(certificate: x509.Certificate) -> bytes:
    """A certificate as bytes."""
    return certificate.public_bytes(Encoding.DER)


@functools.lru_cache(8)
def _thumbprint_of(certificate: x509.Certificate) -> bytes:
    """By what clients name one of our certificates."""
    return bytes.fromhex(thumbprint(certificate))


@dataclass(frozen=True, slots=True)
class _Renewed:
    """A token of a renewal, and what its keys are made of."""

    token: Any
    expires_at: float
    """When messages under it are not taken any more, as `time.monotonic` counts."""
    local_nonce: Any
    remote_nonce: Any


class CheckedConnection(SecureConnection):
    """asyncua's, with a certificate that is looked at before its key is used, and tokens that are told apart."""

    def __init__(
        self,
        limits: TransportLimits,
        policies: Sequence[SecurityPolicyFactory],
        look: Callable[[str, bytes, list[x509.Certificate]], None],
    ) -> None:
        """Open channels with these policies; `look` raises for a chain of certificates that is not accepted."""
        super().__init__(_NOTHING_YET, limits)
        self.set_policy_factories(list(policies))
        self.chain: list[x509.Certificate] = []
        self._look = look
        self.aborted = 0
        """Messages that the client has given up in the middle."""
        self._last_token_id = 0
        self._expires_at = 0.0
        """Of the token in use, however many wait: their client need not use them."""
        self._renewed: OrderedDict[int, _Renewed] = OrderedDict()
        """Tokens that were issued and not used yet, by their ids."""
        self._looked: tuple[SecurityPolicyFactory, bytes | None] | None = None
        """What the policy was made of at the first look at an OpenSecureChannel."""
        self._opening: tuple[Any, ChunkKeys] = (None, NO_KEYS)
        self._sealing: tuple[Any, ChunkKeys] = (None, NO_KEYS)
        """What asyncua verifies or signs by, and the keys that were made of it."""

    def issue(self, nonce: bytes, lifetime_ms: int, channel_id: int, expires_at: float) -> None:
        """Issue the channel's first token.

        Args:
            nonce: the client's.
            lifetime_ms: of the token, as it was revised.
            channel_id: of the channel, as nobody else has it.
            expires_at: when messages under it are not taken any more, as `time.monotonic` counts.
        """
        policy: Any = self.security_policy
        own = secrets.token_bytes(policy.secure_channel_nonce_length)
        self.local_nonce, self.remote_nonce = own, nonce
        token: Any = self.security_token
        token.TokenId, token.ChannelId, token.RevisedLifetime = _FIRST_TOKEN_ID, channel_id, lifetime_ms
        token.CreatedAt = datetime.now(UTC)
        self._last_token_id, self._expires_at = _FIRST_TOKEN_ID, expires_at
        if policy.URI != NONE_URI:
            make_keys(policy, own, nonce, lifetime_ms)
        self._open = True

    def renew(self, params: Any, server: Any, expires_at: float) -> Any:
        """Renew the channel's token: each token has an id, nonces and a time of its own; see `issue`."""
        result = self.open(params, server)
        # asyncua counts from the token in use, so that two renewals in a row would share one id.
        self._last_token_id = self._last_token_id % 0xFFFF_FFFF + 1
        token: Any = self.next_security_token
        token.TokenId = self._last_token_id
        self._renewed[self._last_token_id] = _Renewed(token, expires_at, self.local_nonce, self.remote_nonce)
        if len(self._renewed) > _MOST_RENEWED:
            self._renewed.popitem(last=False)
        return result

    def _check_sym_header(self, security_hdr: Any) -> None:
        used = self._renewed.get(int(security_hdr.TokenId))
        if used is not None:
            # The first message under a token: those before it are over.
            while self._renewed.popitem(last=False)[1] is not used:
                pass
            self.next_security_token, self._expires_at = used.token, used.expires_at
            self.local_nonce, self.remote_nonce = used.local_nonce, used.remote_nonce
        super()._check_sym_header(security_hdr)
        if time.monotonic() > self._expires_at:
            raise FrameError(StatusCodes.BadSecureChannelTokenUnknown, "under a token that has expired")

    def revolve_tokens(self) -> None:
        """Begin with a new token.

        Messages under the one before are not taken any more, and so its keys open nothing: asyncua would try them where
        those of the new token do not fit.
        """
        super().revolve_tokens()
        crypto: Any = self.security_policy.symmetric_cryptography
        if type(crypto) is not CryptographyNone:
            crypto.Prev_Verifier = crypto.Prev_Decryptor = None

    def take(self, frame: bytes) -> Message | None:
        """The message of a frame that is the next one, whole, and under the token in use; None for any other frame.

        What it is instead, and what is wrong with it, is seen to by `receive_from_header_and_body`: here nothing has
        changed then.
        """
        if len(frame) < HEAD.size + SEQUENCE.size:
            return None
        kind, _, channel_id, token_id = HEAD.unpack_from(frame)
        token: Any = self.security_token
        if (
            kind not in _TAKEN
            or token_id != token.TokenId
            or channel_id != token.ChannelId
            or self._incoming_parts
            or len(frame) > self._limits.max_recv_buffer
            or time.monotonic() > self._expires_at
        ):
            return None
        crypto: Any = self.security_policy.symmetric_cryptography
        plain = open_chunk(frame, self._opening_keys(crypto))
        if plain is None:
            return None
        sequence, request_id = SEQUENCE.unpack_from(plain)
        body = plain[SEQUENCE.size :]
        before = self._peer_sequence_number
        if before is None or sequence != before + 1 or len(body) > self._limits.max_message_size > 0:
            return None
        self._peer_sequence_number = sequence
        return Message(request_id, body)

    def take_opening(self, frame: bytes, header: OpenHeader) -> Opening:
        """The first OpenSecureChannel message, with its header; raises what `open_opening` raises, and more.

        Raises:
            FrameError: no policy of this server, or a message that is too long.
            CertificateRefused: the client's certificate is not accepted; our private key has not been used then.
        """
        self.select_policy(header.policy_uri, header.certificate)
        sequence, message = open_opening(frame, header.start, self.security_policy)
        if len(frame) > self._limits.max_recv_buffer or not self._limits.is_msg_size_within_limit(len(message.body)):
            raise FrameError(StatusCodes.BadRequestTooLarge, f"{len(frame)} bytes to open a channel")
        self._peer_sequence_number = sequence
        return Opening(header.policy_uri, header.certificate or b"", message)

    def check_receiver(self, header: OpenHeader) -> None:
        """Raise FrameError unless an OpenSecureChannel names our certificate (OPC 10000-6 6.7.6).

        A policy that we do not have is refused afterwards, by `select_policy`.
        """
        offered = next((policy for policy in self._policies if policy.matches(header.policy_uri)), None)
        if header.policy_uri == NONE_URI or offered is None:
            return
        if header.thumbprint != _thumbprint_of(offered.certificate):
            raise FrameError(StatusCodes.BadCertificateInvalid, "encrypted for another certificate than the server's")

    def seal_opening(self, data: bytes, request_id: int) -> bytes:
        """The message of an encoded response to an OpenSecureChannel."""
        token: Any = self.security_token
        return seal_opening(data, token.ChannelId, self._next_sequence(request_id), self.security_policy)

    def _next_sequence(self, request_id: int) -> bytes:
        """The SequenceHeader of our next chunk."""
        self._sequence_number = self._sequence_number % 0xFFFF_FFFF + 1
        return SEQUENCE.pack(self._sequence_number, request_id)

    def _opening_keys(self, crypto: Any) -> ChunkKeys:
        if type(crypto) is CryptographyNone:
            return NO_KEYS
        of, keys = self._opening
        if of is not crypto.Verifier:
            keys = opening_keys(crypto.Verifier.key, crypto.Decryptor.cipher if crypto.is_encrypted else None)
            self._opening = crypto.Verifier, keys
        return keys

    def _sealing_keys(self) -> ChunkKeys:
        crypto: Any = self.security_policy.symmetric_cryptography
        if type(crypto) is CryptographyNone:
            return NO_KEYS
        of, keys = self._sealing
        if of is not crypto.Signer:
            keys = sealing_keys(crypto.Signer.key, crypto.Encryptor.cipher if crypto.is_encrypted else None)
            self._sealing = crypto.Signer, keys
        return keys

    def most_bytes(self, chunks: int) -> int:
        """Bytes of a response that fits into so many chunks."""
        return chunks * most_body(self._sealing_keys(), self._limits.max_send_buffer)

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
            if mode is None or self._looked is None or self._looked[0] is not matching:
                self.security_policy = policy_of(matching, None) if matching else _NOTHING_YET
                self._looked = None if matching is None else (matching, None)
            self.chain = []
            return
        if matching is None:
            raise FrameError(StatusCodes.BadSecurityPolicyRejected, f"policy {uri!r:.100}, mode {mode}")
        looked = self._looked
        if mode is not None and looked is not None and looked[0] is matching and looked[1] == peer_certificate:
            return  # the policy is that of the first look, which the message was decrypted by
        chain = split_chain(peer_certificate or b"")
        try:
            key = chain[0].public_key()
        except UNREADABLE as error:
            reason = f"the certificate's key cannot be read ({error!s:.100})"
            raise CertificateRefused(StatusCodes.BadCertificateInvalid, reason) from error
        if not isinstance(key, rsa.RSAPublicKey) or not MIN_KEY_BITS <= key.key_size <= MAX_KEY_BITS:
            raise CertificateRefused(StatusCodes.BadCertificatePolicyCheckFailed, "the key is too short or no RSA")
        if mode is None:
            # The first look at the message, before the server's private key is used for it.
            self.chain = chain
            self._look(uri, peer_certificate or b"", chain)
        self.chain = chain
        self.security_policy = policy_of(matching, chain[0])
        self._looked = matching, peer_certificate

    def chunks(self, data: bytes, request_id: int) -> Iterator[bytes]:
        """The chunks of a response, each made when it is asked for: encrypting a large one takes its time."""
        most = most_body(self._sealing_keys(), self._limits.max_send_buffer)
        for at in range(0, len(data), most):
            yield self._sealed(LAST if at + most >= len(data) else MORE, data[at : at + most], request_id)

    def message(self, data: bytes, request_id: int) -> bytes:
        """All chunks of a response."""
        if len(data) <= most_body(self._sealing_keys(), self._limits.max_send_buffer):
            return self._sealed(LAST, data, request_id)
        return b"".join(self.chunks(data, request_id))

    def _sealed(self, kind: bytes, part: bytes, request_id: int) -> bytes:
        token: Any = self.security_token
        sequence = self._next_sequence(request_id)
        return seal_chunk(kind, token.ChannelId, token.TokenId, sequence, part, self._sealing_keys())

    @property
    def pending(self) -> int:
        """Bytes of a message whose last chunk has not come."""
        return self._incoming_size
