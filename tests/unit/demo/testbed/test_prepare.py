"""The job that all containers wait for: what it makes and keeps, and what it says of volumes that are of no use."""

from __future__ import annotations

import asyncio
import os
import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from ua_demo.testbed.login import login_of
from ua_demo.testbed.plan import TESTBEDS, Options
from ua_demo.testbed.prepare import prepare
from ua_demo.testbed.volumes import check_volume, write_unless_edited

from tests.system import clean_environment
from ua_fleet.config.load import load
from ua_fleet.config.schema import FleetConfig
from ua_fleet.endpoint.certificates import (
    CertificateState,
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
from ua_fleet.endpoint.users import UserStore
from ua_fleet.errors import ConfigError


def prepared(folder: Path, name: str = "pal", options: Options | None = None) -> list[str]:
    """Run the job; what it said."""
    said: list[str] = []
    asyncio.run(prepare(TESTBEDS[name], folder, options or Options(), said.append))
    return said


def files_of(folder: Path) -> dict[Path, bytes]:
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_second_time_everything_stays(tmp_path: Path) -> None:
    assert prepared(tmp_path) == ["the testbed pal is prepared: 2 bridges, user operator"]
    before = files_of(tmp_path)
    assert prepared(tmp_path) == ["the testbed pal is prepared: 2 bridges, user operator"]
    assert files_of(tmp_path) == before


def test_all_know_each_other_and_nobody_else_reads_what_is_secret(tmp_path: Path) -> None:
    prepared(tmp_path)
    server = tmp_path / "server"
    infos = list_certificates(server)
    assert {info.bridge for info in infos} - {""} == {"arm_side", "mobile_side"}
    own = (server / "certificates" / "own" / "server.der").read_bytes()
    pinned = [*(tmp_path / name / "server.der" for name in ("arm_side", "mobile_side"))]
    pinned.append(tmp_path / "operator" / "ua-fleet" / "client" / "server.der")
    pinned.append(tmp_path / "console" / "server.der")
    assert [path.read_bytes() for path in pinned] == [own] * 4
    gateways = {info.gateway: info.thumbprint for info in infos if info.gateway}
    assert gateways == {"console": thumbprint(load_certificate(tmp_path / "console" / "console.der"))}
    names = host_names(load_certificate(server / "certificates" / "own" / "server.der"))
    assert names >= {"server", "localhost", "127.0.0.1"}

    password = (tmp_path / "operator" / "password").read_text().strip()
    user = UserStore(server / "users.yaml").verify("operator", password)
    assert user is not None
    assert user.role.value == "operator"
    names_of_secrets = ("password", "users.yaml")
    keys = [path for path in tmp_path.rglob("*") if path.name in names_of_secrets or path.match("*-key*.[!l]*")]
    assert len(keys) == 7
    assert {path.stat().st_mode & 0o077 for path in [*keys, *tmp_path.iterdir()]} == {0}


def test_what_was_revoked_stays_so_until_somebody_trusts_it_again(tmp_path: Path) -> None:
    prepared(tmp_path)
    server = tmp_path / "server"
    client = thumbprint(load_certificate(tmp_path / "operator" / "ua-fleet" / "client" / "client.der"))
    bridge = revoke_bridge(server, "arm_side").thumbprint
    revoke(server, client)
    console = revoke_gateway(server, "console").thumbprint
    *said, _ = prepared(tmp_path)
    assert [line.partition("; ")[2] for line in said] == [
        f"undo it on the server with: ua-fleet cert trust --bridge arm_side {bridge[:12]}",
        f"undo it on the server with: ua-fleet cert trust {client[:12]}",
        f"undo it on the server with: ua-fleet cert trust --gateway console {console[:12]}",
    ]
    trusted = {info.thumbprint for info in list_certificates(server) if info.state is not CertificateState.REJECTED}
    assert trusted.isdisjoint({bridge, client, console})
    trust(server, client)
    trust_bridge(server, "arm_side", bridge)
    trust_gateway(server, "console", console)
    assert len(prepared(tmp_path)) == 1


def test_what_uaexpert_needs_is_told_from_the_operators_volume_alone(tmp_path: Path) -> None:
    prepared(tmp_path)
    own = load_certificate(tmp_path / "server" / "certificates" / "own" / "server.der")
    for path in (tmp_path / "server").rglob("*.der"):
        path.unlink()
    found = login_of(tmp_path, Options(published_port=4999, console_port=8099))
    assert found.endpoint == "opc.tcp://127.0.0.1:4999/ua_fleet"
    assert found.console == "http://127.0.0.1:8099/"
    assert found.password == (tmp_path / "operator" / "password").read_text().strip()
    assert re.fullmatch("[0-9a-f]{40}", found.server_thumbprint)
    assert "server" in host_names(own)
    (tmp_path / "operator" / "password").unlink()
    with pytest.raises(ConfigError, match=r"operator: the testbed is not prepared: No such file.*testbed prepare$"):
        login_of(tmp_path, Options())


def test_a_server_that_has_lost_its_users_gets_the_operator_again(tmp_path: Path) -> None:
    prepared(tmp_path)
    password = tmp_path / "operator" / "password"
    before = password.read_text()
    (tmp_path / "server" / "users.yaml").unlink()
    prepared(tmp_path)
    assert password.read_text() != before
    assert UserStore(tmp_path / "server" / "users.yaml").verify("operator", password.read_text().strip()) is not None


def nine_tasks(folder: Path, options: Options) -> FleetConfig:
    assert write_unless_edited(folder, TESTBEDS["talkrobots"].files(options)) == []
    return load(folder / "fleet.yaml", {})


def test_other_options_are_taken_the_next_time(tmp_path: Path) -> None:
    first = nine_tasks(tmp_path, Options(mode="operator"))
    second = nine_tasks(tmp_path, Options(speed=10, mode="automatic", network="10.9.8"))
    assert [config.resilience.mode for config in (first, second)] == ["operator", "automatic"]
    assert [config.pubsub.interface for config in (first, second)] == ["10.214.84.0/26", "10.9.8.0/26"]
    assert first.pubsub.security.value == second.pubsub.security.value == "sign_and_encrypt"
    assert not second.server.trust_all_clients
    assert second.modbus is not None
    assert {bridge.requestors for bridge in second.bridges.values()} == {(0,)}
    carried = nine_tasks(tmp_path, Options(mode="automatic", is_carried=True))
    spaces = sorted(bridge.space for bridge in carried.bridges.values())
    assert {bridge.requestors for bridge in carried.bridges.values()} == {(0, *spaces)}
    assert second.modbus.writers == ("10.9.8.192/27", "127.0.0.1")
    states = {f"../{name}" for name in TESTBEDS["talkrobots"].bridges}
    assert {second.state_dir_of(name) for name in second.bridges} == states


def test_a_file_that_somebody_has_edited_is_kept_and_that_is_said(tmp_path: Path) -> None:
    prepared(tmp_path)
    file = tmp_path / "fleet" / "fleet.yaml"
    edited = file.read_text().replace("Assembles boxes", "Assembles boxes of paper")
    file.write_text(edited)
    said = prepared(tmp_path, options=Options(network="10.9.8"))
    assert said[0] == f"{file} was edited, and is kept whatever UA_FLEET_... says; remove it for a new one"
    assert file.read_text() == edited
    file.unlink()
    assert len(prepared(tmp_path, options=Options(network="10.9.8"))) == 1
    assert "10.9.8.0/26" in file.read_text()


def test_a_mistake_in_an_edited_file_is_found_before_anything_starts(tmp_path: Path) -> None:
    prepared(tmp_path)
    file = tmp_path / "fleet" / "fleet.yaml"
    file.write_text(file.read_text().replace("kind: ros1", "kind: ros3"))
    with pytest.raises(Exception, match=r"fleet\.yaml:\d+.*ros3"):
        prepared(tmp_path)


def test_the_volumes_of_the_other_testbed_are_left_alone(tmp_path: Path) -> None:
    prepared(tmp_path)
    before = files_of(tmp_path)
    with pytest.raises(
        ConfigError, match=r"fleet\.yaml: this is another fleet's; give this testbed volumes of its own"
    ):
        prepared(tmp_path, "talkrobots")
    assert files_of(tmp_path) == before
    assert {path.name for path in tmp_path.iterdir()} == set(TESTBEDS["pal"].volumes)


def test_a_new_published_address_is_said_to_be_missing_in_the_certificate(tmp_path: Path) -> None:
    prepared(tmp_path)
    said = prepared(tmp_path, options=Options(published_host="192.0.2.7"))
    assert "server.der does not name 192.0.2.7: UaExpert will say so" in said[0]


def test_volumes_with_wrong_rights_are_named_with_the_remedy(tmp_path: Path) -> None:
    me = os.geteuid()
    folder = tmp_path / "server"
    folder.mkdir(mode=0o750)
    with pytest.raises(ConfigError, match=r"server: the volume server has the mode 750.*run there: chmod 700 \.$"):
        check_volume(folder, me)
    folder.chmod(0o700)
    check_volume(folder, me)
    with pytest.raises(ConfigError) as refused:
        check_volume(folder, me + 1)
    assert str(refused.value) == (
        f"{folder}: the volume server belongs to user {me}, and its processes run as {me + 1}; "
        f"remove it (docker volume rm), and it is made anew, or run there: chown -R {me + 1} ."
    )
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(ConfigError, match=r"events: there is no volume events: Not a directory; mount a volume there"):
        check_volume(file / "events", me)


def test_a_disk_without_room_is_told_in_one_line(tmp_path: Path) -> None:
    def no_room() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))

    ended = subprocess.run(
        [sys.executable, "-m", "ua_fleet.cli", "testbed", "prepare", "pal", "--folder", str(tmp_path)],
        env=clean_environment(PYTHONDONTWRITEBYTECODE="1"),
        preexec_fn=no_room,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert ended.returncode == 2
    (line,) = ended.stderr.splitlines()
    assert re.fullmatch(r"ua-fleet: .+: cannot be written: File too large; free some room, .+", line)


def test_a_file_is_whole_whatever_was_written_before(tmp_path: Path) -> None:
    assert write_unless_edited(tmp_path, {"a/b": "one"}) == []
    assert write_unless_edited(tmp_path, {"a/b": "two"}) == []
    (tmp_path / "a" / "b").write_text("mine")
    assert write_unless_edited(tmp_path, {"a/b": "three"}) == ["a/b"]
    # What the user has made of it is what the job would write: it is the job's again.
    assert write_unless_edited(tmp_path, {"a/b": "mine"}) == []
    assert write_unless_edited(tmp_path, {"a/b": "three"}) == []
    assert (tmp_path / "a" / "b").read_text() == "three"
