"""Completion, by the shells themselves where they are installed."""

from __future__ import annotations

import shutil
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import pytest

from tests.system import clean_environment, run
from ua_fleet.cli.context_file import ContextFile, LoginContext

BASH = """
eval "${{SCRIPT:-$(ua-fleet completion bash)}}"
complete_words() {{ COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _ua_fleet_completion ua-fleet; }}
complete_words {words}
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
FISH = "ua-fleet completion fish | source; complete -C '{words}'"


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Of a user who has logged in as two."""
    file = ContextFile(tmp_path / "home" / "ua-fleet" / "client")
    for name in ("hall", "hangar"):
        until = datetime(2030, 1, 31, tzinfo=UTC)
        context = LoginContext(
            name, "opc.tcp://hall:4840/ua_fleet", "anna", "", "Basic256Sha256", False, "1f", until, "key"
        )
        file.put(context, "key")
    return clean_environment(
        PATH=f"{Path(sys.executable).parent}:/usr/bin:/bin",
        XDG_STATE_HOME=str(tmp_path / "home"),
        HOME=str(tmp_path),
        PYTHON_KEYRING_BACKEND="keyring.backends.null.Keyring",
    )


@pytest.fixture(scope="module")
def bash_script() -> str:
    """What `ua-fleet completion bash` prints, which is the same for all words."""
    program = Path(sys.executable).with_name("ua-fleet")
    ended = run(program, "completion", "bash", env=clean_environment())
    assert (ended.returncode, ended.stderr) == (0, "")
    return ended.stdout


@pytest.mark.parametrize("shell", ["bash", "fish"])
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("ua-fleet logo", ["logout"]),
        ("ua-fleet user re", ["remove"]),
        ("ua-fleet read i=85 --cont", ["--context"]),
        ("ua-fleet read i=85 -c ha", ["hall", "hangar"]),
        ("ua-fleet logout --context hang", ["hangar"]),
        ("ua-fleet contexts --use hal", ["hall"]),
        ("ua-fleet completion z", ["zsh"]),
        ("ua-fleet simu", ["simulate"]),
        ("ua-fleet demo tal", ["talkrobots"]),
    ],
)
def test_a_shell_completes(
    environment: dict[str, str], bash_script: str, shell: str, words: str, expected: list[str]
) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is missing")
    script = {"bash": BASH, "fish": FISH}[shell].format(words=words)
    done = subprocess.run(
        [shell, "-c", script],
        env=environment | {"SCRIPT": bash_script},
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert [line.partition("\t")[0] for line in done.stdout.split("\n") if line.strip()] == expected
    assert done.stderr == ""


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_scripts_of_shells_that_may_not_be_here_ask_for_what_is_answered(
    environment: dict[str, str], shell: str
) -> None:
    program = str(Path(sys.executable).with_name("ua-fleet"))
    script = run(program, "completion", shell, env=environment)
    assert script.returncode == 0
    assert f"_UA_FLEET_COMPLETE=complete_{shell}" in script.stdout
    asked = {
        "_UA_FLEET_COMPLETE": f"complete_{shell}",
        "_TYPER_COMPLETE_ARGS": "ua-fleet read i=85 -c hang",
        "_TYPER_COMPLETE_FISH_ACTION": "get-args",
    }
    answer = run(program, env=environment | asked)
    assert answer.returncode == 0
    assert "hangar" in answer.stdout
    assert "hall" not in answer.stdout


@pytest.mark.skipif(shutil.which("zsh") is None, reason="zsh is missing")
def test_zsh_takes_its_script(environment: dict[str, str]) -> None:
    script = 'autoload -Uz compinit && compinit -u -D; eval "$(ua-fleet completion zsh)"; print ${_comps[ua-fleet]}'
    done = subprocess.run(
        ["zsh", "-f", "-c", script], env=environment, capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout == "_ua_fleet_completion\n"


def test_a_broken_file_of_contexts_breaks_no_completion(environment: dict[str, str]) -> None:
    file = Path(environment["XDG_STATE_HOME"]) / "ua-fleet" / "client" / "contexts.json"
    file.write_text("{}")
    script = BASH.format(words="ua-fleet read i=85 -c ha")
    done = subprocess.run(
        ["bash", "-c", script], env=environment, capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.strip() == ""
    assert done.stderr == ""
