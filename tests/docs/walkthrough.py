"""Pages that are run: what their blocks say is done in a fresh folder, in order, as a reader would do it.

A comment before a block, which no reader sees, says what the block is:

    <!-- file: NAME -->                    the reader writes it as this file
    <!-- append: NAME -->                  the reader adds it to the end of this file
    <!-- run -->                           commands, all of which succeed
    <!-- look -->                          a command that may be given again until it shows what follows
    <!-- fails: CODE -->                   a command that ends with this exit code
    <!-- types password -->                a command that asks for a password, on a terminal
    <!-- types yes -->                     a command that asks whether it is meant, on a terminal
    <!-- terminal: NAME -->                a program that goes on in a terminal of its own
    <!-- terminal: NAME, until: TEXT -->   the same; the reader waits until it says this
    <!-- watch -->                         a command that is ended by Ctrl-C once it has shown what follows
    <!-- watch, ends: NAME -->             the same; once it has shown the first line, that terminal is ended
    <!-- shows -->                         lines that the command before shows, in this order; … stands for anything
    <!-- shows: NAME -->                   lines that this terminal shows
    <!-- tested: FILE -->                  commands that this other test runs
    <!-- not run: REASON -->               what no test can do

`<!-- ends: NAME, NAME -->` before no block ends terminals by Ctrl-C, and `<!-- browser: NAME -->` is what the test of
the page does by this name in a browser, as the text before it says.
"""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from tests import system
from tests.forking import ForkedProcess

PASSWORD: Final = "white-rabbit-4"
PATIENCE_S: Final = 60.0

_STEP = re.compile(
    r"^<!-- (?P<mark>[^\n]*?) -->\n+(?:```(?P<language>\w*)\n(?P<text>.*?)^```$)?", re.MULTILINE | re.DOTALL
)
_FENCE = re.compile(r"^```\w*\n.*?^```$", re.MULTILINE | re.DOTALL)
KINDS: Final = frozenset(
    {
        "file",
        "append",
        "run",
        "look",
        "fails",
        "types password",
        "types yes",
        "terminal",
        "watch",
        "shows",
        "tested",
        "not run",
    }
    | {"ends", "browser"}
)


class Step(NamedTuple):
    """A block of a page, or only what its comment says."""

    place: str
    kind: str
    detail: str
    options: Mapping[str, str]
    text: str


def steps(page: Path) -> Iterator[Step]:
    """What a reader of the page does, in order."""
    content = page.read_text(encoding="utf-8")
    for match in _STEP.finditer(content):
        first, *others = match["mark"].split(", ") if not match["mark"].startswith("ends") else [match["mark"]]
        kind, _, detail = first.partition(": ")
        if kind == "not run":
            detail, others = match["mark"], []
        options = dict(other.split(": ", 1) for other in others)
        line = content.count("\n", 0, match.start()) + 1
        yield Step(f"{page.name}:{line}", kind, detail, options, match["text"] or "")


def blocks_without_mark(page: Path) -> list[str]:
    """Blocks of which no comment says what they are."""
    content = page.read_text(encoding="utf-8")
    marked = {match.end() for match in _STEP.finditer(content)}
    return [match[0] for match in _FENCE.finditer(content) if match.end() not in marked]


def missing_line(expected: str, output: str) -> str | None:
    """The first expected line that the output does not have after the ones before it."""
    lines = iter(output.splitlines())
    for wanted in expected.splitlines():
        pattern = ".*".join(re.escape(part) for part in wanted.split("…"))
        if not any(re.fullmatch(pattern, line.rstrip()) for line in lines):
            return wanted
    return None


class PlainCommand(NamedTuple):
    """A program with its arguments, in a line that means the same without a shell."""

    environment: dict[str, str]
    """What is set before it."""
    words: list[str | Path]


_PYTHON: Final = Path(sys.executable)
_PROGRAMS: Final[Mapping[str, str | Path]] = {
    "ua-fleet": _PYTHON.with_name("ua-fleet"),
    "python": _PYTHON,
    "sed": "sed",
}


def plain_commands(text: str) -> list[PlainCommand] | None:
    """The commands of a block, where a shell would only start them: those in Python are forked, which saves a second.

    None where a line has what a shell looks at, or another program.
    """
    if re.search(r"[|&;<>$`\\*?(){}~!\[\]]", text):
        return None
    commands: list[PlainCommand] = []
    for line in text.splitlines():
        words = shlex.split(line, comments=True)
        environment: dict[str, str] = {}
        while words and re.match(r"\w+=", words[0]):
            name, _, value = words.pop(0).partition("=")
            environment[name] = value
        if words and words[0] not in _PROGRAMS:
            return None
        if words:
            commands.append(PlainCommand(environment, [_PROGRAMS[words[0]], *words[1:]]))
    return commands or None


class Walk:
    """A reader with a folder and some terminals."""

    def __init__(
        self,
        folder: Path,
        processes: system.Processes,
        environment: Mapping[str, str],
        instead: Mapping[str, str],
        browser: Mapping[str, Callable[[], None]] | None = None,
    ) -> None:
        """Begin.

        Args:
            folder: where the reader works.
            processes: end the terminals in the end.
            environment: of all commands, beside the usual.
            instead: what stands in the pages, such as a port, and what is free here.
            browser: what the reader does in a browser, by the names in the page; each fails where it cannot.
        """
        self.folder = folder
        self._processes = processes
        self._environment = system.clean_environment(**environment)
        self._instead = instead
        self._browser = browser or {}
        self._terminals: dict[str, system.Child] = {}
        self._shown = ""
        """By the last command that has ended."""

    def walk(self, page: Path) -> str:
        """Do all that the page says, and fail where something else happens; what its last command has shown."""
        todo = list(steps(page))
        text = "".join(step.text for step in todo)
        for done in self._browser:
            assert any((step.kind, step.detail) == ("browser", done) for step in todo), (
                f"{page.name} has no {done!r} now"
            )
        for known in self._instead:
            assert known in text, f"{page.name} has no {known!r} any more"
        while todo:
            step = todo.pop(0)
            shown = ""
            if (
                step.kind in ("run", "look", "fails", "watch", "types yes")
                and todo
                and (todo[0].kind, todo[0].detail) == ("shows", "")
            ):
                shown = todo.pop(0).text
            self._do(step, self._here(step.text), self._here(shown))
        return self._shown

    def _here(self, text: str) -> str:
        for known, own in self._instead.items():
            text = text.replace(known, own)
        return text

    def _do(self, step: Step, text: str, shown: str) -> None:
        match step.kind:
            case "file" | "append":
                file = self.folder / step.detail
                file.parent.mkdir(parents=True, exist_ok=True)
                with file.open("w" if step.kind == "file" else "a", encoding="utf-8") as opened:
                    opened.write(text)
            case "run" | "fails":
                self._run(step, text, shown, int(step.detail or 0))
            case "look":
                self._look(step, text, shown)
            case "types password":
                self._type(step, text, PASSWORD, ": ")
            case "types yes":
                said = self._type(step, text, "y", "[y/N]: ")
                missing = missing_line(shown, said)
                assert missing is None, f"{step.place}: nowhere {missing!r} in\n{said}"
            case "terminal":
                self._open(step, text)
            case "watch":
                self._watch(step, text, shown)
            case "shows":
                for line in text.splitlines():
                    self._terminals[step.detail].wait_for(line, PATIENCE_S)
            case "ends":
                for name in step.detail.split(", "):
                    self._terminals[name].end(signal.SIGINT)
            case "browser":
                assert step.detail in self._browser, f"{step.place}: no test does {step.detail!r} in a browser"
                self._browser[step.detail]()
            case "tested" | "not run":
                pass
            case _:
                raise AssertionError(f"{step.place}: nobody knows what {step.kind!r} is")

    def _bash(self, text: str) -> Sequence[str]:
        return ("bash", "-euo", "pipefail", "-c", f'cd "{self.folder}"\n{text}')

    def _output_of(self, text: str) -> tuple[int, str]:
        if (commands := plain_commands(text)) is not None:
            return self._output_of_plain(commands)
        done = subprocess.run(
            self._bash(text),
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=2 * PATIENCE_S,
            check=False,
        )
        return done.returncode, done.stdout

    def _output_of_plain(self, commands: Sequence[PlainCommand]) -> tuple[int, str]:
        """One after the other, until one fails."""
        code, output = 0, ""
        for command in commands:
            child = system.Child(command.words, self._environment | command.environment, folder=self.folder)
            try:
                code = child.process.wait(2 * PATIENCE_S)
            finally:
                child.end()
            output += "".join(f"{line}\n" for line in child.lines)
            if code:
                break
        return code, output

    def _start(self, text: str) -> system.Child:
        commands = plain_commands(text) or ()
        if len(commands) == 1:
            (only,) = commands
            return self._processes.start(*only.words, env=self._environment | only.environment, folder=self.folder)
        return self._processes.start(*self._bash(text), env=self._environment)

    def _run(self, step: Step, text: str, shown: str, code: int) -> None:
        ended, output = self._output_of(text)
        self._shown = output
        missing = missing_line(shown, output)
        told = f"{step.place}: {text}{output}"
        assert ended == code, f"{told}exit code {ended}, and not {code}{self._said()}"
        assert missing is None, f"{told}does not show: {missing}"

    def _look(self, step: Step, text: str, shown: str) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while True:
            ended, output = self._output_of(text)
            if ended == 0 and missing_line(shown, output) is None:
                self._shown = output
                return
            assert time.monotonic() < deadline, f"{step.place}: {text}{output}does not show:\n{shown}{self._said()}"
            time.sleep(0.2)

    def _said(self) -> str:
        return "".join(f"\n--- {name}\n" + "\n".join(child.lines) for name, child in self._terminals.items())

    def _open(self, step: Step, text: str) -> None:
        child = self._start(text)
        self._terminals[step.detail] = child
        if "until" in step.options:
            child.wait_for(step.options["until"], PATIENCE_S)

    def _watch(self, step: Step, text: str, shown: str) -> None:
        child = self._start(text)
        first, *others = shown.splitlines()
        deadline = time.monotonic() + PATIENCE_S
        self._wait_until_shown(child, first, deadline, step)
        if "ends" in step.options:
            self._terminals[step.options["ends"]].end(signal.SIGINT)
        for line in others:
            self._wait_until_shown(child, line, deadline, step)
        child.end(signal.SIGINT)

    @staticmethod
    def _wait_until_shown(child: system.Child, line: str, deadline: float, step: Step) -> None:
        while missing_line(line, "\n".join(child.lines)) is not None:
            assert time.monotonic() < deadline, f"{step.place}: {line} was not shown:\n" + "\n".join(child.lines)
            time.sleep(0.05)

    def _type(self, step: Step, text: str, answer: str, asked: str) -> str:
        """Give an answer to each question that ends so; returns all that was said."""
        ours, theirs = os.openpty()
        try:
            environment = {name: value for name, value in self._environment.items() if name != "UA_FLEET_PASSWORD"}
            process: subprocess.Popen[bytes] | ForkedProcess
            if (commands := plain_commands(text)) is not None and len(commands) == 1:
                (only,) = commands
                whole = environment | only.environment
                process = system.forked(*only.words, env=whole, folder=self.folder, terminal=theirs)
            else:
                process = subprocess.Popen(
                    self._bash(text),
                    env=environment,
                    stdin=theirs,
                    stdout=theirs,
                    stderr=theirs,
                    start_new_session=True,
                )
            os.close(theirs)
            said, answered = "", 0
            # The end of the other side is an error where it is a terminal.
            try:
                while chunk := os.read(ours, 1024).decode():
                    said += chunk
                    if said.endswith(asked) and len(said) > answered:
                        os.write(ours, f"{answer}\n".encode())
                        answered = len(said)
            except OSError:
                pass
            assert process.wait(PATIENCE_S) == 0, f"{step.place}: {text}{said}"
            return said
        finally:
            os.close(ours)
