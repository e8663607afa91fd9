"""A PostgreSQL of Debian's that a test starts, kills and ends: with a user's rights, since it refuses root."""

from __future__ import annotations

import atexit
import contextlib
import functools
import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any, Final, Self

from tests import system

__all__ = ["PASSWORD", "USER", "Postgres", "programs"]

USER: Final = "historian"
PASSWORD: Final = "only for tests: päss/word"
_START_S: Final = 60.0
_SETTINGS: Final = (
    "listen_addresses=127.0.0.1",
    "unix_socket_directories=",
    "max_connections=20",
    "shared_buffers=16MB",
)


def programs() -> Path | None:
    """The folder with `initdb` and `postgres` of the newest version that Debian's packages have installed."""
    found = [path.parent for path in Path("/usr/lib/postgresql").glob("*/bin/initdb")]
    return max(found, key=lambda path: int(path.parent.name), default=None)


def _as_user() -> dict[str, Any]:
    """Whose rights its programs have; nothing where they are this process's."""
    if os.geteuid() != 0:
        return {}
    user = pwd.getpwnam("postgres")
    return {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}


def _folder() -> Path:
    """A folder of that user, below the one of temporary files: into pytest's nobody else gets."""
    made = Path(tempfile.mkdtemp(prefix="ua-fleet-postgres-"))
    if as_user := _as_user():
        os.chown(made, as_user["user"], as_user["group"])
    return made


@functools.cache
def _fresh_data() -> Path:
    """What each server begins with: to make it takes most of a second, and to copy it a tenth of that."""
    found, folder, as_user = programs(), _folder(), _as_user()
    assert found is not None
    atexit.register(shutil.rmtree, folder)
    secret = folder / "password"
    secret.write_text(PASSWORD + "\n")
    if as_user:
        os.chown(secret, as_user["user"], as_user["group"])
    made = subprocess.run(
        [
            *(str(found / "initdb"), "-D", folder / "data", "-U", USER, "-A", "scram-sha-256"),
            *("--pwfile", secret, "-E", "UTF8", "--locale", "C.UTF-8", "--no-sync"),
        ],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        **as_user,
    )
    assert made.returncode == 0, made.stdout + made.stderr
    return folder / "data"


class Postgres:
    """A server of its own data, whose process is the child of this one."""

    def __init__(self) -> None:
        found = programs()
        assert found is not None, "tests with a PostgreSQL are marked with needs('postgres')"
        self._programs = found
        self._as_user = _as_user()
        self.folder = _folder()
        self.port = system.free_tcp_port()
        self.process: subprocess.Popen[Any] | None = None
        self._data = self.folder / "data"

    def __enter__(self) -> Self:
        try:
            subprocess.run(["cp", "--archive", "--reflink=auto", _fresh_data(), self._data], check=True)
            self.start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_ended: object) -> None:
        self.kill()
        shutil.rmtree(self.folder)

    def url(self, database: str = "postgres") -> str:
        """The address of a database, as `history.store` has it."""
        return f"postgresql://127.0.0.1:{self.port}/{database}"

    def start(self) -> None:
        """Start it, again where it was killed, and wait until it answers."""
        until = time.monotonic() + _START_S
        while True:
            settings = [part for each in (*_SETTINGS, f"port={self.port}") for part in ("-c", each)]
            with (self.folder / "log").open("ab") as log:
                process: subprocess.Popen[Any] = subprocess.Popen(
                    [self._programs / "postgres", "-D", self._data, *settings],
                    stdout=log,
                    stderr=log,
                    cwd=self.folder,
                    **self._as_user,
                )
            self.process = process
            while process.poll() is None:
                if not subprocess.run(
                    [self._programs / "pg_isready", "-h", "127.0.0.1", "-p", str(self.port), "-t", "1"],
                    capture_output=True,
                    check=False,
                ).returncode:
                    return
                assert time.monotonic() < until, self.log
                time.sleep(0.05)
            # Its children still end, and have its memory until then.
            assert time.monotonic() < until, self.log
            time.sleep(0.2)

    def kill(self) -> None:
        """End it at this moment, as a power cut would; its children notice and end, too."""
        if self.process is not None:
            with contextlib.suppress(ProcessLookupError):
                self.process.send_signal(signal.SIGKILL)
            self.process.wait(30)
            self.process = None

    def pause(self, *, on: bool) -> None:
        """Have all of its processes stand still, or go on."""
        assert self.process is not None
        for pid in (*self._children(self.process.pid), self.process.pid):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGSTOP if on else signal.SIGCONT)

    @property
    def log(self) -> str:
        """What it has said."""
        return (self.folder / "log").read_text(errors="replace")

    def run(self, statement: str, database: str = "postgres") -> str:
        """Do SQL in psql, and give what it prints."""
        done = subprocess.run(
            [self._programs / "psql", "-U", USER, self.url(database), "-XAtqc", statement],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "PGPASSWORD": PASSWORD},
        )
        return done.stdout.strip()

    @contextlib.contextmanager
    def database(self, name: str) -> Generator[str]:
        """A database of its own, and its address."""
        self.run(f"CREATE DATABASE {name}")
        try:
            yield self.url(name)
        finally:
            self.run(f"DROP DATABASE {name} WITH (FORCE)")

    @staticmethod
    def _children(pid: int) -> list[int]:
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
