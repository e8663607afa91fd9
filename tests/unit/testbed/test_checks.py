"""What a machine lacks for the testbed is told in one line, by what Docker's commands say."""

from __future__ import annotations

import socket
import sys
from collections.abc import Mapping, Sequence

import pytest

from tests.testbed import checks
from tests.testbed.checks import Needs, Said, compose_command, engine_problem, overlapping, read_options, routed

ROUTES = """\
Iface\tDestination\tGateway \tFlags\tRefCnt\tUse\tMetric\tMask\t\tMTU\tWindow\tIRTT
eth0\t00000000\t0100000A\t0003\t0\t0\t0\t00000000\t0\t0\t0
tun0\t0055D60A\t00000000\t0001\t0\t0\t0\t00FFFFFF\t0\t0\t0
"""


def said(answers: Mapping[str, Said | None]) -> checks.Ask:
    def ask(command: Sequence[str]) -> Said | None:
        line = " ".join(command)
        return next((answer for start, answer in answers.items() if line.startswith(start)), Said(0, "", ""))

    return ask


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (None, "docker is not installed; as root: apt-get install docker.io"),
        (Said(1, "", "Cannot connect to the Docker daemon at unix:///var/run/docker.sock."), "does not run; as root:"),
        (Said(1, "", "permission denied while trying to connect to the Docker daemon socket"), "may not use"),
        (Said(1, "", "something\nelse"), "does not answer (else)"),
    ],
)
def test_an_engine_that_cannot_be_used(answer: Said | None, words: str) -> None:
    problem = engine_problem(answer)
    assert problem is not None
    assert words in problem
    assert "\n" not in problem
    assert checks.problems(Needs("p"), "", said({"docker version": answer})) == [problem], "nothing else can be asked"


def test_an_engine_that_answers() -> None:
    assert engine_problem(Said(0, "20.10.24", "")) is None


@pytest.mark.parametrize(
    ("plugin", "alone", "command"),
    [
        ("2.26.1-4", "1.29.2", ("docker", "compose")),
        ("v2.0.0", None, ("docker", "compose")),
        (None, "1.29.2", ("docker-compose",)),
        (None, "2.5.0", ("docker-compose",)),
    ],
)
def test_a_compose_that_will_do(plugin: str | None, alone: str | None, command: tuple[str, ...]) -> None:
    answers = {
        "docker compose": Said(0, plugin, "") if plugin else Said(1, "", "'compose' is not a docker command"),
        "docker-compose": Said(0, alone, "") if alone else None,
    }
    assert compose_command("", said(answers)) == (command, None)


@pytest.mark.parametrize(
    ("alone", "words"),
    [("1.25.0", "docker-compose is 1.25.0, and 1.29.2 is needed"), (None, "docker compose is not installed")],
)
def test_a_compose_that_is_old_or_missing(alone: str | None, words: str) -> None:
    answers = {"docker compose": Said(1, "", ""), "docker-compose": Said(0, alone, "") if alone else None}
    _, problem = compose_command("", said(answers))
    assert problem is not None
    assert problem.startswith(words)
    assert "apt-get install docker-compose" in problem


def test_networks_that_share_addresses() -> None:
    others = [
        ("a", "10.214.85.64/26"),
        ("b", "10.214.0.0/16"),
        ("c", "10.215.0.0/16"),
        ("all", "0.0.0.0/0"),
        ("6", "::/1"),
    ]
    assert overlapping("10.214.85", others) == ["a", "b"]
    assert overlapping("10.214.84", [others[0]]) == []


def test_routes_of_the_machine() -> None:
    assert routed(ROUTES) == [("eth0", "0.0.0.0/0.0.0.0"), ("tun0", "10.214.85.0/255.255.255.0")]
    assert overlapping("10.214.85", routed(ROUTES)) == ["tun0"]


def test_a_network_of_another_project_is_named_and_the_own_is_not() -> None:
    shown = "mine_ua mine 10.214.84.0/26 0123456789ab\nother_ua other 10.214.85.0/26 ba9876543210"
    ask = said(
        {
            "docker network ls": Said(0, "1\n2", ""),
            "docker network inspect": Said(0, shown, ""),
            "docker compose": Said(0, "2.26.1", ""),
        }
    )
    assert checks.problems(Needs("mine", "10.214.84", ports=()), "", ask) == []
    (problem,) = checks.problems(Needs("mine", "10.214.85", ports=()), "", ask)
    assert "the Docker network other_ua" in problem
    assert "UA_FLEET_NET" in problem


def test_a_port_in_use_is_told_with_the_option() -> None:
    ask = said({"docker compose": Said(0, "2.26.1", "")})
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = int(taken.getsockname()[1])
        (problem,) = checks.problems(Needs("p", "198.18.99", ports=(("UA_FLEET_PORT", port),)), "", ask)
        assert f"port {port} of 127.0.0.1 is in use" in problem
        assert problem.endswith("set UA_FLEET_PORT")
        held = said({"docker ps": Said(0, f"127.0.0.1:{port}->4840/tcp", ""), "docker compose": Said(0, "2.26.1", "")})
        assert checks.problems(Needs("p", "198.18.99", ports=(("UA_FLEET_PORT", port),)), "", held) == []


def test_a_base_image_that_cannot_be_pulled() -> None:
    ask = said({"docker image inspect": Said(1, "", "No such image"), "docker pull": Said(1, "", "no route to host")})
    problem = checks.base_problem(Needs("p"), ask)
    assert problem is not None
    assert "cannot be pulled (no route to host)" in problem
    assert "scripts/testbed-base" in problem


def test_the_shell_is_heard_before_the_file() -> None:
    file = "# a comment\nUA_FLEET_PORT='4841'\nUA_FLEET_NET=10.1.2\n"
    assert read_options({"UA_FLEET_NET": "10.9.9"}, file) == {"UA_FLEET_PORT": "4841", "UA_FLEET_NET": "10.9.9"}


def test_checks_need_nothing_but_the_standard_library() -> None:
    import ast

    tree = ast.parse(checks.ROOT.joinpath("tests/testbed/checks.py").read_text())
    roots = {
        name.partition(".")[0]
        for node in ast.walk(tree)
        for name in (
            [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else [node.module or ""]
            if isinstance(node, ast.ImportFrom)
            else []
        )
    }
    assert roots <= sys.stdlib_module_names
