"""docs/pubsub.md shows what `ua-fleet pubsub decode` really prints."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator

import pytest
from typer.testing import CliRunner

from tests.unit.docs.pages import ROOT, blocks
from tests.unit.wire.corpus import VECTORS
from ua_fleet.cli.app import app

PAGE = ROOT / "docs" / "pubsub.md"


def runs() -> Iterator[tuple[str, list[str], str]]:
    """Place, arguments and output of each command that is shown with its output."""
    for block in blocks("console"):
        if block.page == PAGE:
            command, _, output = block.text.partition("\n")
            yield block.place, shlex.split(command.removeprefix("$ "))[1:], output


@pytest.mark.parametrize(("arguments", "output"), [pytest.param(*run, id=place) for place, *run in runs()])
def test_the_page_shows_what_is_printed(arguments: list[str], output: str) -> None:
    ended = CliRunner().invoke(app, arguments, prog_name="ua-fleet")
    assert ended.output == output
    assert ended.exit_code == (1 if re.search(r"does not verify|not to be read|NotRead|error", output) else 0)


def test_messages_of_a_peer_are_among_them() -> None:
    shown = {word for _, arguments, _ in runs() for word in arguments}
    for name in ("peer_none", "peer_sign256", "peer_enc128"):
        recorded = (VECTORS / f"{name}.hex").read_text(encoding="ascii").split()
        assert shown & set(recorded)
