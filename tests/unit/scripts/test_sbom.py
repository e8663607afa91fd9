"""`scripts/sbom.py` on the environment that the tests run in."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import pytest

from tests import system
from ua_fleet import __version__


@pytest.fixture(scope="module")
def sbom() -> ModuleType:
    spec = importlib.util.spec_from_file_location("sbom", system.ROOT / "scripts" / "sbom.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def bill(sbom: ModuleType, path: Path, asked: dict[str, Any], **options: Any) -> dict[str, Any]:
    sbom.written(sbom.bill_of(asked, **options), path)  # refuses what CycloneDX's schema does
    read = json.loads(path.read_text(encoding="utf-8"))
    return cast("dict[str, Any]", read)


def test_a_wheel_s_bill_names_what_it_stands_on(sbom: ModuleType, tmp_path: Path) -> None:
    said = subprocess.run([sys.executable, "-c", sbom.ASK], capture_output=True, text=True, check=True).stdout
    kind = sbom.ComponentType.APPLICATION
    read = bill(sbom, tmp_path / "x.json", json.loads(said), name="ua-fleet", kind=kind, digest="ab" * 32)
    whole = read["metadata"]["component"]
    assert (whole["name"], whole["version"], whole["purl"]) == (
        "ua-fleet",
        __version__,
        f"pkg:pypi/ua-fleet@{__version__}",
    )
    assert whole["hashes"] == [{"alg": "SHA-256", "content": "ab" * 32}]
    parts = {part["name"]: part for part in read["components"]}
    assert parts["cryptography"]["purl"].startswith("pkg:pypi/cryptography@")
    needs = {row["ref"]: row.get("dependsOn", []) for row in read["dependencies"]}
    assert parts["asyncua"]["bom-ref"] in needs[whole["bom-ref"]]
    assert parts["cryptography"]["bom-ref"] in needs[parts["asyncua"]["bom-ref"]]


def test_an_image_s_bill_has_the_system_s_packages_too(sbom: ModuleType, tmp_path: Path) -> None:
    asked = {
        "dists": [
            {
                "name": "ua-fleet",
                "version": "1.0",
                "needs": ["PyYAML>=6 ; python_version>'3'"],
                "license": "Apache-2.0",
            },
            {"name": "pyyaml", "version": "6.0.3", "needs": list[str](), "license": "MIT"},
        ],
        "debs": [["libc6", "2.36-9+deb12u10", "amd64"]],
    }
    kind = sbom.ComponentType.CONTAINER
    read = bill(sbom, tmp_path / "x.json", asked, name="ua-fleet/core:local", kind=kind)
    assert read["metadata"]["component"]["type"] == "container"
    purls = {part["purl"] for part in read["components"]}
    assert purls == {
        "pkg:pypi/ua-fleet@1.0",
        "pkg:pypi/pyyaml@6.0.3",
        "pkg:deb/debian/libc6@2.36-9%2Bdeb12u10?arch=amd64&distro=debian-12",
    }
