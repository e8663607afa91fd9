"""What two demonstrations on one machine do not share."""

from __future__ import annotations

import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from ua_demo.commands.pal import pal
from ua_demo.folder import claim_domain, run_folder

from ua_fleet.errors import ConfigError


def test_a_folder_in_which_a_demonstration_runs_is_no_other_one_s(tmp_path: Path) -> None:
    """Its fleet.yaml and its users' passwords would be replaced."""
    with (
        run_folder(tmp_path, "pal", keep=True),
        pytest.raises(ConfigError, match="another demonstration runs in this folder; choose another --folder"),
        run_folder(tmp_path, "pal", keep=True),
    ):
        pass
    with run_folder(tmp_path, "pal", keep=True) as again:
        assert again == tmp_path


class _Begun(Exception):
    """The demonstration would begin now."""


def test_an_arm_in_ros_2_has_a_domain_that_no_other_demonstration_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def choose_site(_folder: Path, **_told: Any) -> SimpleNamespace:
        return SimpleNamespace(ros1_python=None)

    monkeypatch.setattr("ua_demo.site.choose_site", choose_site)
    given: dict[str, Any] = {}

    def make_setting(_site: Any, **told: Any) -> None:
        given.update(told)
        raise _Begun

    monkeypatch.setattr("ua_demo.pal.setting.make_setting", make_setting)
    said: list[str] = []
    with claim_domain(2, said.append), claim_domain(3, said.append), pytest.raises(_Begun):
        pal(folder=tmp_path / "run")
    assert said == []
    assert (given["domain"], given["arm_domain"]) == (4, 5)
    with pytest.raises(_Begun):  # one that both are asked to have is told as such
        pal(folder=tmp_path / "run", domain=7, arm_domain=7)
    assert (given["domain"], given["arm_domain"]) == (7, 7)
