from __future__ import annotations

import os
from pathlib import Path

import pytest

from ua_fleet.errors import ConfigError, KeysRefused
from ua_fleet.keys.files import FileKeySource
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.wire.security import SecurityPolicy

AES256 = SecurityPolicy.AES256_CTR
NOW = 1_800_000_000.0


class Site:
    """A folder of key files with a clock, and a source over it."""

    def __init__(self, path: Path) -> None:
        self.now = NOW
        self.folder = KeyFolder(path / "keys")
        self.source = FileKeySource(self.folder.path, AES256, lambda: self.now)

    def create(self, group_id: str = "t-2", policy: SecurityPolicy = AES256) -> KeyFile:
        key_file = KeyFile.new(group_id, policy, 600.0, self.now)
        self.folder.write(key_file)
        return key_file

    def rotate(self, delay_s: float = 10.0, past_keys: int = 1) -> KeyFile:
        key_file = self.folder.read("t-2").rotated(self.now, delay_s, past_keys)
        self.folder.write(key_file)
        return key_file


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path)


async def test_the_current_key_lasts_until_there_is_another(site: Site) -> None:
    key_file = site.create()
    for later in (0.0, 599.0, 1e7):
        site.now = NOW + later
        keys = await site.source.fetch("t-2", 0, 4)
        assert keys == (AES256, 1, (key_file.keys[0].key_data,), 600.0, 600.0)


async def test_a_rotated_file_gives_the_next_key_with_the_time_to_it(site: Site) -> None:
    site.create()
    await site.source.fetch("t-2", 0, 4)
    data = [key.key_data for key in site.rotate(10.0).keys]
    site.now = NOW + 4
    keys = await site.source.fetch("t-2", 0, 4)
    assert (keys.first_token_id, list(keys.keys), keys.time_to_next_key_s) == (1, data, 6.0)
    site.now = NOW + 10
    keys = await site.source.fetch("t-2", 0, 4)
    assert (keys.first_token_id, list(keys.keys), keys.time_to_next_key_s) == (2, data[1:], 600.0)


async def test_as_many_keys_as_asked_for_from_the_token_asked_for(site: Site) -> None:
    site.create()
    site.rotate(0.0)
    site.rotate(10.0)
    data = [key.key_data for key in site.rotate(500.0).keys]
    assert await site.source.fetch("t-2", 0, 1) == (AES256, 2, (data[1],), 10.0, 600.0)
    assert await site.source.fetch("t-2", 0, 9) == (AES256, 2, tuple(data[1:3]), 10.0, 600.0)
    assert await site.source.fetch("t-2", 1, 9) == (AES256, 1, tuple(data[:3]), 10.0, 600.0)
    assert await site.source.fetch("t-2", 3, 9) == (AES256, 3, (data[2],), 10.0, 600.0)
    assert await site.source.fetch("t-2", 4711, 9) == (AES256, 1, tuple(data[:3]), 10.0, 600.0)
    site.now += 10.0
    assert await site.source.fetch("t-2", 0, 9) == (AES256, 3, tuple(data[2:]), 500.0, 600.0)


async def test_an_unchanged_file_is_not_read_again(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    site.create()
    before = await site.source.fetch("t-2", 0, 1)

    def fail(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(KeyFolder, "read_stamped", fail)
    assert await site.source.fetch("t-2", 0, 1) == before


async def test_why_there_are_no_keys(site: Site) -> None:
    with pytest.raises(KeysRefused, match=r"no keys of t-2: .*cannot be entered"):
        await site.source.fetch("t-2", 0, 1)
    site.create("t-3")
    with pytest.raises(KeysRefused, match=r"no keys of t-2: .*no such key file; run: ua-fleet keys create t-2"):
        await site.source.fetch("t-2", 0, 1)
    site.create()
    assert (await site.source.fetch("t-2", 0, 1)).first_token_id == 1
    path = site.folder.path_of("t-2")
    path.chmod(0o644)
    with pytest.raises(KeysRefused, match=f"others may read or write it .mode 644.; run: chmod 600 {path}"):
        await site.source.fetch("t-2", 0, 1)
    path.chmod(0o600)
    assert (await site.source.fetch("t-2", 0, 1)).first_token_id == 1
    os.replace(site.folder.path_of("t-3"), path)
    with pytest.raises(KeysRefused, match="group: the file is not that of t-2"):
        await site.source.fetch("t-2", 0, 1)


async def test_a_group_that_anybody_may_name_leads_to_no_file(site: Site) -> None:
    site.create()
    with pytest.raises(KeysRefused, match="is no name of a SecurityGroup"):
        await site.source.fetch("../keys/t-2", 0, 1)


def test_a_process_begins_only_with_sound_files(site: Site) -> None:
    with pytest.raises(ConfigError, match="cannot be entered: no such file or directory; run: ua-fleet keys create"):
        site.source.check(["t-2"], ["t-0"])
    site.create("t-0")
    with pytest.raises(ConfigError, match=r"t-2\.json: there is no such key file; run: ua-fleet keys create t-2"):
        site.source.check(["t-2"], ["t-0"])
    site.create()
    site.source.check(["t-2"], ["t-0", "t-9"])
    site.folder.path_of("t-0").chmod(0o660)
    with pytest.raises(ConfigError, match=r"t-0\.json: others may read or write it"):
        site.source.check(["t-2"], ["t-0", "t-9"])


def test_a_file_of_another_policy_than_configured_is_refused(site: Site) -> None:
    site.create(policy=SecurityPolicy.AES128_CTR)
    with pytest.raises(ConfigError) as caught:
        site.source.check(["t-2"], [])
    assert str(caught.value) == (
        f"{site.folder.path_of('t-2')}:policy: is PubSub-Aes128-CTR, and fleet.yaml says PubSub-Aes256-CTR; "
        "move the file away and run: ua-fleet keys create t-2"
    )
