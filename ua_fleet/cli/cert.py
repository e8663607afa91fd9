"""`ua-fleet cert`: the server's certificate, and which clients it trusts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ua_fleet.cli.endings import NotFound, extra_needed
from ua_fleet.cli.options import DEFAULT_CONFIG, Config, Json, state_folder
from ua_fleet.cli.output import message, print_json, print_line, print_table

if TYPE_CHECKING:
    from ua_fleet.server.certificates import CertificateInfo

__all__ = ["CREATE_EXAMPLES", "LIST_EXAMPLES", "TRUST_EXAMPLES", "create", "show", "trust_certificate"]

CREATE_EXAMPLES = ("ua-fleet cert create", "ua-fleet cert create --client plc7")
LIST_EXAMPLES = ("ua-fleet cert list", "ua-fleet cert list --json -c hall2.yaml")
TRUST_EXAMPLES = ("ua-fleet cert trust 3f2a9c", "ua-fleet cert trust uaexpert.der")


def _as_json(info: CertificateInfo) -> dict[str, Any]:
    return {
        "state": info.state.value,
        "thumbprint": info.thumbprint,
        "subject": info.subject,
        "application_uri": info.application_uri,
        "not_valid_after": info.not_valid_after.isoformat(),
        "expired": info.expired,
        "path": str(info.path),
    }


def create(
    client: Annotated[
        str | None, typer.Option(help="Make a certificate and key for a client of this name, to be carried to it.")
    ] = None,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Make the server's certificate and key, unless they are there.

    The server makes its own at its first start; this command does it before, for instance to hand the certificate to
    clients. To renew one, move the old file away first.
    """
    from ua_fleet.server.certificates import (
        ensure_application_certificate,
        ensure_client_certificate,
        list_certificates,
    )

    fleet, folder = state_folder(config)
    if client is None:
        with extra_needed("the server", "server"):
            from ua_fleet.server.app import application_uri
        made = ensure_application_certificate(folder, application_uri(fleet), [fleet.server.host])
    else:
        made = ensure_client_certificate(folder, f"urn:ua-fleet:{fleet.fleet.name}:client:{client}", client)
        message(f"its key: {made.private_key}; let it in with: ua-fleet cert trust {made.certificate}")
    info = next(info for info in list_certificates(folder) if info.path == made.certificate)
    if as_json:
        print_json({**_as_json(info), "private_key": str(made.private_key)})
    else:
        print_line(f"{made.certificate}  {info.thumbprint}")


def show(config: Config = DEFAULT_CONFIG, as_json: Json = False) -> None:
    """List certificates: the server's own, those of trusted clients, and those that were refused (rejected)."""
    from ua_fleet.server.certificates import list_certificates

    _, folder = state_folder(config)
    found = list_certificates(folder)
    if as_json:
        for info in found:
            print_json(_as_json(info))
        return
    if not found:
        message("there are no certificates yet; the server makes its own at its first start")
        return
    rows = [
        (
            info.state.value,
            info.thumbprint,
            f"{info.not_valid_after:%Y-%m-%d}{' (expired)' if info.expired else ''}",
            info.subject,
        )
        for info in found
    ]
    print_table([("state", "thumbprint", "valid until", "subject"), *rows])


def trust_certificate(
    what: Annotated[str, typer.Argument(help="First characters of a rejected one's thumbprint, or a file.")],
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Let a client with this certificate connect.

    A client that is not trusted yet connects in vain once; then its certificate stands in `ua-fleet cert list` as
    rejected, and is trusted by the first characters of its thumbprint. Compare these with what the client shows.
    """
    from ua_fleet.server.certificates import CertificateError, trust

    _, folder = state_folder(config)
    try:
        info = trust(folder, what)
    except CertificateError as error:
        if Path(what).exists():
            raise
        raise NotFound(str(error)) from error
    if as_json:
        print_json(_as_json(info))
    else:
        print_line(f"trusted {info.thumbprint}  {info.subject}")
