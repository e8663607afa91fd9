"""Tests draw keys that were made before; a key that is none is refused as ever."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import rsa

from tests.known_keys import MOST
from tests.system import Processes

_PROGRAM = """
import sys
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import rsa
assert rsa.generate_private_key.__module__ == serialization.load_pem_private_key.__module__ == "tests.known_keys"
print(rsa.generate_private_key(65537, 2048).public_key().public_numbers().n)
"""


def _pem(key: rsa.RSAPrivateKey) -> bytes:
    plain = serialization.NoEncryption()
    return key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, plain)


def test_those_that_are_drawn_differ_also_over_processes(tmp_path: Path) -> None:
    keys = [rsa.generate_private_key(65537, 2048) for _ in range(3)]
    (tmp_path / "draw.py").write_text(_PROGRAM)
    with Processes() as processes:
        child = processes.start(Path(sys.executable), tmp_path / "draw.py")
        assert child.process.wait(60) == 0, child.lines
        child.end()
        drawn = int(child.lines[-1])
    assert len({drawn, *(key.public_key().public_numbers().n for key in keys)}) == 4 < MOST
    for key in keys:
        assert serialization.load_pem_private_key(_pem(key), None).private_numbers() == key.private_numbers()  # type: ignore[union-attr]


def test_one_of_another_size_is_made_as_ever() -> None:
    assert rsa.generate_private_key(65537, 3072).key_size == 3072


def test_one_whose_numbers_do_not_fit_is_refused() -> None:
    numbers = rsa.generate_private_key(65537, 2048).private_numbers()
    wrong = rsa.RSAPrivateNumbers(
        p=numbers.p,
        q=numbers.q,
        d=numbers.d + 2,
        dmp1=numbers.dmp1,
        dmq1=numbers.dmq1,
        iqmp=numbers.iqmp,
        public_numbers=numbers.public_numbers,
    ).private_key(unsafe_skip_rsa_key_validation=True)
    with pytest.raises(ValueError, match=r"(?i)key"):
        serialization.load_pem_private_key(_pem(wrong), None)
