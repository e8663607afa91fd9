"""`console.yaml`: all problems of the file at once, with their lines."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from ua_fleet.config.load import read_content
from ua_fleet.config.typed_texts import validated
from ua_fleet.config.wording import explain
from ua_fleet.console.settings import ConsoleSettings
from ua_fleet.document import Document, read_document
from ua_fleet.errors import ConfigInvalid

__all__ = ["load_settings"]

_VERSION: Final = 1


def load_settings(path: Path | None, given: Mapping[str, Any]) -> ConsoleSettings:
    """The settings of a file, or of none, with what was given as options before it.

    Relative paths in a file are below its folder.

    Raises:
        ConfigInvalid: with all problems, in the order of their lines.
    """
    document = Document({}, {}, {}, []) if path is None else read_document(read_content(path), str(path), os.environ)
    if document.problems or document.is_newer_than(_VERSION):
        raise ConfigInvalid(document.problems)
    data = {**document.data, **given}
    data.pop("version", None)
    data["fleets"] = {**(document.data.get("fleets") or {}), **given.get("fleets", {})}
    try:
        settings = validated(ConsoleSettings, data, (), document)
    except ValidationError as error:
        for finding in explain(ConsoleSettings, data, error.errors(include_url=False)):
            document.problem(finding.path, finding.message, finding.suggestion)
        raise ConfigInvalid(sorted(document.problems, key=lambda problem: problem.line)) from None
    if path is not None:
        _below(settings, path.resolve().parent)
    return settings


def _below(settings: ConsoleSettings, folder: Path) -> None:
    if settings.state_dir is not None:
        settings.state_dir = folder / settings.state_dir
    if settings.tls is not None:
        settings.tls.certificate = folder / settings.tls.certificate
        settings.tls.key = folder / settings.tls.key
