from __future__ import annotations

import json
import os
import pty
import sys
import time
from pathlib import Path

import pytest

from tests.system import forked, run
from tests.unit.cli.conftest import FLEET, Invoke
from ua_fleet.cli.decision import DecisionModeName, LimitName
from ua_fleet.cli.options import Policy
from ua_fleet.cli.user import RoleName
from ua_fleet.endpoint import certificates
from ua_fleet.endpoint.certificates import CertificateFiles, create_certificate
from ua_fleet.endpoint.rejected import RejectedCertificates
from ua_fleet.endpoint.session_keys import DAY_S, KEYS_FILE, SessionKeys
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore
from ua_fleet.resilience import DecisionMode, OnLimit

PASSWORD = "correct horse"
ON_OWN_TERMINAL = Path(__file__).with_name("on_own_terminal.py")


@pytest.fixture(autouse=True)
def _cheap_hashes(monkeypatch: pytest.MonkeyPatch) -> None:  # pyright: ignore[reportUnusedFunction]
    defaults = UserStore.__init__.__defaults__
    assert defaults is not None
    monkeypatch.setattr(UserStore.__init__, "__defaults__", (ScryptCost(n=2**4, r=8, p=1),))


def store_of(fleet: Path) -> UserStore:
    store = UserStore(fleet.parent / "state" / USERS_FILE)
    store.refresh()
    return store


def test_the_names_of_roles_and_policies_are_those_of_the_parts_that_know_them() -> None:
    from ua_fleet.client import POLICIES

    assert [role.value for role in RoleName] == [role.value for role in Role]
    assert [policy.value for policy in Policy] == list(POLICIES)
    assert [mode.value for mode in DecisionModeName] == [mode.value for mode in DecisionMode]
    assert [limit.value for limit in LimitName] == [limit.value for limit in OnLimit]


def test_add_list_remove(invoke: Invoke, fleet: Path) -> None:
    assert "no user exists" in invoke("user", "list").stderr
    ended = invoke("user", "add", "anna", "--role", "operator", "--password-file", "-", stdin=PASSWORD + "\n")
    assert (ended.code, ended.stdout) == (0, "anna (operator)\n")
    assert PASSWORD not in (fleet.parent / "state" / USERS_FILE).read_text()
    user = store_of(fleet).verify("anna", PASSWORD)
    assert user is not None
    assert user.role is Role.OPERATOR
    secret = fleet.parent / "secret"
    secret.write_text("another secret\r\nsecond line\n")
    secret.chmod(0o640)
    ended = invoke("user", "add", "bob", "--password-file", "secret")
    assert (ended.code, ended.stderr) == (
        2,
        "ua-fleet: secret: others may read the password (mode 640); run: chmod 600 secret\n",
    )
    secret.chmod(0o600)
    ended = invoke("user", "add", "bob", "--password-file", "secret", "--json")
    assert json.loads(ended.stdout) == {"name": "bob", "role": "observer"}
    assert store_of(fleet).verify("bob", "another secret") is not None
    assert invoke("user", "list").stdout == "name  role\nanna  operator\nbob   observer\n"
    assert [json.loads(line) for line in invoke("user", "list", "--json").stdout.splitlines()] == [
        {"name": "anna", "role": "operator"},
        {"name": "bob", "role": "observer"},
    ]
    assert invoke("user", "remove", "anna").stdout == "removed anna\n"
    assert [user.name for user in store_of(fleet).list()] == ["bob"]


def test_session_keys_are_listed_and_ended(invoke: Invoke, fleet: Path) -> None:
    users = store_of(fleet)
    users.add("anna", PASSWORD, Role.OPERATOR)
    users.add("bert", PASSWORD, Role.OBSERVER)
    assert "there are no session keys" in invoke("user", "keys", "-c", str(fleet)).stderr
    keys = SessionKeys(fleet.parent / "state" / KEYS_FILE, users, 30 * DAY_S)
    now = time.time()
    desk, lab = (keys.issue("anna", name, DAY_S, now).key for name in ("desk", "lab"))
    other = keys.issue("bert", "desk", DAY_S, now).key
    listed = invoke("user", "keys", "anna", "-c", str(fleet), "--json")
    assert [json.loads(line)["key"] for line in listed.stdout.splitlines()] == [desk.id, lab.id]
    shown = invoke("user", "keys", "-c", str(fleet)).stdout.splitlines()
    assert [line.split()[:3] for line in shown[1:]] == [
        ["anna", desk.id, "desk"],
        ["anna", lab.id, "lab"],
        ["bert", other.id, "desk"],
    ]
    ended = invoke("user", "logout", "anna", "--key", desk.id, "-c", str(fleet))
    assert ended.stdout == f"ended {desk.id}  desk\n"
    assert invoke("user", "logout", "anna", "-c", str(fleet)).stdout == f"ended {lab.id}  lab\n"
    again = invoke("user", "logout", "anna", "-c", str(fleet))
    assert again.code == 3
    assert "ua-fleet user keys" in again.stderr
    assert [key.id for key in keys.list(now)] == [other.id]


def test_what_is_refused(invoke: Invoke, fleet: Path) -> None:
    ended = invoke("user", "add", "anna", "--password-file", "-", stdin="short\n")
    assert (ended.code, ended.stderr) == (2, "ua-fleet: the password must have 8 to 1024 characters\n")
    ended = invoke("user", "add", "an na", "--password-file", "-", stdin=PASSWORD)
    assert ended.code == 2
    assert "is no user name" in ended.stderr
    ended = invoke("user", "add", "anna", "--password-file", "nowhere")
    assert ended.code == 2
    assert ended.stderr.startswith("ua-fleet: nowhere: the password cannot be read: No such file or directory; ")
    ended = invoke("user", "add", "anna", stdin="")
    assert ended.code == 2
    assert "there is no terminal to ask for the password" in ended.stderr
    assert store_of(fleet).list() == ()
    ended = invoke("user", "remove", "anna")
    assert (ended.code, ended.stderr) == (3, "ua-fleet: there is no user anna; list them with: ua-fleet user list\n")


def test_an_existing_user_is_changed_only_when_asked(invoke: Invoke, fleet: Path) -> None:
    invoke("user", "add", "anna", "--password-file", "-", stdin=PASSWORD)
    ended = invoke("user", "add", "anna", "--password-file", "-", stdin="something else")
    assert ended.code == 2
    assert ended.stderr.endswith("to change the password run: ua-fleet user add anna --role observer --replace\n")
    assert store_of(fleet).verify("anna", PASSWORD) is not None
    assert invoke("user", "add", "anna", "--replace", "--password-file", "-", stdin="something else").code == 0
    assert store_of(fleet).verify("anna", "something else") is not None


def test_another_password_takes_away_no_right(invoke: Invoke, fleet: Path) -> None:
    arguments = ("user", "add", "eva", "-c", str(fleet), "--password-file", "-")
    assert invoke(*arguments, "--role", "engineer", stdin=PASSWORD).code == 0
    ended = invoke(*arguments, stdin="something else")
    remedy = ended.stderr.partition("to change the password run: ua-fleet ")[2].split()
    assert remedy == ["user", "add", "eva", "--role", "engineer", "--replace", "-c", str(fleet)]
    assert invoke(*remedy, "--password-file", "-", stdin="something else").stdout == "eva (engineer)\n"
    assert invoke(*arguments, "--replace", stdin=PASSWORD).stdout == "eva (engineer)\n", "without --role"
    assert invoke(*arguments, "--replace", "--role", "operator", stdin=PASSWORD).stdout == "eva (operator)\n"


def type_at_terminal(fleet: Path, answers: list[str]) -> tuple[int, str]:
    """Run `user add` on a terminal, and type the answers; the exit code and all that the terminal showed."""
    controller, terminal = pty.openpty()
    words = ("user", "add", "anna", "--role", "operator", "-c", str(fleet))
    process = forked(sys.executable, ON_OWN_TERMINAL, *words, terminal=terminal)
    os.close(terminal)
    shown = b""
    for prompt, answer in zip(
        (b"Password for anna (at least 8 characters): ", b"The same again: "), answers, strict=False
    ):
        while prompt not in shown:
            shown += os.read(controller, 1024)
        os.write(controller, answer.encode())
    while True:
        try:
            more = os.read(controller, 1024)
        except OSError:  # the other side is closed (Linux)
            break
        shown += more
    os.close(controller)
    return process.wait(60), shown.decode()


def test_on_a_terminal_the_password_is_asked_for_twice_and_never_shown(fleet: Path) -> None:
    code, shown = type_at_terminal(fleet, [f"{PASSWORD}\n", f"{PASSWORD}\n"])
    assert code == 0
    assert PASSWORD not in shown
    assert store_of(fleet).verify("anna", PASSWORD) is not None


def test_two_passwords_that_differ(fleet: Path) -> None:
    code, shown = type_at_terminal(fleet, [f"{PASSWORD}\n", "another\n"])
    assert code == 2
    assert f"nothing was changed; run again: ua-fleet user add anna --role operator -c {fleet}\r\n" in shown
    assert store_of(fleet).list() == ()


def test_a_password_that_is_too_short_is_not_asked_for_again(fleet: Path) -> None:
    code, shown = type_at_terminal(fleet, ["short\n"])
    assert code == 2
    assert "the password must have 8 to 1024 characters" in shown
    assert "The same again" not in shown
    assert store_of(fleet).list() == ()


def test_ctrl_c_at_the_password(fleet: Path) -> None:
    code, shown = type_at_terminal(fleet, ["\x03"])
    assert code == 130
    assert "Traceback" not in shown


# --- certificates


def test_create_list_trust(invoke: Invoke, fleet: Path) -> None:
    assert "no certificate exists yet" in invoke("cert", "list").stderr
    ended = invoke("cert", "create")
    assert ended.code == 0
    made, thumbprint = ended.stdout.split()
    assert Path(made) == fleet.parent / "state" / "certificates" / "own" / "server.der"
    assert invoke("cert", "create").stdout == ended.stdout
    ended = invoke("cert", "create", "--client", "plc7", "--json")
    made_for_plc = json.loads(ended.stdout)
    assert made_for_plc["application_uri"] == "urn:ua-fleet:Fleet:client:plc7"
    assert Path(made_for_plc["private_key"]).stat().st_mode & 0o777 == 0o600
    assert f"ua-fleet cert trust {made_for_plc['path']}" in ended.stderr
    ended = invoke("cert", "trust", made_for_plc["path"])
    assert ended.stdout.startswith(f"trusted {made_for_plc['thumbprint']}  ")
    lines = invoke("cert", "list").stdout.splitlines()
    assert lines[0].split() == ["state", "thumbprint", "valid", "until", "days", "left", "address", "subject"]
    assert {tuple(line.split()[:2]) for line in lines[1:]} == {
        ("own", thumbprint),
        ("own", made_for_plc["thumbprint"]),
        ("trusted", made_for_plc["thumbprint"]),
    }


def test_a_rejected_certificate_is_trusted_by_its_thumbprint(invoke: Invoke, fleet: Path) -> None:
    state = fleet.parent / "state"
    made = certificates.ensure_client_certificate(state, "urn:client", "x")
    rejected = certificates.certificates_folder(state) / "rejected" / "x.der"
    rejected.parent.mkdir(parents=True)
    made.certificate.rename(rejected)
    listed = [json.loads(line) for line in invoke("cert", "list", "--json").stdout.splitlines()]
    assert [info["state"] for info in listed] == ["rejected"]
    ended = invoke("cert", "trust", listed[0]["thumbprint"][:8], "--json")
    assert json.loads(ended.stdout)["state"] == "trusted"
    assert not rejected.exists()


def refused(fleet: Path, name: str, address: str, at_s: float) -> str:
    """Offer the server a certificate from an address, as a client does that it does not know; its thumbprint."""
    folder = certificates.certificates_folder(fleet.parent / "state") / "rejected"
    folder.mkdir(parents=True, exist_ok=True)
    files = CertificateFiles(fleet.parent / "client.der", fleet.parent / "client.pem")
    certificate = create_certificate(files, application_uri="urn:client", common_name=name)
    RejectedCertificates(folder, lambda: at_s).keep(certificate, address)
    return certificates.thumbprint(certificate)


def test_the_last_refused_is_shown_before_it_is_trusted(invoke: Invoke, fleet: Path) -> None:
    assert "no certificate was refused" in invoke("cert", "trust", "--last", "--show").stderr
    later = refused(fleet, "later", "10.0.0.2", 2_000_000_000.0)
    refused(fleet, "earlier", "10.0.0.1", 1_000_000_000.0)
    assert "use --last --show" in invoke("cert", "trust", "--last").stderr
    assert invoke("cert", "trust", "--last", "--show", later).code == 2
    shown = invoke("cert", "trust", "--last", "--show", stdin="n\n")
    assert shown.code == 1
    for part in ("CN=later", "10.0.0.2", later, "2033-05-18 03:33:20 UTC"):
        assert part in shown.stdout
    listed = {
        info["thumbprint"]: info for info in map(json.loads, invoke("cert", "list", "--json").stdout.splitlines())
    }
    assert (listed[later]["state"], listed[later]["address"]) == ("rejected", "10.0.0.2")
    assert f"trusted {later}" in invoke("cert", "trust", "--last", "--show", stdin="y\n").stdout
    assert not list((fleet.parent / "state" / "certificates" / "rejected").glob(f"{later}.*"))


def test_a_subject_forges_no_line(invoke: Invoke, fleet: Path) -> None:
    mark = refused(fleet, "x\nrejected deadbeef\x1b[2J\u202e", "10.0.0.1", 1_000_000_000.0)
    for ended in (invoke("cert", "list"), invoke("cert", "trust", mark, "--show", stdin="n\n")):
        assert "rejected deadbeef" in ended.stdout
        assert not any(line.startswith("rejected deadbeef") for line in ended.stdout.splitlines())
        assert all(line.isprintable() for line in ended.stdout.splitlines())


def test_certificates_that_are_not_there(invoke: Invoke, fleet: Path) -> None:
    ended = invoke("cert", "trust", "3f2a")
    assert (ended.code, ended.stdout) == (3, "")
    assert ended.stderr.endswith("list them with: ua-fleet cert list\n")
    (fleet.parent / "text.der").write_text("no certificate")
    ended = invoke("cert", "trust", "text.der")
    assert ended.code == 2
    assert "text.der: no readable certificate" in ended.stderr


# --- bridges


def test_a_bridge_and_the_server_know_each_other_by_one_command(invoke: Invoke, fleet: Path) -> None:
    ended = invoke("cert", "create", "--bridge", "cell", "--trust", "--json")
    made = json.loads(ended.stdout)
    folder = fleet.parent / "state" / "bridges" / "cell"
    assert made["path"] == str(folder / "bridge.der")
    assert made["application_uri"] == "urn:ua-fleet:Fleet:bridge:cell"
    assert made["trusted"]
    assert Path(made["private_key"]).stat().st_mode & 0o777 == 0o600
    own = fleet.parent / "state" / "certificates" / "own" / "server.der"
    assert (folder / "server.der").read_bytes() == own.read_bytes()
    listed = {
        (info["state"], info["bridge"]): info for info in map(json.loads, lines(invoke, "cert", "list", "--json"))
    }
    assert listed["bridges", "cell"]["thumbprint"] == made["thumbprint"]
    assert ["bridge", "cell", made["thumbprint"]] in [line.split()[:3] for line in lines(invoke, "cert", "list")]
    assert json.loads(invoke("cert", "create", "--bridge", "cell", "--json").stdout)["thumbprint"] == made["thumbprint"]


def lines(invoke: Invoke, *arguments: str) -> list[str]:
    return invoke(*arguments).stdout.splitlines()


def test_a_bridge_on_another_machine_is_made_known_by_its_file(invoke: Invoke, fleet: Path) -> None:
    ended = invoke("cert", "create", "--bridge", "cell")
    made = fleet.parent / "state" / "bridges" / "cell" / "bridge.der"
    assert ended.stdout.startswith(f"{made}  ")
    assert ended.stderr == f"on the server run: ua-fleet cert trust --bridge cell {made}\n"
    ended = invoke("cert", "trust", "--bridge", "cell", str(made))
    assert ended.stdout.startswith("trusted ")
    assert ended.stdout.endswith("  (bridge cell)\n")
    ended = invoke("cert", "revoke", "--bridge", "cell")
    assert ended.stdout.startswith("revoked ")
    assert "InvalidateKeys" in ended.stderr
    listed = [json.loads(line) for line in lines(invoke, "cert", "list", "--json")]
    assert [(info["state"], info["bridge"]) for info in listed] == [("rejected", None)]
    ended = invoke("cert", "trust", "--bridge", "cell", listed[0]["thumbprint"][:10])
    assert ended.code == 0
    assert ended.stdout.endswith("  (bridge cell)\n")
    assert [json.loads(line)["state"] for line in lines(invoke, "cert", "list", "--json")] == ["bridges"]


def test_a_bridge_keeps_its_state_where_the_file_says(invoke: Invoke, fleet: Path) -> None:
    fleet.write_text(fleet.read_text().replace("kind: ros1,", "kind: ros1, state_dir: elsewhere,"))
    assert invoke("cert", "create", "--bridge", "cell").code == 0
    assert (fleet.parent / "elsewhere" / "bridge.der").exists()


def test_bridges_that_are_not_there(invoke: Invoke, fleet: Path) -> None:
    for arguments in (("create", "--bridge", "hall"), ("trust", "--bridge", "hall", "x.der")):
        ended = invoke("cert", *arguments)
        assert ended.code == 3
        assert ended.stderr == "ua-fleet: fleet.yaml: there is no bridge 'hall'; bridges there: cell\n"
    ended = invoke("cert", "revoke", "--bridge", "cell")
    assert ended.code == 3
    assert "bridge cell is known by no certificate" in ended.stderr
    assert invoke("cert", "create", "--bridge", "cell", "--client", "plc").code == 2
    assert invoke("cert", "create", "--trust").code == 2
    assert invoke("cert", "revoke").code == 2
    assert invoke("cert", "revoke", "--bridge", "cell", "3f2a").code == 2
    assert list(fleet.parent.rglob("*.der")) == []


def test_one_certificate_is_not_that_of_two_bridges(invoke: Invoke, fleet: Path) -> None:
    fleet.write_text(fleet.read_text().replace("robots:", "  hall: {kind: ros2, space: 7, status_id: 2}\nrobots:"))
    made = json.loads(invoke("cert", "create", "--bridge", "cell", "--trust", "--json").stdout)
    ended = invoke("cert", "trust", "--bridge", "hall", made["path"])
    assert ended.code == 2
    assert "bridge cell is known by this certificate; make one for hall with: " in ended.stderr


# --- gateways


def test_a_gateway_is_marked_listed_and_taken_back(invoke: Invoke, fleet: Path) -> None:
    made = json.loads(invoke("cert", "create", "--client", "console", "--json").stdout)
    mark = made["thumbprint"]
    ended = invoke("cert", "trust", "--gateway", "console", made["path"])
    assert (ended.code, ended.stdout[-20:]) == (0, "  (gateway console)\n")
    listed = {info["state"]: info for info in map(json.loads, lines(invoke, "cert", "list", "--json"))}
    assert (listed["gateways"]["gateway"], listed["gateways"]["thumbprint"]) == ("console", mark)
    assert listed["own"]["gateway"] is None
    assert ["gateway", "console", mark] in [line.split()[:3] for line in lines(invoke, "cert", "list")]
    assert invoke("cert", "trust", mark[:10]).code == 0
    states = [json.loads(line)["state"] for line in lines(invoke, "cert", "list", "--json")]
    assert states == ["own", "trusted"], "an ordinary client again"
    assert invoke("cert", "trust", "--gateway", "console", mark[:10]).code == 0
    ended = invoke("cert", "revoke", "--gateway", "console")
    assert (ended.code, ended.stdout.split()[:2], ended.stderr) == (0, ["revoked", mark], "")
    states = [json.loads(line)["state"] for line in lines(invoke, "cert", "list", "--json")]
    assert states == ["own", "rejected"]
    ended = invoke("cert", "revoke", "--gateway", "console")
    assert ended.code == 3
    assert "there is no gateway console" in ended.stderr


def test_the_last_refused_becomes_a_gateway_once_it_is_shown(invoke: Invoke, fleet: Path) -> None:
    made = json.loads(invoke("cert", "create", "--client", "console", "--json").stdout)
    rejected = fleet.parent / "state" / "certificates" / "rejected"
    rejected.mkdir()
    RejectedCertificates(rejected).keep(certificates.load_certificate(Path(made["path"])), "10.0.0.7")
    arguments = ("cert", "trust", "--gateway", "console", "--last", "--show")
    assert invoke(*arguments, stdin="n\n").code == 1
    ended = invoke(*arguments, stdin="y\n")
    assert (ended.code, ended.stdout[-20:]) == (0, "  (gateway console)\n")
    states = [json.loads(line)["state"] for line in lines(invoke, "cert", "list", "--json")]
    assert states == ["own", "gateways"]


def test_gateways_that_cannot_be(invoke: Invoke, fleet: Path) -> None:
    made = json.loads(invoke("cert", "create", "--client", "console", "--json").stdout)
    assert invoke("cert", "trust", "--gateway", "con sole", made["path"]).code == 2
    assert invoke("cert", "trust", "--gateway", "console", "--bridge", "cell", made["path"]).code == 2
    assert invoke("cert", "trust", "--gateway", "console").code == 2
    assert invoke("cert", "trust", "--gateway", "console", "no/such/file.der").code == 3
    assert invoke("cert", "revoke", "--gateway", "console", "3f2a").code == 2


def test_a_client_is_trusted_no_longer(invoke: Invoke, fleet: Path) -> None:
    made = json.loads(invoke("cert", "create", "--client", "plc7", "--json").stdout)
    invoke("cert", "trust", made["path"])
    ended = invoke("cert", "revoke", made["thumbprint"][:8], "--json")
    assert json.loads(ended.stdout)["state"] == "rejected"
    ended = invoke("cert", "revoke", made["thumbprint"][:8])
    assert ended.code == 3
    assert ended.stderr.endswith("list them with: ua-fleet cert list\n")
    ended = invoke("cert", "revoke", made["path"])
    assert ended.code == 3
    assert "is not trusted" in ended.stderr


def renewed(invoke: Invoke, *arguments: str) -> tuple[str, str]:
    """The new thumbprint, and what was said."""
    ended = invoke("cert", "create", *arguments, "--renew")
    assert ended.code == 0, ended.stderr
    return ended.stdout.split()[1], ended.stderr


def test_renewing(invoke: Invoke, fleet: Path) -> None:
    own = fleet.parent / "state" / "certificates" / "own"
    cell = fleet.parent / "state" / "bridges" / "cell"
    invoke("cert", "create", "--bridge", "cell", "--trust")
    keys = [(own / "server-key.pem").read_bytes(), (cell / "bridge-key.pem").read_bytes()]
    server, said = renewed(invoke)
    assert "restart the server" in said
    assert "these bridges trust the new one: cell" in said
    assert (cell / "server.der").read_bytes() == (own / "server.der").read_bytes()
    bridge, _ = renewed(invoke, "--bridge", "cell", "--trust")
    assert [(own / "server-key.pem").read_bytes(), (cell / "bridge-key.pem").read_bytes()] == keys
    listed = [json.loads(line) for line in invoke("cert", "list", "--json").stdout.splitlines()]
    assert {(one["state"], one["thumbprint"]) for one in listed} == {("own", server), ("bridges", bridge)}
    assert {one["days_left"] in (1824, 1825) for one in listed} == {True}
    other, said = renewed(invoke, "--bridge", "cell")
    assert other != bridge
    assert "on the server run: ua-fleet cert trust --bridge cell" in said


def test_the_server_does_not_start_with_a_certificate_that_has_ended(invoke: Invoke, fleet: Path) -> None:
    invoke("cert", "create")
    own = fleet.parent / "state" / "certificates" / "own"
    files = CertificateFiles(own / "server.der", own / "server-key.pem")
    create_certificate(files, application_uri="urn:ua-fleet:Fleet:server", common_name="x", days=-0.01, server=True)
    listed = invoke("cert", "list").stdout.splitlines()[1].split()
    assert listed[3] == "expired"
    command = [sys.executable, "-m", "ua_fleet.cli", "serve", "--config", str(fleet)]
    ended = run(*command)
    assert ended.returncode == 1
    assert "server.der: expired on 20" in ended.stderr
    assert ended.stderr.endswith(f"; run: ua-fleet cert create --renew -c {fleet}\n")


def test_a_command_that_is_printed_is_about_the_same_fleet(invoke: Invoke, tmp_path: Path) -> None:
    (tmp_path / "hall 2.yaml").write_text(FLEET)
    assert invoke("cert", "create", "-c", "hall 2.yaml").code == 0
    [own] = certificates.list_certificates(tmp_path / "state")
    assert own.renewal == "ua-fleet cert create --renew -c 'hall 2.yaml', then restart the server"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["user", "list"], "ua-fleet user add NAME --role operator"),
        (["user", "remove", "anna"], "ua-fleet user list"),
        (["cert", "trust"], "ua-fleet cert list"),
        (["cert", "revoke"], "ua-fleet cert list"),
        (["cert", "revoke", "--bridge", "floor"], "ua-fleet cert list"),
        (["cert", "create", "--bridge", "cell"], "ua-fleet cert trust --bridge cell {state}/bridges/cell/bridge.der"),
    ],
)
def test_a_printed_command_names_the_file_that_the_command_was_given(
    invoke: Invoke, fleet: Path, words: list[str], told: str
) -> None:
    file = fleet.with_name("hall2.yaml")
    file.write_text(fleet.read_text())
    ended = invoke(*words, "-c", str(file))
    assert f": {told.format(state=fleet.parent / 'state')} -c {file}\n" in ended.stderr


@pytest.mark.parametrize("options", [(), ("--trust",), ("--renew",), ("--trust", "--renew")])
def test_two_bridges_with_one_folder_do_not_share_a_certificate(
    invoke: Invoke, tmp_path: Path, options: tuple[str, ...]
) -> None:
    """The second one got that of the first, and renewed with --trust, the server knew the first no more."""
    (tmp_path / "fleet.yaml").write_text(
        "version: 1\npubsub: {security: sign_and_encrypt}\nbridges:\n"
        "  cell: {kind: ros1, status_id: 1, state_dir: shared}\n"
        "  floor: {kind: ros2, space: 7, status_id: 2, state_dir: shared}\n"
    )
    assert invoke("cert", "create", "--bridge", "cell", "--trust").code == 0
    folders = (tmp_path / "shared", tmp_path / "state" / "certificates")
    before = {path: path.read_bytes() for folder in folders for path in folder.rglob("*.der")}
    ended = invoke("cert", "create", "--bridge", "floor", *options)
    assert (ended.code, ended.stdout) == (2, "")
    assert f"{tmp_path}/shared/bridge.der: is the certificate of cell" in ended.stderr
    assert ended.stderr.endswith("; give floor a state_dir of its own in fleet.yaml\n")
    assert {path: path.read_bytes() for folder in folders for path in folder.rglob("*.der")} == before
    assert invoke("cert", "create", "--bridge", "cell", "--trust", "--renew").code == 0


def test_a_bridge_that_was_renamed_keeps_its_certificate(invoke: Invoke, fleet: Path) -> None:
    assert invoke("cert", "create", "--bridge", "cell", "--trust").code == 0
    text = fleet.read_text().replace("cell: {", "hall: {state_dir: state/bridges/cell, ")
    fleet.write_text(text.replace("bridge: cell", "bridge: hall"))
    assert invoke("cert", "create", "--bridge", "hall").code == 0
