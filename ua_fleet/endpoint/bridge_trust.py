"""Which bridge a client is: each is known by one certificate, bound to its name by `ua-fleet cert trust --bridge`."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from cryptography import x509

from ua_fleet.endpoint.certificates import CertificateState, certificates_folder
from ua_fleet.endpoint.trust import CertificateFolder

__all__ = ["BridgeTrust"]


class BridgeTrust:
    """The folder `bridges/`, looked at again whenever it changes."""

    def __init__(self, state_dir: Path, names: Iterable[str]) -> None:
        """Read the certificates.

        Args:
            state_dir: the server's.
            names: the bridges of `fleet.yaml`; certificates of others are not looked at.
        """
        self._names = frozenset(names)
        self._folder = CertificateFolder(certificates_folder(state_dir) / CertificateState.BRIDGE)
        self.refresh()

    @property
    def generation(self) -> int:
        """Grows whenever the folder has changed."""
        return self._folder.generation

    def refresh(self) -> None:
        """Look whether the folder has changed."""
        self._folder.refresh()

    @property
    def unknown(self) -> list[str]:
        """Bridges of `fleet.yaml` that no certificate is bound to."""
        return sorted(self._names.difference(self._folder.names.values()))

    def name_of(self, certificate: x509.Certificate) -> str:
        """The bridge that is known by this certificate; empty when none is."""
        name = self._folder.name_of(certificate)
        return name if name in self._names else ""
