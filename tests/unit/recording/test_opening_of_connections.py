"""A recording of several connections is opened with the fleet's keys, whichever of them is secured."""

from __future__ import annotations

import time
from pathlib import Path

from tests.unit.recording.recorded import ARM, HEADER, Recording
from ua_fleet.cli.exports import opener_of
from ua_fleet.config.load import load_content
from ua_fleet.counters import Counters
from ua_fleet.recording.files import RecordingWriter
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.wire import SecurityMode, SecurityPolicy

FLEET = b"""\
version: 1
pubsub:
  - {name: hall, security: none, keys: {source: files}}
  - {name: site, security: sign, url: "mqtt://127.0.0.1:1883"}
bridges:
  arm: {kind: ros1, space: 1, status_id: 1, connections: [site]}
"""


async def test_the_keys_of_a_further_connection_open_what_it_brought(tmp_path: Path) -> None:
    recording = Recording(SecurityMode.SIGN)
    recording.announce(ARM)
    file = tmp_path / "recording"
    with RecordingWriter(file, HEADER, 1 << 20) as writer:
        for record in recording.records:
            writer.write(record)
    name = recording.records[0].key
    folder = KeyFolder(tmp_path / "keys")
    folder.write(KeyFile.new("t-1", SecurityPolicy.AES256_CTR, 3600.0, time.time()))
    fleet = load_content(FLEET, "fleet.yaml", {})
    opener = await opener_of(file, HEADER, Counters(), fleet, tmp_path, None, None)
    assert list(opener.keys) == [name]
