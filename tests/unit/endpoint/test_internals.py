from __future__ import annotations

import pytest

from ua_fleet.endpoint.asyncua_internals import check_internals
from ua_fleet.errors import ServerStartError


def test_installed_asyncua_is_the_one_we_hook() -> None:
    check_internals()


@pytest.mark.parametrize(
    ("used", "version", "text"),
    [
        ({}, "9.9.9", "hooks 9.9.9"),
        ({"asyncua.server.server": ("Server.no_such_thing()",)}, "2.1.0", "does not exist"),
        ({"asyncua.server.address_space": ("AddressSpace.get(other)",)}, "2.1.0", "has the parameters nodeid"),
        ({"asyncua.common.utils": ("_logger()",)}, "2.1.0", "cannot be called"),
    ],
)
def test_another_asyncua_is_refused_in_one_line(used: dict[str, tuple[str, ...]], version: str, text: str) -> None:
    with pytest.raises(ServerStartError, match=text) as refused:
        check_internals(used, version)
    assert "pip install 'asyncua==" in str(refused.value)
    assert "\n" not in str(refused.value)
