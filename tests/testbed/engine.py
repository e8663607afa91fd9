"""Docker and Compose as programs: no library, so that both kinds of Compose can be tried as users have them."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

__all__ = ["ROOT", "CommandFailed", "Compose", "Container", "docker", "run"]

ROOT: Final = Path(__file__).resolve().parents[2]
_PATIENCE_S: Final = 120.0
_LABEL: Final = "com.docker.compose"


class CommandFailed(Exception):
    """A program ended with an error; the text has its last lines."""


def run(
    *command: str,
    environment: Mapping[str, str] | None = None,
    timeout_s: float = _PATIENCE_S,
    text_in: str | None = None,
) -> str:
    """Run a program to its end; what it writes to stdout.

    Raises:
        CommandFailed: its exit code is not 0, or it does not end in time.
    """
    try:
        done = subprocess.run(
            command,
            cwd=ROOT,
            env=dict(environment) if environment is not None else None,
            input=text_in,
            stdin=subprocess.DEVNULL if text_in is None else None,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise CommandFailed(f"{_shown(command)}: no end within {timeout_s:g} s") from error
    if done.returncode != 0:
        said = "\n".join((done.stdout + done.stderr).strip().splitlines()[-12:])
        raise CommandFailed(f"{_shown(command)}: exit code {done.returncode}\n{said}")
    return done.stdout


def _shown(command: Sequence[str]) -> str:
    return " ".join(word if len(word) < 60 else f"{word[:57]}..." for word in command)


def docker(*arguments: str, timeout_s: float = _PATIENCE_S, text_in: str | None = None) -> str:
    """Run `docker`; what it writes to stdout. Raises CommandFailed."""
    return run("docker", *arguments, timeout_s=timeout_s, text_in=text_in)


@dataclass(frozen=True, slots=True)
class Container:
    """A container of a service."""

    id: str
    service: str

    def inspect(self) -> dict[str, Any]:
        """All that the engine knows of it."""
        (found,) = json.loads(docker("inspect", self.id))
        return dict(found)

    def execute(self, *command: str, user: str = "", timeout_s: float = 30.0, text_in: str | None = None) -> str:
        """Run a program inside; what it writes to stdout. Raises CommandFailed."""
        options = [*(["--user", user] if user else []), *(["-i"] if text_in is not None else [])]
        return docker("exec", *options, self.id, *command, timeout_s=timeout_s, text_in=text_in)

    def python(self, program: str, *arguments: str, timeout_s: float = 30.0) -> str:
        """Run a program of Python inside, without our packages; what it writes to stdout. Raises CommandFailed."""
        return self.execute("python3", "-c", program, *arguments, timeout_s=timeout_s)

    def logs(self, *, timestamps: bool = False) -> str:
        """All that it has written."""
        done = subprocess.run(
            ("docker", "logs", *(["--timestamps"] if timestamps else []), self.id),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            check=False,
        )
        return done.stdout


@dataclass(frozen=True, slots=True)
class Compose:
    """A project of `compose.yaml` with a profile."""

    command: tuple[str, ...]
    """`docker compose` or `docker-compose`."""
    project: str
    profile: str
    options: Mapping[str, str] = field(default_factory=dict[str, str])
    """Variables of `compose.yaml`."""

    def __call__(self, *arguments: str, timeout_s: float = 600.0) -> str:
        """Run it as a user does; what it writes to stdout. Raises CommandFailed."""
        return run(
            *self.command,
            *("--project-name", self.project),
            *arguments,
            # Neither a .env of the user's nor what stands in the shell is to change what is measured.
            environment={**_without_options(os.environ), **self.options, "COMPOSE_PROFILES": self.profile},
            timeout_s=timeout_s,
        )

    def containers(self) -> dict[str, Container]:
        """All containers by their services, also those that have ended."""
        label = f"{_LABEL}.service"
        lines = docker(
            *("ps", "--all", "--no-trunc", "--filter", f"label={_LABEL}.project={self.project}"),
            *("--format", f'{{{{.ID}}}} {{{{.Label "{label}"}}}}'),
        )
        found = (line.split() for line in lines.splitlines())
        return {service: Container(id_, service) for id_, service in found}

    def container(self, service: str) -> Container:
        """The container of a service; raises CommandFailed where there is none."""
        try:
            return self.containers()[service]
        except KeyError:
            raise CommandFailed(f"there is no container of {service} in {self.project}") from None

    def down(self) -> None:
        """Remove its containers, networks and volumes."""
        self("down", "--volumes", "--remove-orphans", "--timeout", "5")

    def keep_logs(self, folder: Path) -> None:
        """Write what each container has said into files of a folder, which is made."""
        folder.mkdir(parents=True, exist_ok=True)
        for service, container in self.containers().items():
            (folder / f"{service}.log").write_text(container.logs(), encoding="utf-8")


def _without_options(environment: Mapping[str, str]) -> dict[str, str]:
    return {name: value for name, value in environment.items() if not name.startswith(("UA_FLEET_", "COMPOSE"))}
