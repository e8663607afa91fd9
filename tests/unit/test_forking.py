"""Processes that the tests fork off are as those that they start."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests import forking
from tests.system import ROS1_PYTHON, Processes, clean_environment, cli, run
from ua_fleet import __version__

PROGRAM = """
import os, sys, time
print("hello", __name__, sys.argv[1:], os.environ.get("OF_THE_TEST"), sorted(os.listdir("/proc/self/fd")), flush=True)
print("to stderr", os.getpgid(0) == os.getpid(), file=sys.stderr)
if sys.argv[1:] == ["waits"]:
    time.sleep(60)
while sys.argv[1:] == ["computes"] and time.process_time() < 0.3:
    pass
raise SystemExit(3 if sys.argv[1:] == ["fails"] else None)
"""

SERVERS = """
import asyncio
from asyncua.server.internal_server import InternalServer
from asyncua.ua import NodeId
async def main():
    changed = NodeId("changed", 9)
    for which in ("first", "second"):
        server = InternalServer()
        await server.load_standard_address_space()
        nodes = server.aspace._nodes
        print(which, len(nodes), sum(len(node.references) for node in nodes.values()), changed in nodes, flush=True)
        nodes[changed] = next(iter(nodes.values()))
asyncio.run(main())
"""


PARENT = """
import asyncio, os, signal, subprocess, sys
from ua_fleet.bridge.children import end_child, start_child
async def main():
    one = await start_child([sys.executable, "program.py", "one"], dict(os.environ, OF_THE_TEST="yes"))
    print((await one.stdout.readline()).decode().strip(), (await one.stdout.readline()).decode().strip(), flush=True)
    print("ended", await one.wait(), flush=True)
    two = await start_child([sys.executable, "program.py", "waits"], dict(os.environ))
    print((await two.stdout.readline()).decode()[:5], os.getsid(two.pid) == two.pid, flush=True)
    print(open(f"/proc/{two.pid}/stat").read().split()[3] == str(os.getpid()), flush=True)
    await end_child(two)
    print("ended", two.returncode, flush=True)
    three = await start_child([sys.executable, "program.py", "waits"], dict(os.environ))
    print("third", three.pid, flush=True)
    await three.wait()
done = subprocess.run([sys.executable, "-u", "program.py", "fails"], stdout=subprocess.PIPE, text=True)
print("run", done.returncode, done.stdout.split()[0], flush=True)
done = subprocess.run([sys.executable, "imported.py"], capture_output=True, text=True)
print("imported", done.stdout.strip(), flush=True)
asyncio.run(main())
"""

BESIDE = """
import asyncio, os, sys
from ua_fleet.bridge.children import end_child, start_child
async def main():
    for words in (["imported.py"], ["program.py", "fails"], ["program.py", "computes"]):
        one = await start_child([sys.argv[2], *words], dict(os.environ))
        said = await one.stdout.read()
        print(words[-1], await one.wait(), said.split()[0].decode(), flush=True)
    two = await start_child([sys.argv[2], "program.py", "waits"], dict(os.environ))
    print((await two.stdout.readline()).decode()[:5], os.getsid(two.pid) == two.pid, two.returncode, flush=True)
    await end_child(two)
    print("ended", two.returncode, flush=True)
    if "stays" in sys.argv:
        three = await start_child([sys.argv[2], "program.py", "waits"], dict(os.environ))
        print("third", three.pid, flush=True)
        await three.wait()
asyncio.run(main())
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    path = tmp_path / "program.py"
    path.write_text(PROGRAM)
    return path


def test_it_runs_the_program_with_its_arguments_and_environment(program: Path, processes: Processes) -> None:
    child = processes.fork(program, "one", "two", env=clean_environment(OF_THE_TEST="yes"))
    assert child.process.wait(60) == 0
    child.end()
    assert child.lines[0].startswith("hello __main__ ['one', 'two'] yes ['0', '1', '2'")
    assert child.lines[1:] == ["to stderr True"]
    assert processes.fork(program, "fails").process.wait(60) == 3
    assert "None" in processes.fork(program).wait_for("hello")


def test_it_is_killed_and_its_id_belongs_to_it_until_that_is_known(program: Path, processes: Processes) -> None:
    child = processes.fork(program, "waits")
    child.wait_for("hello")
    assert child.process.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        child.process.wait(0.05)
    os.kill(child.process.pid, signal.SIGKILL)
    while Path(f"/proc/{child.process.pid}/stat").read_text().split()[2] != "Z":
        time.sleep(0.01)
    os.killpg(child.process.pid, signal.SIGCONT)  # nobody else
    assert child.end(signal.SIGKILL) == -signal.SIGKILL
    while Path(f"/proc/{child.process.pid}").exists():
        time.sleep(0.01)


def test_the_list_of_processes_shows_it(program: Path, processes: Processes) -> None:
    child = processes.fork(program, "waits")
    child.wait_for("hello")
    shown = Path(f"/proc/{child.process.pid}/cmdline").read_bytes().rstrip(b"\0").split(b"\0")
    assert shown == [os.fsencode(word) for word in (sys.executable, program, "waits")]


def test_a_module_is_run_in_the_folder_of_the_test(
    program: Path, processes: Processes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(program.parent)
    assert (
        processes.start(sys.executable, "-u", "-m", "program", "one")
        .wait_for("hello")
        .startswith("hello __main__ ['one']")
    )
    (program.parent / "apart").mkdir()
    (program.parent / "apart" / "elsewhere.py").write_text("print('it is elsewhere')")
    environment = clean_environment(PYTHONPATH=str(program.parent / "apart"))
    processes.start(sys.executable, "-m", "elsewhere", env=environment).wait_for("it is elsewhere")


def test_a_command_is_told_what_it_reads_and_complains_apart() -> None:
    ended = run(*cli("pubsub", "decode", "-", "--json"), stdin="no datagram")
    assert (ended.returncode, ended.stdout) == (2, "")
    assert "'no datagram' is no hexadecimal" in ended.stderr
    said = run(*cli("--version"))
    assert (said.returncode, said.stdout.split(), said.stderr) == (0, ["ua-fleet", __version__], "")


def test_the_first_server_of_each_has_the_nodes_of_the_standard_and_the_second_makes_them(
    tmp_path: Path, processes: Processes
) -> None:
    program = tmp_path / "servers.py"
    program.write_text(SERVERS)
    for _ in range(2):
        child = processes.fork(program)
        first, second = child.wait_for("first"), child.wait_for("second")
        assert first.split()[1:] == second.split()[1:]
        assert int(first.split()[1]) > 5000


def write_parent(program: Path, text: str, module: str) -> Path:
    """The folder of a program that starts others beside it, one of which says whether it has imported a module."""
    (program.parent / "parent.py").write_text(text)
    (program.parent / "imported.py").write_text(f"import sys; print({module!r} in sys.modules)")
    return program.parent


def test_children_of_a_demonstration_are_its_own_and_have_imported_what_they_need(
    program: Path, processes: Processes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(write_parent(program, PARENT, "ua_fleet.server.app"))
    child = processes.start(sys.executable, "-m", "parent", "demo")
    last = int(child.wait_for("third").split()[1])
    assert child.lines[:-1] == [
        "to stderr False",  # which is its parent's, as its group is
        "run 3 hello",
        "imported True",
        "hello __main__ ['one'] yes ['0', '1', '2', '3'] to stderr True",
        "ended 0",
        "hello True",
        "True",
        "ended -15",
    ]
    child.end(signal.SIGKILL)
    while Path(f"/proc/{last}").exists():  # it ends with its parent
        time.sleep(0.01)


@pytest.mark.needs("ros1")
def test_children_in_the_other_python_are_forked_too(
    program: Path, processes: Processes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(write_parent(program, BESIDE, "rospy"))
    told = ["imported.py 0 True", "fails 3 hello", "computes 0 hello", "hello True None", "ended -15"]
    before = forking.computed_s()
    child = processes.start(sys.executable, "-m", "parent", "demo", ROS1_PYTHON)
    assert child.process.wait(60) == 0
    child.end()
    assert child.lines == told
    assert 0.25 < forking.computed_s() - before < 3, "what they have computed counts, in hundredths"

    child = processes.start(sys.executable, "-m", "parent", "demo", ROS1_PYTHON, "stays")
    last = int(child.wait_for("third").split()[1])
    child.end(signal.SIGKILL)
    while Path(f"/proc/{last}").exists():  # it ends with its parent
        time.sleep(0.01)
