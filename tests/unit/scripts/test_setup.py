"""`scripts/setup` with a pip that cannot have everything, and what CI requires."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests import system, terminal

_PIP = """#!/bin/sh
echo "$*" >>asked
meet() {  # only where both are done side by side
  : >"met-$1"
  tries=0
  until [ -e "met-$2" ]; do
    [ $((tries += 1)) -lt 300 ] || { echo "setup: $1 is done without $2" >&2; exit 1; }
    sleep 0.1
  done
}
case "$*" in
  *sys.version_info*) exit ${NEW_PYTHON:-0} ;;
  *pip.__version__*) exit ${OLD_PIP:-0} ;;
  scripts/web.py) [ "$MEET" != page ] || meet page wheels; exit ${WEB:-0} ;;
  "scripts/wanted "*) echo "$*" ;;
  *--requirement*)
    for wanted; do :; done
    wanted=$(cat "$wanted")
    echo "installs $wanted" >>asked
    case "$MEET $wanted" in
      "page "*" ros2") meet wheels page ;;
      "ros1 "*+web) meet main ros1 ;;
      "ros1 "*+ros1-tests) meet ros1 main ;;
    esac
    case "$wanted" in *" $NOT_THERE") exit 1 ;; esac ;;
esac
"""
"""The Python of a virtual environment in which pip installs at once what it can have."""


class Checkout:
    """A folder with what `scripts/setup` reads, and an environment that costs nothing."""

    def __init__(self, folder: Path) -> None:
        (folder / "scripts").mkdir(parents=True)
        made_from = hashlib.sha256()
        for name in ("pyproject.toml", "requirements.lock", "scripts/setup", "scripts/wanted"):
            shutil.copy(system.ROOT / name, folder / name)
            made_from.update((folder / name).read_bytes())
        # ROS 1 is done: it would take packages of the system.
        self._write(folder / ".venv-ros1" / ".stamp-run", made_from.hexdigest())
        for environment in (".venv", ".venv-ros1"):
            self._write(folder / environment / "bin" / "python", _PIP)
        self._write(folder / "bin" / "uname", '#!/bin/sh\necho "$MACHINE"\n')
        self._folder = folder

    @staticmethod
    def _write(path: Path, text: str) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        path.chmod(0o755)

    def want_ros1(self) -> None:
        """Have ROS 1 to do, with the packages of the system that there are."""
        (self._folder / ".venv-ros1" / ".stamp-run").unlink()
        self._write(self._folder / "bin" / "dpkg-query", "#!/bin/sh\necho ok installed\n")

    def run(self, machine: str, not_there: str, **others: str) -> subprocess.CompletedProcess[str]:
        """Set up."""
        (self._folder / "asked").unlink(missing_ok=True)
        path = f"{self._folder / 'bin'}{os.pathsep}{os.environ['PATH']}"
        return subprocess.run(
            ["scripts/setup"],
            cwd=self._folder,
            env=system.clean_environment(PATH=path, MACHINE=machine, NOT_THERE=not_there, **others),
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )

    def set_up(self, machine: str, not_there: str, **others: str) -> tuple[list[str], str]:
        """The extras of `.venv` that pip was asked for, and what was said."""
        done = self.run(machine, not_there, **others)
        assert done.returncode == 0, done.stderr
        asked = self._folder / "asked"
        lines = asked.read_text(encoding="utf-8").splitlines() if asked.exists() else []
        return [
            extra for extra in ("ros2", "ur") if f"installs scripts/wanted pyproject.toml {extra}" in lines
        ], done.stderr


@pytest.fixture
def checkout(tmp_path: Path) -> Checkout:
    return Checkout(tmp_path / "checkout")


@pytest.mark.parametrize("extra", ["ros2", "ur"])
def test_what_a_broken_network_left_out_is_tried_again(checkout: Checkout, extra: str) -> None:
    asked, said = checkout.set_up("x86_64", extra)
    assert asked == ["ros2", "ur"]
    assert f"pip could not install the extra {extra}: " in said
    assert checkout.set_up("x86_64", "none")[0] == ["ros2", "ur"]
    assert checkout.set_up("x86_64", "none") == ([], "")


@pytest.mark.parametrize(
    ("machine", "extra", "others"),
    [("aarch64", "ros2", {}), ("aarch64", "ur", {}), ("x86_64", "ur", {"NEW_PYTHON": "1"})],
)
def test_what_has_no_wheels_is_said_once(checkout: Checkout, machine: str, extra: str, others: dict[str, str]) -> None:
    assert f"there are no wheels of the extra {extra} for this machine" in checkout.set_up(machine, extra, **others)[1]
    assert checkout.set_up(machine, extra, **others) == ([], "")


def test_each_set_up_builds_the_page_and_does_without_it(checkout: Checkout, tmp_path: Path) -> None:
    """It is the script that knows whether there is anything to do."""
    checkout.set_up("x86_64", "none")
    for _ in range(2):
        assert checkout.set_up("x86_64", "none", WEB="1") == ([], "")
        assert "scripts/web.py" in (tmp_path / "checkout" / "asked").read_text(encoding="utf-8").splitlines()


def test_the_page_is_built_beside_the_wheels_that_it_does_not_need(checkout: Checkout) -> None:
    """Each of them waits until the other one has begun."""
    assert checkout.set_up("x86_64", "none", MEET="page")[0] == ["ros2", "ur"]


@pytest.mark.needs("ros1")
def test_both_environments_are_made_side_by_side(checkout: Checkout) -> None:
    checkout.want_ros1()
    said = checkout.set_up("x86_64", "none", MEET="ros1")[1].splitlines()
    assert sorted(line.partition(" with ")[0] for line in said) == ["setup: making .venv", "setup: making .venv-ros1"]
    assert checkout.set_up("x86_64", "none") == ([], "")


@pytest.mark.needs("ros1")
def test_what_fails_beside_the_rest_ends_the_set_up(checkout: Checkout) -> None:
    """The other parts are done then, and the next set-up goes on from there."""
    checkout.want_ros1()
    assert checkout.run("x86_64", "+ros1-tests").returncode == 1
    asked, said = checkout.set_up("x86_64", "none")
    assert (asked, "making .venv-ros1" in said) == ([], True)


def test_an_environment_whose_making_was_interrupted_is_made_again(checkout: Checkout, tmp_path: Path) -> None:
    """It is there, with the pip that Python brings, which takes no hashes from constraints."""
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\necho "python $*" >>{tmp_path}/made\n', encoding="utf-8")
    python.chmod(0o755)
    checkout.set_up("x86_64", "none", OLD_PIP="1", PYTHON=str(python))
    assert "python -m venv .venv" in (tmp_path / "made").read_text(encoding="utf-8").splitlines()


@pytest.fixture
def late_make(tmp_path: Path) -> Path:
    """A library with which `make` is late."""
    made = tmp_path / "late_make.so"
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", made, Path(__file__).with_name("late_make.c")], check=True)
    return made


@pytest.mark.needs("compiler")
def test_ctrl_c_ends_a_set_up_in_silence_on_a_busy_machine(tmp_path: Path, late_make: Path) -> None:
    """`make` told `wait: No child processes` where it came to its signal after its child had gone."""
    ends_in_silence(tmp_path, 0.1, LD_PRELOAD=str(late_make))


@pytest.mark.parametrize("delay_s", [0.1, 1.0])
@pytest.mark.parametrize("goal", ["demo", "setup-test"])
def test_ctrl_c_ends_a_set_up_in_silence(tmp_path: Path, delay_s: float, goal: str) -> None:
    """With a real Python, which would tell a traceback, and `make`, which would tell an error."""
    ends_in_silence(tmp_path, delay_s, goal)
    end = time.monotonic() + 60
    while at_work := [line for line in _command_lines() if str(tmp_path) in line]:
        assert time.monotonic() < end, f"what was done beside goes on: {at_work}"
        time.sleep(0.01)


def _command_lines() -> list[str]:
    found: list[str] = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            found.append(path.read_bytes().replace(b"\0", b" ").decode(errors="replace"))
    return found


def ends_in_silence(tmp_path: Path, delay_s: float, goal: str = "demo", **others: str) -> None:
    (tmp_path / "scripts").mkdir()
    for name in ("Makefile", "pyproject.toml", "requirements.lock", "scripts/setup", "scripts/wanted"):
        shutil.copy(system.ROOT / name, tmp_path / name)
    environment = system.clean_environment(PYTHON=sys.executable, **others)
    command = ("make", goal)
    ended = terminal.typed_after(
        command, "making .venv with", terminal.CTRL_C, folder=tmp_path, environment=environment, delay_s=delay_s
    )
    said = ended.shown.replace("\r", "").splitlines()
    # A shell may say something of its own before, of a locale that is not there for one.
    began = next(at for at, line in enumerate(said) if line.startswith("setup: making .venv with"))
    # The other environment is made beside this one: that may be said on the line of the terminal's own ^C.
    told = "\n".join(said[began + 1 :]).replace("^Csetup: making", "^C\nsetup: making").splitlines()
    told = [line for line in told if line and not line.startswith("setup: making .venv-ros1")]
    assert told == ["^C", "setup: ended by Ctrl-C; the next one goes on from here"]
    assert ended.code == -signal.SIGINT


def test_ci_requires_every_part_that_tests_can_lack() -> None:
    run = (system.ROOT / ".ci" / "run").read_text(encoding="utf-8")
    required = run.partition("require=")[2].split()[0]
    by_hand = {"o6"}  # set-up does not install it (UA_FLEET_O6_PYTHON)
    assert set(required.split(",")) == system.PARTS.keys() - by_hand


def test_every_file_that_is_installed_has_its_hash() -> None:
    entries = re.split(r"^(?=\S)", (system.ROOT / "requirements.lock").read_text(encoding="utf-8"), flags=re.MULTILINE)[
        1:
    ]
    assert len(entries) > 100
    assert [entry for entry in entries if not re.search(r"^\S+==\S.*\n    --hash=sha256:[0-9a-f]{64}", entry)] == []
    for script in ("scripts/setup", "scripts/image/add", "Dockerfile"):
        text = (system.ROOT / script).read_text(encoding="utf-8").replace("\\\n", " ")
        installs = [line for line in text.splitlines() if re.search(r"pip\S* .*\binstall --", line)]
        assert installs, script
        for line in installs:
            assert "--require-hashes" in line or "--no-deps" in line, f"{script}: {line}"


@pytest.mark.parametrize("names", [[], ["client", "+build"], ["server", "modbus", "+dev", "+docs"]])
def test_what_is_wanted_is_locked(names: list[str]) -> None:
    wanted = subprocess.run(
        [sys.executable, "scripts/wanted", "pyproject.toml", *names],
        cwd=system.ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split("\n")[:-1]
    locked = re.findall(r"^([\w.-]+)==", (system.ROOT / "requirements.lock").read_text(encoding="utf-8"), re.MULTILINE)
    assert {re.split(r"[\[<>=~]", line)[0] for line in wanted} <= set(locked)
