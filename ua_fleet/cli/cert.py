"""`ua-fleet cert`: the certificates of the server, the bridges and the relays, and which clients the server trusts."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ua_fleet.cli.endings import EXIT_FAILED, NotFound, UsageError, extra_needed
from ua_fleet.cli.options import DEFAULT_CONFIG, DEFAULT_ENDPOINT, Config, Json, load_config, state_folder
from ua_fleet.cli.output import message, print_json, print_line, print_table
from ua_fleet.cli.process import run
from ua_fleet.printing import config_option, utc_text

if TYPE_CHECKING:
    from ua_fleet.config import FleetConfig
    from ua_fleet.endpoint.certificates import CertificateFiles, CertificateInfo
    from ua_fleet.endpoint.rejected import Rejection

__all__ = [
    "CREATE_EXAMPLES",
    "FORGET_EXAMPLES",
    "LIST_EXAMPLES",
    "REVOKE_EXAMPLES",
    "TRUST_EXAMPLES",
    "create",
    "forget",
    "revoke_certificate",
    "show",
    "trust_certificate",
]

CREATE_EXAMPLES = (
    "ua-fleet cert create",
    "ua-fleet cert create --client plc7",
    "ua-fleet cert create --bridge cell --trust",
    "ua-fleet cert create --bridge cell --trust --renew",
)
LIST_EXAMPLES = ("ua-fleet cert list", "ua-fleet cert list --json -c hall2.yaml")
TRUST_EXAMPLES = (
    "ua-fleet cert trust --last --show",
    "ua-fleet cert trust 3f2a9c",
    "ua-fleet cert trust uaexpert.der",
    "ua-fleet cert trust --bridge cell bridge.der",
    "ua-fleet cert trust --gateway console --last --show",
)
FORGET_EXAMPLES = ("ua-fleet cert forget", "ua-fleet cert forget opc.tcp://10.0.0.5:4840/ua_fleet")
REVOKE_EXAMPLES = (
    "ua-fleet cert revoke 3f2a9c",
    "ua-fleet cert revoke --bridge cell",
    "ua-fleet cert revoke --gateway console",
)

_BridgeName = Annotated[
    str | None, typer.Option("--bridge", help="Name of a bridge or relay of the configuration file.")
]
_GatewayName = Annotated[
    str | None,
    typer.Option("--gateway", help="Name for a client through which several users log in, such as a console."),
]


def _rejection(info: CertificateInfo) -> Rejection | None:
    """Who offered it, and when, where it was refused."""
    from ua_fleet.endpoint.certificates import CertificateState
    from ua_fleet.endpoint.rejected import rejection_of

    return rejection_of(info.path) if info.state is CertificateState.REJECTED else None


def _as_json(info: CertificateInfo) -> dict[str, Any]:
    now = datetime.now(UTC)
    refused = _rejection(info)
    return {
        "state": info.state.value,
        "bridge": info.bridge or None,
        "gateway": info.gateway or None,
        "thumbprint": info.thumbprint,
        "subject": info.subject,
        "application_uri": info.application_uri,
        "not_valid_before": info.validity.begin.isoformat(),
        "not_valid_after": info.validity.end.isoformat(),
        "days_left": info.validity.days_left(now),
        "expired": now > info.validity.end,
        "address": (refused.address or None) if refused else None,
        "refused_first": datetime.fromtimestamp(refused.first_s, UTC).isoformat() if refused else None,
        "refused_last": datetime.fromtimestamp(refused.last_s, UTC).isoformat() if refused else None,
        "path": str(info.path),
    }


def create(
    client: Annotated[
        str | None, typer.Option(help="Make a certificate and key for a client of this name; copy both to the client.")
    ] = None,
    bridge: _BridgeName = None,
    and_trust: Annotated[
        bool,
        typer.Option("--trust", help="With --bridge, on the server: server and bridge trust each other from now on."),
    ] = False,
    renew: Annotated[bool, typer.Option("--renew", help="Make a new certificate with the existing key.")] = False,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Make the certificate and key of the server, a client or a bridge, unless they exist.

    The server and each bridge make their own at the first start; this command makes them earlier, for instance to hand
    the certificate on. With --trust the server trusts the bridge from now on, and the bridge trusts this server and no
    other. --renew replaces a certificate that has expired or soon will: a running bridge goes on with the new one, the
    server needs a restart, and the other side must trust the new certificate.
    """
    from ua_fleet.endpoint.certificates import (
        ensure_application_certificate,
        ensure_client_certificate,
        list_certificates,
    )

    if sum((client is not None, bridge is not None)) > 1 or (and_trust and bridge is None):
        raise UsageError("give --client, or --bridge with or without --trust, or none of them")
    fleet, folder = state_folder(config)
    if bridge is not None:
        _create_for_bridge(fleet, config, bridge, and_trust=and_trust, renew=renew, as_json=as_json)
        return
    if client is None:
        with extra_needed("the server", "server"):
            from ua_fleet.server.app import application_uri
        if renew:
            made = _renew_server(fleet, config)
        else:
            made = ensure_application_certificate(folder, application_uri(fleet), [fleet.server.host])
    else:
        made = ensure_client_certificate(
            folder, f"urn:ua-fleet:{fleet.fleet.name}:client:{client}", client, renew=renew
        )
        message(f"its key: {made.private_key}; trust it with: ua-fleet cert trust {made.certificate}{config_option()}")
    info = next(info for info in list_certificates(folder) if info.path == made.certificate)
    if as_json:
        print_json({**_as_json(info), "private_key": str(made.private_key)})
    else:
        print_line(f"{made.certificate}  {info.thumbprint}")


def _renew_server(fleet: FleetConfig, config: Path) -> CertificateFiles:
    from ua_fleet.server.mutual_trust import renew_server

    made, pinned = renew_server(fleet, config.resolve().parent)
    others = [name for name in (*fleet.bridges, *fleet.relays) if name not in pinned]
    message("restart the server; clients that trusted the old certificate must trust the new one")
    if pinned:
        message(f"these bridges trust the new one: {', '.join(pinned)}")
    if others:
        message(
            f"for bridges with their own server.der ({', '.join(others)}), put {made.certificate} there as that file"
        )
    return made


def _check_bridge(fleet: FleetConfig, config: Path, name: str) -> None:
    if name not in fleet.bridges and name not in fleet.relays:
        relays = f"; relays: {', '.join(fleet.relays)}" if fleet.relays else ""
        there = ", ".join(fleet.bridges) or "none"
        raise NotFound(f"{config}: there is no bridge {name!r}; bridges there: {there}{relays}")


def _create_for_bridge(
    fleet: FleetConfig, config: Path, name: str, *, and_trust: bool, renew: bool, as_json: bool
) -> None:
    _check_bridge(fleet, config, name)
    with extra_needed("a bridge's certificate", "client"):
        from ua_fleet.client import ClientIdentity
        from ua_fleet.client.shared_certificate import why_not_its_own
    from ua_fleet.endpoint.certificates import load_certificate, thumbprint

    root = config.resolve().parent
    if problem := why_not_its_own(fleet, root, name):
        raise UsageError(problem)
    identity = ClientIdentity.of_bridge(root / fleet.state_dir_of(name), fleet.fleet.name, name)
    if and_trust:
        with extra_needed("the server", "server"):
            from ua_fleet.server.mutual_trust import introduce_bridge
        run(introduce_bridge(fleet, root, name, renew=renew))
    else:
        run(identity.renew() if renew else identity.ensure())
        message(f"on the server run: ua-fleet cert trust --bridge {name} {identity.certificate}{config_option()}")
    mark = thumbprint(load_certificate(identity.certificate))
    if as_json:
        print_json(
            {
                "bridge": name,
                "thumbprint": mark,
                "application_uri": identity.application_uri,
                "path": str(identity.certificate),
                "private_key": str(identity.key),
                "trusted": and_trust,
            }
        )
    else:
        print_line(f"{identity.certificate}  {mark}")


def show(config: Config = DEFAULT_CONFIG, as_json: Json = False) -> None:
    """List certificates: the server's own, those of trusted clients, bridges and gateways, and refused ones."""
    from ua_fleet.endpoint.certificates import list_certificates

    _, folder = state_folder(config)
    found = list_certificates(folder, strict=True)
    if as_json:
        for info in found:
            print_json(_as_json(info))
        return
    if not found:
        message("no certificate exists yet; the server makes its own at its first start")
        return
    rows = [
        (
            _state_text(info),
            info.thumbprint,
            f"{info.validity.end:%Y-%m-%d}",
            _days_text(info),
            refused.address if (refused := _rejection(info)) else "",
            info.subject,
        )
        for info in found
    ]
    print_table([("state", "thumbprint", "valid until", "days left", "address", "subject"), *rows])


def _state_text(info: CertificateInfo) -> str:
    if info.bridge:
        return f"bridge {info.bridge}"
    return f"gateway {info.gateway}" if info.gateway else info.state.value


def _days_text(info: CertificateInfo) -> str:
    now = datetime.now(UTC)
    if now > info.validity.end:
        return "expired"
    return "not yet valid" if now < info.validity.begin else str(info.validity.days_left(now))


def trust_certificate(
    what: Annotated[
        str | None, typer.Argument(help="First characters of the thumbprint of a rejected certificate, or a file.")
    ] = None,
    bridge: _BridgeName = None,
    gateway: _GatewayName = None,
    last: Annotated[bool, typer.Option("--last", help="The certificate that was refused last; needs --show.")] = False,
    show_first: Annotated[
        bool, typer.Option("--show", help="Show subject, address and thumbprint, and ask for confirmation.")
    ] = False,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Let a client with this certificate connect; with --bridge or --gateway, know that bridge or gateway by it.

    The first connection of a client fails, since the server does not trust its certificate. `ua-fleet cert list` then
    shows the certificate as rejected, and this command trusts it by the first characters of its thumbprint. Compare
    these with what the client shows: anyone may write any subject into a certificate. A bridge has one certificate, by
    which it gets its keys of message security; a new one replaces the old one.

    A gateway is a client through which several users log in, each under their own name, such as the web console. A
    wrong password there locks out the user name that was tried, and not all users of the gateway. A gateway has no
    further rights. To make it an ordinary client again, trust its certificate without --gateway.
    """
    from ua_fleet.endpoint.certificates import CertificateError

    if bridge is not None and gateway is not None:
        raise UsageError("give --bridge or --gateway; a certificate is that of one of them")
    if (what is None) != last:
        raise UsageError(
            f"name a certificate, or give --last --show; list them with: ua-fleet cert list{config_option()}"
        )
    if last and not show_first:
        raise UsageError("another client may have been refused since; use --last --show, which asks for confirmation")
    fleet, folder = state_folder(config)
    if bridge is not None:
        _check_bridge(fleet, config, bridge)
    if last:
        what = _last_rejected(folder)
    assert what is not None
    try:
        if show_first and not _is_meant(folder, what):
            message("not trusted")
            raise typer.Exit(EXIT_FAILED)
        info = _trust(folder, what, bridge, gateway)
    except CertificateError as error:
        if Path(what).exists():
            raise
        raise NotFound(str(error)) from error
    if as_json:
        print_json(_as_json(info))
    else:
        named = f"  ({_state_text(info)})" if bridge or gateway else ""
        print_line(f"trusted {info.thumbprint}  {info.subject}{named}")


def _trust(folder: Path, what: str, bridge: str | None, gateway: str | None) -> CertificateInfo:
    from ua_fleet.endpoint.certificates import trust, trust_bridge, trust_gateway

    if gateway is not None:
        return trust_gateway(folder, gateway, what)
    return trust(folder, what) if bridge is None else trust_bridge(folder, bridge, what)


def _last_rejected(folder: Path) -> str:
    """The thumbprint of the certificate that was refused last."""
    from ua_fleet.endpoint.certificates import CertificateState, list_certificates
    from ua_fleet.endpoint.rejected import rejection_of

    waiting = [info for info in list_certificates(folder, strict=True) if info.state is CertificateState.REJECTED]
    if not waiting:
        raise NotFound("no certificate was refused; connect once with the client that you want to trust")
    return max(waiting, key=lambda info: rejection_of(info.path).last_s).thumbprint


def _is_meant(folder: Path, what: str) -> bool:
    """Show a certificate, and ask whether it is to be trusted."""
    from ua_fleet.endpoint.certificates import find_rejected
    from ua_fleet.endpoint.rejected import rejection_of

    info = find_rejected(folder, what)
    print_line(f"subject      {info.subject}")
    if not Path(what).is_file():
        refused = rejection_of(info.path)
        print_line(f"address      {refused.address or 'not known'}")
        print_line(f"refused      {utc_text(refused.last_s)}, first {utc_text(refused.first_s)}")
    print_line(f"valid until  {info.validity.end:%Y-%m-%d}")
    print_line(f"thumbprint   {info.thumbprint}")
    return typer.confirm("Does the client show the same data? Trust it", err=True)


def revoke_certificate(
    what: Annotated[
        str | None, typer.Argument(help="First characters of the certificate's thumbprint, or a file.")
    ] = None,
    bridge: _BridgeName = None,
    gateway: _GatewayName = None,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """End the trust in the certificate of a client, or with --bridge or --gateway in that of a bridge or gateway.

    This holds at once for new connections; the sessions of the bridge, or all sessions through the gateway, end too.
    `ua-fleet cert list` shows the certificate as rejected. A bridge still has the keys that it fetched before: to end
    that, an engineer calls InvalidateKeys on its SecurityGroups.
    """
    from ua_fleet.endpoint.certificates import CertificateError, revoke, revoke_bridge, revoke_gateway

    if sum(given is not None for given in (what, bridge, gateway)) != 1:
        raise UsageError(
            "name a certificate, a bridge with --bridge, or a gateway with --gateway; "
            f"list them with: ua-fleet cert list{config_option()}"
        )
    _, folder = state_folder(config)
    try:
        if bridge is not None:
            info = revoke_bridge(folder, bridge)
        else:
            info = revoke_gateway(folder, gateway) if gateway is not None else revoke(folder, str(what))
    except CertificateError as error:
        raise NotFound(str(error)) from error
    if bridge is not None:
        message("the bridge still has keys; call InvalidateKeys on the SecurityGroups that it must not use")
    if as_json:
        print_json(_as_json(info))
    else:
        print_line(f"revoked {info.thumbprint}  {info.subject}")


def forget(
    endpoint: Annotated[
        str, typer.Argument(envvar="UA_FLEET_ENDPOINT", help="URL of the OPC UA server.")
    ] = DEFAULT_ENDPOINT,
    bridge: _BridgeName = None,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Forget the certificates that servers at an endpoint have shown to this command line, or to a bridge.

    A server that shows another certificate than before is refused: it may be an impostor that wants the password. If
    you know why the certificate has changed, forget the old one. The next certificate that the server shows is then
    trusted.
    """
    with extra_needed("this command", "client"):
        from ua_fleet.client import ClientIdentity, default_identity_folder
    if bridge is None:
        identity = ClientIdentity(default_identity_folder())
    else:
        fleet = load_config(config, allow_missing_ids=True)
        _check_bridge(fleet, config, bridge)
        identity = ClientIdentity.of_bridge(
            config.resolve().parent / fleet.state_dir_of(bridge), fleet.fleet.name, bridge
        )
    forgotten = identity.known_servers.forget(endpoint)
    if not forgotten:
        known = ", ".join(sorted({server.endpoint for server in identity.known_servers.load()})) or "none"
        raise NotFound(f"no certificate is stored for {endpoint}; known endpoints: {known}")
    for server in forgotten:
        if as_json:
            print_json(
                {"endpoint": endpoint, "application_uri": server.application_uri, "thumbprint": server.thumbprint}
            )
        else:
            print_line(f"forgotten {server.thumbprint}  {server.application_uri}".rstrip())
