"""CreateSession, ActivateSession and GetEndpoints in one pass, where they have the plain form that nearly all have.

As in `decoders`, nothing is refused here: for whatever is not plain the answer is None, and the request goes the long
way, which says what is wrong with it. A request of one chunk with a few texts is far below all budgets.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, Final

from asyncua import ua

from ua_fleet.endpoint.binary.decoders import NotPlainError
from ua_fleet.endpoint.stack import ObjectIds

__all__ = ["SESSION_REQUESTS", "decode_session_request"]

_NUMBER: Final = struct.Struct("<i")
_MASK: Final = struct.Struct("<B")
_TOKEN: Final = struct.Struct("<BBHBi")
"""NodeId of the token's type in two bytes, encoding with a body, and its length."""
_TIMEOUT_AND_SIZE: Final = struct.Struct("<dI")
_MOST_TEXTS: Final = 16
_ANONYMOUS: Final = int(ObjectIds.AnonymousIdentityToken_Encoding_DefaultBinary)
_USER_NAME: Final = int(ObjectIds.UserNameIdentityToken_Encoding_DefaultBinary)


class _Reader:
    """Reads the fields of a request one after the other."""

    __slots__ = ("_data", "at")

    def __init__(self, data: bytes) -> None:
        self._data, self.at = data, 0

    def number(self) -> int:
        """An Int32."""
        number: int = _NUMBER.unpack_from(self._data, self.at)[0]
        self.at += 4
        return number

    def unpack(self, form: struct.Struct) -> tuple[Any, ...]:
        """Fields of a fixed size."""
        values = form.unpack_from(self._data, self.at)
        self.at += form.size
        return values

    def opaque(self) -> bytes | None:
        """A ByteString."""
        data, start = self._data, self.at + 4
        length: int = _NUMBER.unpack_from(data, self.at)[0]
        if length < 0:
            if length < -1:
                raise NotPlainError
            self.at = start
            return None
        self.at = end = start + length
        if end > len(data):
            raise NotPlainError
        return data[start:end]

    def text(self) -> str | None:
        """A String."""
        opaque = self.opaque()
        return None if opaque is None else opaque.decode()

    def texts(self) -> list[str | None] | None:
        """An array of a few Strings."""
        count = self.number()
        if not -1 <= count <= _MOST_TEXTS:
            raise NotPlainError
        return None if count < 0 else [self.text() for _ in range(count)]

    def localized_text(self) -> Any:
        """A LocalizedText."""
        (mask,) = self.unpack(_MASK)
        if mask > 3:
            raise NotPlainError
        locale = self.text() if mask & 1 else None
        return ua.LocalizedText(self.text() if mask & 2 else None, locale)

    def signature(self) -> Any:
        """A SignatureData."""
        algorithm: Any = self.text()
        return ua.SignatureData(algorithm, self.opaque())

    def identity_token(self) -> Any:
        """An anonymous token, or one with a name."""
        form, namespace, kind, encoding, length = self.unpack(_TOKEN)
        end = self.at + length
        if (form, namespace, encoding) != (1, 0, 1):
            raise NotPlainError
        policy: Any = self.text()
        token: Any
        if kind == _ANONYMOUS:
            token = ua.AnonymousIdentityToken(policy)
        elif kind == _USER_NAME:
            token = ua.UserNameIdentityToken(policy, self.text(), self.opaque(), self.text())
        else:
            raise NotPlainError
        if self.at != end:
            raise NotPlainError
        return token


def _create_session(read: _Reader) -> Any:
    made: Any = ua.CreateSessionParameters()
    client: Any = made.ClientDescription
    client.ApplicationUri, client.ProductUri = read.text(), read.text()
    client.ApplicationName = read.localized_text()
    client.ApplicationType = ua.ApplicationType(read.number())
    client.GatewayServerUri, client.DiscoveryProfileUri = read.text(), read.text()
    client.DiscoveryUrls = read.texts()
    made.ServerUri, made.EndpointUrl, made.SessionName = read.text(), read.text(), read.text()
    made.ClientNonce, made.ClientCertificate = read.opaque(), read.opaque()
    made.RequestedSessionTimeout, made.MaxResponseMessageSize = read.unpack(_TIMEOUT_AND_SIZE)
    return made


def _activate_session(read: _Reader) -> Any:
    signature: Any = read.signature()
    if not -1 <= read.number() <= 0:  # ClientSoftwareCertificates, which nobody has
        raise NotPlainError
    locales: Any = read.texts() or []
    token: Any = read.identity_token()
    return ua.ActivateSessionParameters(signature, [], locales, token, read.signature())


def _get_endpoints(read: _Reader) -> Any:
    url: Any = read.text()
    locales: Any = read.texts() or []
    profiles: Any = read.texts() or []
    return ua.GetEndpointsParameters(url, locales, profiles)


SESSION_REQUESTS: Final[dict[Any, Callable[[_Reader], Any]]] = {
    ua.CreateSessionParameters: _create_session,
    ua.ActivateSessionParameters: _activate_session,
    ua.GetEndpointsParameters: _get_endpoints,
}
"""Decoders by the class of the parameters."""


def decode_session_request(parameters: Any, data: bytes) -> Any:
    """The parameters of a request; None where it has not the plain form, or is another service's.

    A null array of the parameters is an empty one, as `decode_parameters` has it.
    """
    decode = SESSION_REQUESTS.get(parameters)
    if decode is None:
        return None
    try:
        return decode(_Reader(data))
    except (NotPlainError, struct.error, ValueError):
        return None
