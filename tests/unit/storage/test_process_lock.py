from __future__ import annotations

from pathlib import Path

import pytest

from ua_fleet.errors import StorageUnavailable
from ua_fleet.storage.process_lock import process_lock


def test_one_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "state" / "cell.lock"
    with process_lock(path, "bridge cell"):
        with pytest.raises(StorageUnavailable, match="bridge cell runs already"), process_lock(path, "bridge cell"):
            pass
        with process_lock(path.with_name("hall.lock"), "bridge hall"):
            pass
    with process_lock(path, "bridge cell"):
        pass


def test_without_a_disk_to_write_to_nobody_is_kept_out(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with process_lock(tmp_path / "file" / "cell.lock", "bridge cell"):
        pass
