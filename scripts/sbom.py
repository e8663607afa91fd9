"""Software bills of materials (CycloneDX 1.6): of the wheel with all its extras, and of the images of the testbed.

python scripts/sbom.py wheel FOLDER            builds the wheel, installs it with all extras from requirements.lock
python scripts/sbom.py images FOLDER IMAGE...  asks images of this machine's Docker engine, which are there

What is installed is asked of each environment itself, and not guessed from what was wanted.
"""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from cyclonedx.model import HashAlgorithm, HashType, Property
from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.model.license import LicenseExpression
from cyclonedx.output import make_outputter
from cyclonedx.schema import OutputFormat, SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
from packageurl import PackageURL

ROOT: Final = Path(__file__).resolve().parent.parent
EXTRAS: Final = ("server", "client", "ros2", "modbus", "ur", "sensors", "plot")
OURS: Final = "ua-fleet"
ASK: Final = r"""
import importlib.metadata as m, json, os, subprocess
dists = [{"name": d.metadata["Name"], "version": d.version, "needs": d.requires or [],
          "license": d.metadata.get("License-Expression") or ""} for d in m.distributions()]
debs = []
if os.path.exists("/var/lib/dpkg/status") and os.environ.get("SYSTEM"):
    shown = subprocess.run(["dpkg-query", "-W", "-f", "${Package}\t${Version}\t${Architecture}\n"],
                           capture_output=True, text=True, check=True).stdout
    debs = [line.split("\t") for line in shown.splitlines()]
print(json.dumps({"dists": dists, "debs": debs}))
"""
"""What an environment's own Python says of it; SYSTEM: Debian's packages too."""


def normalized(name: str) -> str:
    """A distribution's name as package indexes compare it (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def _python_component(found: Mapping[str, Any]) -> Component:
    name, version = normalized(found["name"]), found["version"]
    purl = PackageURL("pypi", None, name, version)
    licenses = [LicenseExpression(found["license"])] if found["license"] else []
    kind = ComponentType.APPLICATION if name == OURS else ComponentType.LIBRARY
    return Component(type=kind, name=name, version=version, purl=purl, bom_ref=str(purl), licenses=licenses)


def _debian_component(name: str, version: str, architecture: str) -> Component:
    purl = PackageURL("deb", "debian", name, version, {"arch": architecture, "distro": "debian-12"})
    return Component(type=ComponentType.LIBRARY, name=name, version=version, purl=purl, bom_ref=str(purl))


def bill_of(
    asked: Mapping[str, Any], *, name: str, kind: ComponentType, digest: str = "", notes: Iterable[Property] = ()
) -> Bom:
    """A bill of what an environment has said of itself.

    Args:
        asked: what `ASK` prints.
        name: of the whole.
        kind: of the whole.
        digest: SHA-256 of the whole in hexadecimal digits.
        notes: more about it.
    """
    parts = {component.name: component for component in map(_python_component, asked["dists"])}
    ours = parts[OURS]
    whole = ours
    if kind is not ComponentType.APPLICATION:
        whole = Component(type=kind, name=name, version=ours.version, bom_ref=name)
    if digest:
        whole.hashes.add(HashType(alg=HashAlgorithm.SHA_256, content=digest))
    for note in notes:
        whole.properties.add(note)
    bom = Bom()
    bom.metadata.component = whole
    debs = [_debian_component(*deb) for deb in asked["debs"]]
    for component in [*parts.values(), *debs]:
        if component is not whole:
            bom.components.add(component)
    if whole is not ours:
        bom.register_dependency(whole, [ours, *debs])
    for found in asked["dists"]:
        needs = {normalized(re.split(r"[\s\[;<>=!~(]", need, maxsplit=1)[0]) for need in found["needs"]}
        bom.register_dependency(
            parts[normalized(found["name"])], [parts[need] for need in sorted(needs & parts.keys())]
        )
    return bom


def written(bom: Bom, path: Path) -> None:
    """Write a bill, which must be what the schema of CycloneDX wants."""
    text = make_outputter(bom, OutputFormat.JSON, SchemaVersion.V1_6).output_as_string(indent=1)
    if (problem := JsonStrictValidator(SchemaVersion.V1_6).validate_str(text)) is not None:
        raise SystemExit(f"{path.name} would not be valid CycloneDX 1.6: {problem}")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"{text}\n", encoding="utf-8")
    sys.stdout.write(f"{path}: {len(bom.components)} components\n")


def _run(*command: str | Path, **environment: str) -> str:
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, env=environment or None, check=False)  # noqa: S603
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, command[:4]))} ... failed; what it said stands above")
    return done.stdout


def wheel(folder: Path) -> None:
    """The bill of the wheel, which is left beside it."""
    python = Path(sys.executable)
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*.whl"):
        old.unlink()
    _run(
        python,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "--wheel-dir",
        folder.resolve(),
        ".",
    )
    [built] = folder.glob("*.whl")
    with tempfile.TemporaryDirectory() as place:
        _run(python, "-m", "venv", "--without-pip", place)
        inner, wanted = Path(place) / "bin" / "python", Path(place) / "wanted"
        wanted.write_text(_run(python, "scripts/wanted", "pyproject.toml", *EXTRAS), encoding="utf-8")
        install = (python, "-m", "pip", "--python", inner, "install", "--quiet")
        _run(*install, "--require-hashes", "--constraint", "requirements.lock", "--requirement", wanted)
        _run(*install, "--no-deps", built.resolve())
        asked = json.loads(_run(inner, "-c", ASK))
    digest = hashlib.sha256(built.read_bytes()).hexdigest()
    bom = bill_of(asked, name=OURS, kind=ComponentType.APPLICATION, digest=digest)
    written(bom, folder / f"{built.stem}.cdx.json")


def images(folder: Path, names: Sequence[str]) -> None:
    """The bills of images, each named as the image."""
    for name in names:
        identity = _run("docker", "image", "inspect", "--format", "{{.Id}}", name).strip()
        run = (
            "docker",
            "run",
            "--rm",
            "--network",
            "none",
            "--read-only",
            "--env",
            "SYSTEM=1",
            "--entrypoint",
            "python",
        )
        asked = json.loads(_run(*run, identity, "-c", ASK))
        notes = [Property(name="oci:image:id", value=identity)]
        bom = bill_of(asked, name=name, kind=ComponentType.CONTAINER, notes=notes)
        written(bom, folder / f"{re.sub('[^A-Za-z0-9.]+', '-', name)}.cdx.json")


if __name__ == "__main__":
    if len(sys.argv) < 3 or sys.argv[1] not in ("wheel", "images"):
        raise SystemExit(f"usage: {__doc__}")
    if sys.argv[1] == "wheel":
        wheel(Path(sys.argv[2]))
    else:
        images(Path(sys.argv[2]), sys.argv[3:])
