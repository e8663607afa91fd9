"""Private keys of tests, which OpenSSL would search, and examine when they are read, for 0.03 s each time.

Whoever asks for a new one gets the next of `MOST` that were made before, by any process of tests; these are
examined by nobody. Each is made of two of a few primes. It is no secret then, but it is another key, which is enough
for tests, and 0.3 s of searching in place of 8. A key that others have made is examined once in a process. Programs
that are started without `forking` search and examine for themselves.
"""

from __future__ import annotations

import fcntl
import functools
import hashlib
import itertools
import json
import math
import os
from pathlib import Path
from typing import Any, Final

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import rsa

__all__ = ["keep"]

MOST: Final = 200
"""More than the tests that run at once draw within one of them: no two keys of a test are the same."""
_PRIMES: Final = 22
"""Each two of them are a key, so there are 231."""
_FOLDER: Final = Path(__file__).parents[1] / "build" / "test-keys"
_USUAL: Final = (65537, 2048)
_generate: Final[Any] = rsa.generate_private_key
_load: Final[Any] = serialization.load_pem_private_key
_load_examined: Final = functools.cache(_load)


def _der(key: rsa.RSAPrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.DER, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _is_made_here(key: Any) -> bool:
    return isinstance(key, rsa.RSAPrivateKey) and (_FOLDER / hashlib.sha256(_der(key)).hexdigest()).exists()


def _next_number() -> int:
    """How many were drawn before, by all processes."""
    counter = os.open(_FOLDER / "drawn", os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
    try:
        os.write(counter, b".")
        return os.lseek(counter, 0, os.SEEK_CUR) - 1
    finally:
        os.close(counter)


@functools.cache
def _primes() -> list[int]:
    """The same for all processes of tests."""
    with (_FOLDER / "primes").open("a+") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        file.seek(0)
        if not (text := file.read()):
            numbers = [_generate(*_USUAL).private_numbers() for _ in range(_PRIMES // 2)]
            text = json.dumps([prime for number in numbers for prime in (number.p, number.q)])
            file.write(text)
        primes: list[int] = json.loads(text)
        return primes


def _made(number: int) -> rsa.RSAPrivateKey:
    exponent, bits = _USUAL
    p, q = next(itertools.islice(itertools.combinations(_primes(), 2), number, None))
    d = pow(exponent, -1, math.lcm(p - 1, q - 1))
    parts = (d, rsa.rsa_crt_dmp1(d, p), rsa.rsa_crt_dmq1(d, q), rsa.rsa_crt_iqmp(p, q))
    numbers = rsa.RSAPrivateNumbers(p, q, *parts, rsa.RSAPublicNumbers(exponent, p * q))
    key = numbers.private_key(unsafe_skip_rsa_key_validation=True)
    assert key.key_size == bits
    return key


def _generate_private_key(public_exponent: int, key_size: int, backend: Any = None) -> Any:
    if (public_exponent, key_size) != _USUAL:
        return _generate(public_exponent, key_size, backend)
    _FOLDER.mkdir(mode=0o700, parents=True, exist_ok=True)
    number = _next_number() % MOST
    file = _FOLDER / f"{number}.der"
    try:
        return serialization.load_der_private_key(file.read_bytes(), None, unsafe_skip_rsa_key_validation=True)
    except FileNotFoundError:
        key = _made(number)
        new = file.with_suffix(f".{os.getpid()}")
        new.write_bytes(der := _der(key))
        (_FOLDER / hashlib.sha256(der).hexdigest()).touch()
        os.replace(new, file)  # not by `Path`, whose calls a test of the product's files counts
        return key


def _load_pem_private_key(data: bytes, password: bytes | None, backend: Any = None, **options: Any) -> Any:
    if password is None and not options:
        key = _load(data, None, unsafe_skip_rsa_key_validation=True)
        if _is_made_here(key):
            return key
    return _load_examined(data, password, backend, **options)


def keep() -> None:
    """Have keys be drawn and known in this process, and in all that are forked off it.

    Modules that are imported from now on do so by their own names too.
    """
    modules: tuple[Any, Any] = serialization, rsa
    modules[0].load_pem_private_key = _load_pem_private_key
    modules[1].generate_private_key = _generate_private_key
