"""A robot on a TCP socket, written from docs/tcp.md: `tcp_press.py PORT FAULT_FILE`.

It remembers every number, so that it can say `never`. What stands in the file is its fault. Prints `begun JOB`, `done
JOB`, `refused JOB`.
"""

import socket
import sys
import threading
import time
from pathlib import Path

from tests.saying import say

port, fault_file = int(sys.argv[1]), Path(sys.argv[2])
lock = threading.Lock()
states: dict[str, tuple[object, ...]] = {}
bridge: socket.socket | None = None


def send(*fields: object) -> None:
    with lock:
        if bridge is not None:
            try:
                bridge.sendall("".join(f"{field}\n" for field in fields).encode())
            except OSError:
                return


def tell(number: str) -> None:
    state, *data = states.get(number, ("never",))
    send("status", state, number, len(data), *data)


def work(number: str, job: int) -> None:
    time.sleep(job % 100 / 10)
    say(f"done {job}")
    states[number] = ("done",)
    tell(number)


def begin(number: str, job: int) -> None:
    if number not in states and job < 0:
        say(f"refused {job}")
        states[number] = ("refused", "the press has no such part")
    elif number not in states:
        say(f"begun {job}")
        states[number] = ("running", 0)
        threading.Thread(target=work, args=(number, job), daemon=True).start()
    tell(number)


def fault() -> str:
    return fault_file.read_text() if fault_file.exists() else ""


def announce() -> None:
    said = ""
    while True:
        if fault() != said:
            said = fault()
            send("information", "fault", 0, 1, said)
        time.sleep(0.05)


threading.Thread(target=announce, daemon=True).start()
with socket.create_server(("127.0.0.1", port)) as listener:
    say("ready")
    while True:
        connection, _ = listener.accept()
        with lock:
            bridge = connection
        send("information", "fault", 0, 1, fault())
        with connection, connection.makefile(encoding="utf-8", newline="\n") as lines:
            try:
                while kind := lines.readline().rstrip("\n"):
                    _, number, size = (lines.readline().rstrip("\n") for _ in range(3))
                    data = [lines.readline().rstrip("\n") for _ in range(int(size))]
                    if kind == "command":
                        begin(number, int(data[0]))
                    elif kind == "query":
                        tell(number)
            except (OSError, ValueError):
                continue
