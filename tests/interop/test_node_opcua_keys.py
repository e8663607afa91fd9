"""A foreign OPC UA client, node-opcua, fetches keys with a bridge's certificate."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from tests.integration.key_service.harness import PASSWORDS, Cards, desk
from tests.interop.node import run_node
from tests.unit.server.key_service.fleet import fleet
from ua_fleet.wire.security import SecurityPolicy

CLIENT = Path(__file__).parent / "keys.cjs"
PUSHING = Path(__file__).parent / "push.cjs"


async def run_client(
    url: str, cards: Cards, card: str, folder: Path, *arguments: str, program: Path = CLIENT
) -> tuple[int, str, str]:
    """Run the foreign client to its end."""
    files = cards.get(card)
    pem = folder / f"{card}.pem"
    folder.mkdir(parents=True, exist_ok=True)
    pem.write_bytes(x509.load_der_x509_certificate(files.certificate.read_bytes()).public_bytes(Encoding.PEM))
    return await run_node(program, url, cards.uri(card), pem, files.private_key, folder / "pki", *arguments)


@pytest.mark.needs("node")
async def test_foreign_client_fetches_keys(tmp_path: Path) -> None:
    cards = Cards(tmp_path)
    async with desk(tmp_path / "desk", cards) as made:
        code, output, errors = await run_client(made.url, cards, "arm", tmp_path / "arm", "t-0", "c-2", "c-300", "t-9")
        assert code == 0, errors
        report: dict[str, Any] = json.loads(output.splitlines()[-1])
        for group in ("t-0", "c-2"):
            answer = report[group]
            expected = made.service.keys_for_space(1, group, 0, 3)
            assert answer["status"] == "Good"
            assert answer["types"] == ["String", "UInt32", "ByteString", "Double", "Double"]
            assert answer["isArray"] == [False, False, True, False, False]
            uri, token, keys, time_to_next_ms, lifetime_ms = answer["values"]
            assert (uri, token) == (expected.policy.value, 1)
            assert keys == [key.hex() for key in expected.keys]
            assert 0 < time_to_next_ms <= lifetime_ms == 3_600_000
        assert report["c-300"]["status"] == "BadUserAccessDenied"
        assert report["t-9"]["status"] == "BadNotFound"


@pytest.mark.needs("node")
async def test_foreign_key_service_pushes_keys(tmp_path: Path) -> None:
    cards = Cards(tmp_path)
    config = fleet(keys={"source": "pushed", "pushed_by": "olga"})
    policy = SecurityPolicy.AES256_CTR
    keys = tuple([bytes([number]) * policy.key_data_bytes for number in (1, 2, 3)])
    hexadecimal = ",".join(key.hex() for key in keys)
    async with desk(tmp_path / "desk", cards, config=config) as made:

        async def push(user: str, policy_uri: str, *groups: str) -> dict[str, str]:
            arguments = (user, PASSWORDS[user], policy_uri, hexadecimal, *groups)
            code, output, errors = await run_client(
                made.url, cards, "visitor", tmp_path / "visitor", *arguments, program=PUSHING
            )
            assert code == 0, errors
            report: dict[str, str] = json.loads(output.splitlines()[-1])
            return report

        assert await push("eva", policy.value, "t-2") == {"t-2": "BadUserAccessDenied"}
        assert await push("olga", SecurityPolicy.AES128_CTR.value, "t-2") == {"t-2": "BadSecurityPolicyRejected"}
        assert await push("olga", policy.value, "t-2", "t-9") == {"t-2": "Good", "t-9": "BadNotFound"}
        taken = made.service.keys_for_space(0, "t-2", 0, 5)
        assert (taken.policy, taken.first_token_id, taken.keys, taken.key_lifetime_s) == (policy, 5, keys, 100.0)
        assert 0 < taken.time_to_next_key_s <= 40.0


@pytest.mark.needs("node")
async def test_foreign_client_that_is_no_bridge_is_refused(tmp_path: Path) -> None:
    cards = Cards(tmp_path)
    async with desk(tmp_path / "desk", cards) as made:
        code, _, errors = await run_client(made.url, cards, "visitor", tmp_path / "visitor", "t-0")
        assert code == 1
        assert "BadIdentityTokenRejected" in errors
