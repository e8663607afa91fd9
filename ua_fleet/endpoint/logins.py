"""Who a client's user is: the identity tokens of ActivateSession (OPC 10000-4 5.6.3 and 7.40)."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
import hmac
import time
from collections.abc import Callable
from typing import Any, Final

from asyncua import ua
from asyncua.crypto import uacrypto

from ua_fleet.endpoint.certificates import thumbprint
from ua_fleet.endpoint.channel import Channel
from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.gateway_logins import Attempt, LoginOutcome
from ua_fleet.endpoint.key_text import KeyText, parse_key
from ua_fleet.endpoint.session_keys import KeyFileError
from ua_fleet.endpoint.signatures import check_signature
from ua_fleet.endpoint.stack import Refusal, StatusCodes
from ua_fleet.endpoint.users import ANONYMOUS, User, UserFileError
from ua_fleet.printing import config_option

__all__ = ["identify"]

_DECRYPT: Final[dict[str, Callable[[Any, bytes], bytes]]] = {
    "http://www.w3.org/2001/04/xmlenc#rsa-oaep": uacrypto.decrypt_rsa_oaep,
    "http://opcfoundation.org/UA/security/rsa-oaep-sha2-256": uacrypto.decrypt_rsa_oaep_sha256,
}
"""RSA with PKCS #1 v1.5 is not among them: what it answers can be used to decrypt (Bleichenbacher)."""
_MAX_SECRET: Final = 4_096
_MAX_NAME: Final = 64
"""Longest user name; of what is longer no more is kept or logged."""


CERTIFICATE_POLICY: Final = "certificate"
"""PolicyId of the UserTokenPolicy that our endpoints offer for certificates."""


async def identify(
    context: EndpointContext,
    channel: Channel,
    params: ua.ActivateSessionParameters,
    *,
    nonce: bytes,
    address: str,
    gateway: str = "",
) -> User:
    """The user behind the identity token of an ActivateSession; raises Refusal.

    Args:
        context: what all connections share.
        channel: the one that the request came on.
        params: of the request.
        nonce: the session's ServerNonce, which is used up by this.
        address: of the client, as it counts (`origin`).
        gateway: the name of the one through which the request comes; empty for an ordinary client.
    """
    token: Any = params.UserIdentityToken
    if token is None or (isinstance(token, ua.ExtensionObject) and token.TypeId.is_null()):
        # A null token is anonymous (OPC 10000-4 5.6.3.2).
        token = ua.AnonymousIdentityToken()
    if isinstance(token, ua.AnonymousIdentityToken):
        if not context.allow_anonymous:
            raise Refusal(StatusCodes.BadIdentityTokenRejected, "anonymous users are not let in")
        return ANONYMOUS
    if isinstance(token, ua.X509IdentityToken):
        return _bridge(context, channel, token, params.UserTokenSignature, nonce=nonce, address=address)
    if not isinstance(token, ua.UserNameIdentityToken):
        raise Refusal(StatusCodes.BadIdentityTokenRejected, "only users with a password and bridges are let in")
    if gateway:
        return await _person_behind(context, gateway, token, nonce=nonce)
    return await _person(context, token, nonce=nonce, encrypted=channel.secured, address=address)


def _bridge(
    context: EndpointContext,
    channel: Channel,
    token: ua.X509IdentityToken,
    signature: Any,
    *,
    nonce: bytes,
    address: str,
) -> User:
    """The bridge that shows its certificate, and proves that it has the key to it (OPC 10000-4 7.40.5).

    It must be the certificate of the channel too: so it has been found sound, trusted and not revoked, what a bridge
    proves cannot be carried to another's connection, and its algorithm is that of the channel's policy.
    """
    if context.bridges is None:
        raise Refusal(StatusCodes.BadIdentityTokenRejected, "login by certificate is not configured here")
    if token.PolicyId != CERTIFICATE_POLICY:
        raise Refusal(StatusCodes.BadIdentityTokenInvalid, "the token names no policy that was offered")
    if not channel.secured:
        raise Refusal(StatusCodes.BadIdentityTokenRejected, "a certificate over a channel without security")
    certificate = channel.chain[0]
    source = f"certificate {thumbprint(certificate)[:12]}"
    if wait := context.throttle.locked_for(address, source, time.monotonic()):
        raise Refusal(StatusCodes.BadUserAccessDenied, f"login by {source}: locked out for {wait:.0f} s more")
    own = channel.client_certificate
    if (token.CertificateData or b"")[: len(own)] != own:
        raise Refusal(StatusCodes.BadIdentityTokenRejected, "another certificate than the channel's")
    try:
        check_signature(channel.policy, signature, nonce, StatusCodes.BadUserSignatureInvalid)
    except Refusal:
        context.throttle.failure(address, source, time.monotonic())
        raise
    context.throttle.success(address, source)
    name = context.bridges.name_of(certificate)
    if not name:
        mark = thumbprint(certificate)[:12]
        # So that it is there to be bound, also where a CA or `trust_all_clients` has let it in.
        context.trust.reject(certificate, address)
        raise Refusal(
            StatusCodes.BadIdentityTokenRejected,
            f"no bridge is known by certificate {mark}; bind it with: "
            f"ua-fleet cert trust --bridge NAME {mark}{config_option()}",
        )
    return User.of_bridge(name)


async def _person(
    context: EndpointContext, token: ua.UserNameIdentityToken, *, nonce: bytes, encrypted: bool, address: str
) -> User:
    """The user whose password, or session key, this is."""
    source = _name_of(token)[:_MAX_NAME]
    shown = repr(source)
    now = time.monotonic()
    if wait := context.throttle.locked_for(address, source, now):
        raise Refusal(StatusCodes.BadUserAccessDenied, f"login of {shown}: locked out for {wait:.0f} s more")
    try:
        password = _password(context, token, nonce=nonce, encrypted=encrypted)
    except Refusal:
        # To look at it has taken the server's private key: it counts like a wrong one.
        context.throttle.failure(address, source, time.monotonic())
        raise
    key = parse_key(password)
    try:
        if key is not None:
            user = context.session_keys.verify(_name_of(token), key, time.time())
        else:
            user = await context.users.authenticate(_name_of(token), password, origin=address)
    except (UserFileError, KeyFileError) as error:
        raise Refusal(StatusCodes.BadServerTooBusy, str(error)) from error
    if user is None:
        context.throttle.failure(address, source, time.monotonic())
        what = f"session key {key.id} is not valid" if key is not None else "wrong user or password"
        raise Refusal(StatusCodes.BadUserAccessDenied, f"login of {shown}: {what}")
    context.throttle.success(address, source)
    return user


async def _person_behind(
    context: EndpointContext, gateway: str, token: ua.UserNameIdentityToken, *, nonce: bytes
) -> User:
    """As `_person`, of those who come through a gateway: who guesses slows down the name alone (ADR 55)."""
    name, logins, users = _name_of(token), context.gateway_logins, context.users
    attempt = Attempt(gateway, name[:_MAX_NAME], is_known=users.get(name) is not None)
    login = f"login of {attempt.name!r} through gateway {gateway}"
    try:
        password = _password(context, token, nonce=nonce, encrypted=True)
    except Refusal:
        logins.count(gateway, LoginOutcome.WRONG_PASSWORD)
        logins.failure(attempt, time.monotonic())
        raise
    if (key := parse_key(password)) is not None:
        return _by_key(context, gateway, name, key, login)
    now = time.monotonic()
    if wait := logins.locked_for(attempt, now):
        raise Refusal(StatusCodes.BadUserAccessDenied, f"{login}: locked out for {wait:.0f} s more")
    is_flooded = logins.is_flooded(gateway, now)
    user = None
    try:
        if logins.may_check(attempt, now):
            user = await users.authenticate(name, password, lane=attempt.lane)
        else:
            # Who made the name up learns nothing by the time that the answer takes.
            await asyncio.sleep(users.last_check_s)
    except UserFileError as error:
        logins.count(gateway, LoginOutcome.TOO_BUSY)
        raise Refusal(StatusCodes.BadServerTooBusy, f"{login}: {error}") from error
    if user is not None:
        logins.success(attempt)
        return user
    logins.failure(attempt, time.monotonic())
    if is_flooded:
        # The same for a user's name as for one that was made up, or the answer would tell them apart.
        logins.count(gateway, LoginOutcome.TOO_BUSY)
        raise Refusal(StatusCodes.BadServerTooBusy, f"{login}: wrong, while too many names are tried that no user has")
    logins.count(gateway, LoginOutcome.WRONG_PASSWORD)
    raise Refusal(StatusCodes.BadUserAccessDenied, f"{login}: wrong user or password")


def _by_key(context: EndpointContext, gateway: str, name: str, key: KeyText, login: str) -> User:
    """The user whose session key this is, whoever guesses at the password; a wrong one locks nothing."""
    try:
        user = context.session_keys.verify(name, key, time.time())
    except (UserFileError, KeyFileError) as error:
        context.gateway_logins.count(gateway, LoginOutcome.TOO_BUSY)
        raise Refusal(StatusCodes.BadServerTooBusy, f"{login}: {error}") from error
    context.gateway_logins.count(gateway, LoginOutcome.ACCEPTED if user is not None else LoginOutcome.WRONG_KEY)
    if user is None:
        raise Refusal(StatusCodes.BadUserAccessDenied, f"{login}: session key {key.id} is not valid")
    return user


def _name_of(token: ua.UserNameIdentityToken) -> str:
    name = token.UserName or ""
    if not name:
        raise Refusal(StatusCodes.BadIdentityTokenInvalid, "a user without a name")
    return name


def _password(context: EndpointContext, token: ua.UserNameIdentityToken, *, nonce: bytes, encrypted: bool) -> str:
    secret = token.Password or b""
    if isinstance(secret, str):
        secret = secret.encode()
    if token.EncryptionAlgorithm:
        secret = _decrypt(context.private_key, token.EncryptionAlgorithm, secret, nonce)
    elif not encrypted and not context.allow_none_security:
        raise Refusal(StatusCodes.BadIdentityTokenRejected, "a password in plain text over an open channel")
    try:
        return secret.decode()
    except UnicodeDecodeError as error:
        raise Refusal(StatusCodes.BadIdentityTokenInvalid, "the password is no UTF-8") from error


def _decrypt(private_key: Any, algorithm: str, secret: bytes, nonce: bytes) -> bytes:
    """Length, password and the session's nonce, which stops a replay (OPC 10000-4 7.40.2.2)."""
    decrypt = _DECRYPT.get(algorithm)
    if decrypt is None:
        raise Refusal(StatusCodes.BadIdentityTokenInvalid, f"password encryption {algorithm[:80]!r}")
    block = private_key.key_size // 8
    if not secret or len(secret) % block or len(secret) > _MAX_SECRET:
        raise Refusal(StatusCodes.BadIdentityTokenInvalid, "the encrypted password has a wrong length")
    try:
        plain = b"".join(decrypt(private_key, secret[at : at + block]) for at in range(0, len(secret), block))
    except ValueError as error:
        raise Refusal(StatusCodes.BadIdentityTokenInvalid, "the password cannot be decrypted") from error
    length = int.from_bytes(plain[:4], "little")
    body = plain[4 : 4 + length]
    if len(plain) < 4 + length or length < len(nonce) or not hmac.compare_digest(body[length - len(nonce) :], nonce):
        raise Refusal(StatusCodes.BadIdentityTokenInvalid, "the password is not for this session")
    return body[: length - len(nonce)]
