"""Authorities, and certificates that they have signed, for brokers with TLS."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Final

_NEW_KEY: Final = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1")
"""Of an elliptic curve: one of RSA takes 0.2 s of computing."""


def openssl(*arguments: str | Path) -> None:
    subprocess.run(["openssl", *map(str, arguments)], check=True, capture_output=True)


def authority(folder: Path, name: str) -> None:
    openssl(
        *("req", "-x509", *_NEW_KEY, "-nodes", "-days", "2", "-subj", f"/CN={name}"),
        *("-keyout", folder / f"{name}.key", "-out", folder / f"{name}.pem"),
    )


def certificate(folder: Path, name: str, by: str, address: str = "127.0.0.1") -> None:
    """A key and a certificate that an authority has signed."""
    (folder / "san").write_text(f"subjectAltName=IP:{address}\n")
    openssl(
        *("req", *_NEW_KEY, "-nodes", "-subj", f"/CN={name}"),
        *("-keyout", folder / f"{name}.key", "-out", folder / f"{name}.csr"),
    )
    openssl(
        *("x509", "-req", "-days", "2", "-in", folder / f"{name}.csr", "-extfile", folder / "san"),
        *(
            "-CA",
            folder / f"{by}.pem",
            "-CAkey",
            folder / f"{by}.key",
            "-CAcreateserial",
            "-out",
            folder / f"{name}.pem",
        ),
    )
