from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID

from tests.integration.server_security.harness import load, make_certificate
from ua_fleet.endpoint.bridge_trust import BridgeTrust
from ua_fleet.endpoint.certificates import (
    CertificateError,
    CertificateFiles,
    CertificateState,
    certificates_folder,
    create_certificate,
    ensure_application_certificate,
    ensure_client_certificate,
    host_names,
    list_certificates,
    load_certificate,
    revoke,
    revoke_bridge,
    revoke_gateway,
    thumbprint,
    trust,
    trust_bridge,
    trust_gateway,
)
from ua_fleet.endpoint.trust import CertificateRefused, TrustList, split_chain
from ua_fleet.errors import ServerStartError
from ua_fleet.transport.interfaces import machine_addresses

URI = "urn:test:server"
FOLDERS = ("trusted", "bridges", "gateways", "issuers", "crl")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, CertificateFiles]:
    state_dir = tmp_path_factory.mktemp("state")
    return state_dir, ensure_application_certificate(state_dir, URI, ["10.0.0.7", "robots.local"])


@pytest.fixture
def state(made: tuple[Path, CertificateFiles], tmp_path: Path) -> tuple[Path, CertificateFiles]:
    """A copy of the state folder that a test may spoil."""
    files = CertificateFiles(
        tmp_path / "certificates" / "own" / "server.der", tmp_path / "certificates" / "own" / "server-key.pem"
    )
    files.certificate.parent.mkdir(parents=True)
    for old, new in ((made[1].certificate, files.certificate), (made[1].private_key, files.private_key)):
        new.write_bytes(old.read_bytes())
        new.chmod(0o600)
    return tmp_path, files


def test_a_server_for_all_addresses_names_them(tmp_path: Path) -> None:
    """Its certificate named only 127.0.0.1, so a client that checks where it is connected refused the others."""
    files = ensure_application_certificate(tmp_path, URI, ["0.0.0.0"])
    named = host_names(load_certificate(files.certificate))
    reached = set(machine_addresses())
    assert reached, "this machine has an address besides loopback"
    assert reached <= named
    assert "0.0.0.0" not in named


@pytest.mark.parametrize("folder", ["", "certificates", *(f"certificates/{n}" for n in FOLDERS)])
def test_a_folder_that_others_may_write_stops_the_start(tmp_path: Path, folder: str) -> None:
    TrustList(tmp_path)
    (tmp_path / folder).chmod(0o770)
    with pytest.raises(ServerStartError, match=f"others may write there.*chmod go-w {tmp_path / folder}"):
        TrustList(tmp_path)
    (tmp_path / folder).chmod(0o755)
    TrustList(tmp_path)


def test_a_folder_or_file_that_others_may_write_is_not_trusted_any_more(tmp_path: Path) -> None:
    files = make_certificate(tmp_path, "client")
    trusted = trust(tmp_path, files.certificate)
    trust_list, chain = TrustList(tmp_path), [load_certificate(files.certificate)]
    trust_list.check(chain)
    folder = certificates_folder(tmp_path) / CertificateState.TRUSTED
    folder.chmod(0o777)
    with pytest.raises(CertificateRefused):
        trust_list.check(chain)
    folder.chmod(0o700)
    trust_list.check(chain)
    (certificates_folder(tmp_path) / "crl").chmod(0o777)
    with pytest.raises(CertificateRefused, match="others may write"):
        trust_list.check(chain)
    (certificates_folder(tmp_path) / "crl").chmod(0o700)
    (folder / f"{trusted.thumbprint}.der").chmod(0o666)
    with pytest.raises(CertificateRefused):
        TrustList(tmp_path).check(chain)


def test_application_certificate(made: tuple[Path, CertificateFiles]) -> None:
    state_dir, files = made
    certificate = load_certificate(files.certificate)
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.UniformResourceIdentifier) == [URI]
    assert {"robots.local", "localhost"} <= set(names.get_values_for_type(x509.DNSName))
    assert {"10.0.0.7", "127.0.0.1"} <= {str(address) for address in names.get_values_for_type(x509.IPAddress)}
    usage = certificate.extensions.get_extension_for_class(x509.KeyUsage).value
    assert usage.digital_signature
    assert usage.content_commitment
    assert usage.key_encipherment
    assert usage.data_encipherment
    extended = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert set(extended) == {ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH}
    certificate.verify_directly_issued_by(certificate)
    assert files.private_key.stat().st_mode & 0o777 == 0o600
    assert ensure_application_certificate(state_dir, URI) == files


def test_client_certificate_is_its_own(state: tuple[Path, CertificateFiles]) -> None:
    files = ensure_client_certificate(state[0], "urn:test:client")
    assert files.certificate != state[1].certificate
    extended = load_certificate(files.certificate).extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert list(extended) == [ExtendedKeyUsageOID.CLIENT_AUTH]
    TrustList(state[0], trust_all=True).check([load_certificate(files.certificate)])


def test_files_that_are_of_no_use_stop_the_start(state: tuple[Path, CertificateFiles]) -> None:
    state_dir, files = state
    with pytest.raises(ServerStartError, match="not for the application"):
        ensure_application_certificate(state_dir, "urn:another")
    files.private_key.chmod(0o640)
    with pytest.raises(ServerStartError, match="chmod 600"):
        ensure_application_certificate(state_dir, URI)
    files.private_key.chmod(0o600)
    key = files.private_key.read_bytes()
    files.private_key.write_bytes(key[:100])
    with pytest.raises(ServerStartError, match="cannot be read"):
        ensure_application_certificate(state_dir, URI)
    files.private_key.unlink()
    with pytest.raises(ServerStartError, match="cannot be read"):
        ensure_application_certificate(state_dir, URI)


def test_a_certificate_that_has_ended_stops_the_start_and_is_renewed_with_its_key(tmp_path: Path) -> None:
    files = ensure_client_certificate(tmp_path, URI, "server")
    key = files.private_key.read_bytes()
    create_certificate(files, application_uri=URI, common_name="x", days=-0.01, server=True, key=load(files)[1])
    with pytest.raises(ServerStartError, match=r"server\.der: expired on 20.{8}; run: ua-fleet cert create --renew$"):
        ensure_application_certificate(tmp_path, URI)
    ensure_application_certificate(tmp_path, URI, ["robots.local"], renew=True)
    assert files.private_key.read_bytes() == key
    ensure_application_certificate(tmp_path, URI)
    assert load_certificate(files.certificate).public_key() == load(files)[1].public_key()
    (info,) = list_certificates(tmp_path)
    assert info.validity.days_left(datetime.now(UTC)) in (5 * 365 - 1, 5 * 365)


def test_a_clients_certificate_says_its_own_renewal(tmp_path: Path) -> None:
    files = ensure_client_certificate(tmp_path, URI, "plc7")
    create_certificate(files, application_uri=URI, common_name="x", days=-0.01)
    with pytest.raises(ServerStartError, match="run: ua-fleet cert create --client plc7 --renew"):
        ensure_client_certificate(tmp_path, URI, "plc7")
    ensure_client_certificate(tmp_path, URI, "plc7", renew=True)
    ensure_client_certificate(tmp_path, URI, "plc7")


def test_what_is_not_valid_yet_and_what_a_ca_has_issued(tmp_path: Path) -> None:
    own = ensure_application_certificate(tmp_path, URI)
    authority = make_certificate(tmp_path, "ca", ca=True)

    def put(**options: Any) -> None:
        made = make_certificate(tmp_path, "own", uri=URI, **options)
        for source, target in ((made.certificate, own.certificate), (made.private_key, own.private_key)):
            target.write_bytes(source.read_bytes())

    put(days=(2, 30))
    with pytest.raises(ServerStartError, match=r"is valid only from .* UTC; check the clock of this machine"):
        ensure_application_certificate(tmp_path, URI)
    put(days=(-30, -1), issuer=load(authority))
    with pytest.raises(ServerStartError, match=r"expired on .*; have CN=ca renew it, and put it there"):
        ensure_application_certificate(tmp_path, URI)
    before = own.certificate.read_bytes()
    with pytest.raises(ServerStartError, match="is no certificate of ours; have CN=ca renew it"):
        ensure_application_certificate(tmp_path, URI, renew=True)
    assert own.certificate.read_bytes() == before


def test_hints_name_the_bridge_that_a_certificate_says_it_is_of(tmp_path: Path) -> None:
    uri = "urn:ua-fleet:Hall:bridge:cell"
    trust_list = TrustList(tmp_path, bridges={uri: "cell"})
    cases: list[tuple[str, dict[str, Any], str]] = [
        ("cell", {"uri": uri}, r"is not trusted; .* run: ua-fleet cert trust --bridge cell [0-9a-f]{12}$"),
        ("other", {}, r"is not trusted; .* run: ua-fleet cert trust [0-9a-f]{12}$"),
        ("old", {"uri": uri, "days": (-9, -1)}, "expired on .*; run: ua-fleet cert create --bridge cell --renew$"),
        ("old2", {"days": (-9, -1)}, "expired on .*; its owner has to renew it$"),
        ("early", {"days": (1, 9)}, "is valid only from .*; check the clocks of both machines$"),
    ]
    for name, options, said in cases:
        certificate, _ = load(make_certificate(tmp_path, name, **options))
        with pytest.raises(CertificateRefused, match=said):
            trust_list.check([certificate])


OIDS = {
    "key": ("2a864886f70d010101", "2a864886f70d010177"),
    "signature": ("2a864886f70d01010b", "2a864886f70d010155"),
    "extension twice": ("0603551d13", "0603551d11"),
    "name": (b"cell".hex(), "ff656c6c"),
}


@pytest.mark.parametrize("part", OIDS)
def test_a_certificate_with_a_part_that_cannot_be_read_is_refused_and_left_out(tmp_path: Path, part: str) -> None:
    whole = make_certificate(tmp_path, "cell").certificate.read_bytes()
    there, instead = map(bytes.fromhex, OIDS[part])
    data = whole.replace(there, instead)
    assert data != whole
    with pytest.raises(CertificateRefused, match=r"cannot be read|own signature is wrong"):
        TrustList(tmp_path, trust_all=True).check(split_chain(data))
    path = certificates_folder(tmp_path) / "trusted" / "odd.der"
    path.write_bytes(data)
    assert [info.path for info in list_certificates(tmp_path)] == ([] if part == "name" else [path])


def test_a_folder_that_cannot_be_read_hides_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ensure_application_certificate(tmp_path, URI)
    trusted = TrustList(tmp_path)
    listed = Path.iterdir

    def iterdir(folder: Path) -> Iterator[Path]:
        if folder.name == "trusted":
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        return listed(folder)

    certificate = load_certificate(make_certificate(tmp_path, "plc").certificate)
    trust(tmp_path, tmp_path / "plc.der")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "iterdir", iterdir)
        assert [info.path.name for info in list_certificates(tmp_path)] == ["server.der"]
        with pytest.raises(CertificateRefused, match="is not trusted"):
            trusted.check([certificate])
    trusted.check([certificate])


def test_trust_by_thumbprint_and_by_file(state: tuple[Path, CertificateFiles]) -> None:
    state_dir, files = state
    certificate = load_certificate(files.certificate)
    TrustList(state_dir).reject(certificate, "127.0.0.1")
    states = {info.state for info in list_certificates(state_dir)}
    assert states == {CertificateState.OWN, CertificateState.REJECTED}
    for wrong in ("", "zz", "/no/such/file.der"):
        with pytest.raises(CertificateError, match="ua-fleet cert list"):
            trust(state_dir, wrong)
    info = trust(state_dir, thumbprint(certificate)[:6].upper())
    assert (info.state, info.application_uri) == (CertificateState.TRUSTED, URI)
    assert info.validity.end > datetime.now(UTC) + timedelta(days=1000)
    assert [i.state for i in list_certificates(state_dir)] == [CertificateState.OWN, CertificateState.TRUSTED]
    pem = state_dir / "client.pem"
    pem.write_bytes(certificate.public_bytes(Encoding.PEM))
    assert trust(state_dir, pem).path == info.path
    with pytest.raises(CertificateError, match="no readable certificate"):
        trust(state_dir, files.private_key)


def test_trust_list_follows_its_folder(state: tuple[Path, CertificateFiles]) -> None:
    state_dir, files = state
    certificate = load_certificate(files.certificate)
    trusted = TrustList(state_dir)
    with pytest.raises(CertificateRefused, match="ua-fleet cert trust"):
        trusted.check([certificate])
    info = trust(state_dir, files.certificate)
    trusted.check([certificate])
    info.path.unlink()
    with pytest.raises(CertificateRefused):
        trusted.check([certificate])
    with pytest.raises(CertificateRefused, match="not that of"):
        trusted.check_uri(certificate, "urn:another")
    trusted.check_uri(certificate, URI)


def test_chains_are_split(made: tuple[Path, CertificateFiles]) -> None:
    data = made[1].certificate.read_bytes()
    assert len(split_chain(data * 3)) == 3
    version_6 = data.replace(b"\xa0\x03\x02\x01\x02", b"\xa0\x03\x02\x01\x05", 1)
    with pytest.raises(CertificateRefused, match="version"):
        split_chain(version_6)
    for wrong in (b"", b"0", b"\x30\x80", b"\x30\x83\xff\xff\xff", data[:-1], data + b"x", data * 6, b"\x00" * 20_000):
        with pytest.raises(CertificateRefused):
            split_chain(wrong)


def test_unreadable_files_are_left_out(
    state: tuple[Path, CertificateFiles], capsys: pytest.CaptureFixture[str]
) -> None:
    state_dir, _ = state
    trusted = TrustList(state_dir)
    (certificates_folder(state_dir) / "trusted" / "junk.der").write_bytes(b"junk")
    assert [info.state for info in list_certificates(state_dir)] == [CertificateState.OWN]
    assert "junk.der" in capsys.readouterr().out
    with pytest.raises(CertificateRefused):
        trusted.check([load_certificate(state[1].certificate)])


# --- bridges


def test_a_bridges_certificate_is_trusted_and_makes_no_other_one_trusted(tmp_path: Path) -> None:
    authority = make_certificate(tmp_path, "authority", ca=True)
    issued = make_certificate(tmp_path, "issued", issuer=load(authority))
    alone = make_certificate(tmp_path, "alone")
    trust_bridge(tmp_path, "hall", authority.certificate)
    trust_bridge(tmp_path, "cell", alone.certificate)
    trusted = TrustList(tmp_path)
    trusted.check([load_certificate(alone.certificate)])
    with pytest.raises(CertificateRefused, match="not trusted"):
        trusted.check([load_certificate(issued.certificate), load_certificate(authority.certificate)])


def test_a_bridge_is_known_by_its_certificate_alone(tmp_path: Path) -> None:
    old, new = (make_certificate(tmp_path, name) for name in ("old", "new"))
    known = BridgeTrust(tmp_path, ["cell", "hall"])
    assert known.unknown == ["cell", "hall"]
    trust_bridge(tmp_path, "cell", old.certificate)
    trust_bridge(tmp_path, "strange", new.certificate)
    generation = known.generation
    assert known.name_of(load_certificate(old.certificate)) == "cell"
    assert known.name_of(load_certificate(new.certificate)) == ""
    assert known.generation == generation + 1
    assert known.unknown == ["hall"]
    revoke_bridge(tmp_path, "strange")
    trust_bridge(tmp_path, "cell", new.certificate)
    assert known.name_of(load_certificate(old.certificate)) == ""
    assert known.name_of(load_certificate(new.certificate)) == "cell"
    revoke_bridge(tmp_path, "cell")
    assert known.name_of(load_certificate(new.certificate)) == ""
    with pytest.raises(CertificateRefused):
        TrustList(tmp_path).check([load_certificate(new.certificate)])


def test_one_certificate_is_one_bridges(tmp_path: Path) -> None:
    card = make_certificate(tmp_path, "card")
    trust_bridge(tmp_path, "cell", card.certificate)
    trust_bridge(tmp_path, "cell", card.certificate)
    with pytest.raises(CertificateError, match="bridge cell is known by this certificate"):
        trust_bridge(tmp_path, "hall", card.certificate)


def test_a_bridges_certificate_that_was_trusted_as_a_clients_is_moved(tmp_path: Path) -> None:
    card = make_certificate(tmp_path, "card")
    mark = trust(tmp_path, card.certificate).thumbprint
    trust_bridge(tmp_path, "cell", mark[:10])
    assert [(info.state, info.bridge) for info in list_certificates(tmp_path)] == [(CertificateState.BRIDGE, "cell")]


# --- gateways


def places(state_dir: Path) -> list[tuple[CertificateState, str]]:
    return [(info.state, info.gateway) for info in list_certificates(state_dir)]


def test_a_gateways_certificate_is_trusted_and_makes_no_other_one_trusted(tmp_path: Path) -> None:
    authority = make_certificate(tmp_path, "authority", ca=True)
    issued = make_certificate(tmp_path, "issued", issuer=load(authority))
    trust_gateway(tmp_path, "console", authority.certificate)
    trusted = TrustList(tmp_path)
    trusted.check([load_certificate(authority.certificate)])
    with pytest.raises(CertificateRefused, match="not trusted"):
        trusted.check([load_certificate(issued.certificate), load_certificate(authority.certificate)])
    assert trusted.gateways.name_of(load_certificate(issued.certificate)) == ""


def test_a_gateway_is_known_by_its_certificate_alone_and_at_once(tmp_path: Path) -> None:
    old, new = (make_certificate(tmp_path, name) for name in ("old", "new"))
    trusted = TrustList(tmp_path)
    known = trusted.gateways
    trust_gateway(tmp_path, "console", old.certificate)
    generation = known.generation
    assert known.name_of(load_certificate(old.certificate)) == "console"
    assert known.generation == generation + 1
    trust_gateway(tmp_path, "console", new.certificate)
    assert [known.name_of(load_certificate(each.certificate)) for each in (old, new)] == ["", "console"]
    assert TrustList(tmp_path).gateways.name_of(load_certificate(new.certificate)) == "console", "after a restart"
    revoke_gateway(tmp_path, "console")
    assert known.name_of(load_certificate(new.certificate)) == ""
    with pytest.raises(CertificateRefused):
        trusted.check([load_certificate(new.certificate)])
    with pytest.raises(CertificateError, match="no gateway console"):
        revoke_gateway(tmp_path, "console")


def test_a_client_becomes_a_gateway_and_an_ordinary_client_again(tmp_path: Path) -> None:
    card = make_certificate(tmp_path, "card")
    mark = trust(tmp_path, card.certificate).thumbprint
    # By its file too, which does not say where else it stands: `trusted/` would go on trusting what is revoked.
    trust_gateway(tmp_path, "console", card.certificate)
    assert places(tmp_path) == [(CertificateState.GATEWAY, "console")]
    for what in (mark[:10], card.certificate):
        trust(tmp_path, what)
        assert places(tmp_path) == [(CertificateState.TRUSTED, "")]
        trust_gateway(tmp_path, "console", mark[:10])
    revoke(tmp_path, mark[:10])
    assert places(tmp_path) == [(CertificateState.REJECTED, "")]
    trust_gateway(tmp_path, "console", mark[:10])
    assert places(tmp_path) == [(CertificateState.GATEWAY, "console")]


def test_one_certificate_is_one_gateways_and_no_bridges(tmp_path: Path) -> None:
    card, other = (make_certificate(tmp_path, name) for name in ("card", "other"))
    trust_gateway(tmp_path, "console", card.certificate)
    trust_gateway(tmp_path, "console", card.certificate)
    with pytest.raises(CertificateError, match="gateway console is known by this certificate"):
        trust_gateway(tmp_path, "board", card.certificate)
    trust_bridge(tmp_path, "cell", other.certificate)
    with pytest.raises(CertificateError, match="bridge cell is known by this certificate"):
        trust_gateway(tmp_path, "board", other.certificate)
    for name in ("", "../trusted/x", "a b", "x-key", "x" * 65):
        with pytest.raises(CertificateError, match="no name of a gateway"):
            trust_gateway(tmp_path, name, card.certificate)


def test_a_gateways_folder_that_others_may_write_marks_nothing(tmp_path: Path) -> None:
    card = load_certificate(make_certificate(tmp_path, "card").certificate)
    trusted = TrustList(tmp_path)
    trust_gateway(tmp_path, "console", tmp_path / "card.der")
    assert trusted.gateways.name_of(card) == "console"
    trusted.gateways.path.chmod(0o770)
    assert trusted.gateways.name_of(card) == ""
    with pytest.raises(ServerStartError, match="chmod go-w"):
        TrustList(tmp_path)


def test_a_server_that_begins_with_the_umask_of_a_group_does_not_refuse_its_own_folders(tmp_path: Path) -> None:
    before = os.umask(0o002)
    try:
        ensure_application_certificate(tmp_path / "state", URI, ["127.0.0.1"])
        TrustList(tmp_path / "state")
    finally:
        os.umask(before)
