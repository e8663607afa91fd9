"""The page itself: files that were built from `web/`, compressed beforehand, and the headers that keep it safe."""

from __future__ import annotations

import gzip
import hashlib
import mimetypes
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from starlette.requests import Request
from starlette.responses import Response

__all__ = ["PAGE_FOLDER", "SECURITY_HEADERS", "Page", "page_missing"]

PAGE_FOLDER: Final = Path(__file__).parent / "page"
SECURITY_HEADERS: Final = {
    "content-security-policy": "default-src 'self'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), microphone=(), geolocation=(), payment=(), usb=(), serial=(), gamepad=(self)",
}
_HASHED: Final = "assets"
"""Vite puts files whose names have a hash of their content here."""
_IMMUTABLE: Final = "public, max-age=31536000, immutable"
_PACKED: Final = {"br": ".br", "gzip": ".gz"}
_LEAST_PACKED: Final = 1024

_MISSING: Final = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>ua-fleet console</title></head>
<body><h1>The page is not built</h1><p>The console runs, but its page is not in this installation. In the project's
folder run <code>make setup</code>, or <code>npm ci</code> and <code>npm run build</code> in <code>web/</code>, and load
this page again.</p></body></html>
"""


def page_missing(folder: Path = PAGE_FOLDER) -> str:
    """What to do where the page is not built; empty where it is."""
    if (folder / "index.html").is_file():
        return ""
    return "the page is not built: run make setup, or npm ci && npm run build in web/"


@dataclass(frozen=True, slots=True)
class _File:
    content: bytes
    packed: dict[str, bytes]
    etag: str
    media_type: str
    cache: str


class Page:
    """The page's files, read once and kept; a request can name no other file."""

    def __init__(self, folder: Path = PAGE_FOLDER) -> None:
        self._folder = folder
        self._files: dict[str, _File] = {}
        self._read_at = 0

    def answer(self, path: str, request: Request) -> Response:
        """The file of a path below the page's root, as it was read."""
        file = self._files.get(path or "index.html")
        if file is None:
            if path or page_missing(self._folder) == "":
                return Response("not found\n", 404, media_type="text/plain")
            return Response(_MISSING, 503, media_type="text/html")
        headers = {"etag": file.etag, "cache-control": file.cache, "vary": "accept-encoding"}
        if request.headers.get("if-none-match") == file.etag:
            return Response(status_code=304, headers=headers)
        accepted = {part.split(";")[0].strip() for part in request.headers.get("accept-encoding", "").split(",")}
        for encoding, content in file.packed.items():
            if encoding in accepted:
                headers["content-encoding"] = encoding
                return Response(content, headers=headers, media_type=file.media_type)
        return Response(file.content, headers=headers, media_type=file.media_type)

    @property
    def is_other(self) -> bool:
        """Whether the page has not been read, or was built anew."""
        return self._built_at() != self._read_at

    def _built_at(self) -> int:
        try:
            return (self._folder / "index.html").stat().st_mtime_ns
        except OSError:
            return 0

    def read(self) -> None:
        """Read the files, and compress what was not compressed beforehand."""
        built_at = self._built_at()
        if not built_at:
            self._files, self._read_at = {}, 0
            return
        files: dict[str, _File] = {}
        for file in sorted(self._folder.rglob("*")):
            name = file.relative_to(self._folder).as_posix()
            if not file.is_file() or file.suffix in _PACKED.values():
                continue
            files[name] = _file(file, name)
        self._files, self._read_at = files, built_at


def _file(file: Path, name: str) -> _File:
    content = file.read_bytes()
    packed = {
        encoding: beside.read_bytes()
        for encoding, suffix in _PACKED.items()
        if (beside := file.with_name(file.name + suffix)).is_file()
    }
    media_type = mimetypes.guess_type(file.name)[0] or "application/octet-stream"
    is_text = media_type.startswith("text/") or media_type in (
        "application/javascript",
        "image/svg+xml",
        "application/json",
    )
    if not packed and is_text and len(content) >= _LEAST_PACKED:
        packed["gzip"] = gzip.compress(content, mtime=0)
    etag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
    return _File(content, packed, etag, media_type, _IMMUTABLE if name.startswith(f"{_HASHED}/") else "no-cache")
