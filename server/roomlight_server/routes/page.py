"""The live page: `/`, `/phone` and `/assets/*` from the files in the folder `page/` of this package.

The page is built by Vite from `client/page` and is part of the package, so that it works without the internet. Its
answers contain nothing about any room and need no token. The files are read once and held in memory.
"""

import gzip
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from fastapi import APIRouter, Request, Response

from roomlight_server.base.problems import ProblemError, documented
from roomlight_server.routes.etags import UNCHANGED, etag_of, unchanged

router = APIRouter(tags=["page"])
PAGES: Final = {"/": "index.html", "/phone": "phone.html"}
"""The file of each page's path."""
ASSETS: Final = "/assets"
MAX_PAGE_BYTES: Final = 8 * 2**20
"""Most bytes of all files together: they stay in memory."""
CONTENT_SECURITY_POLICY: Final = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self' 'wasm-unsafe-eval'",
        "style-src 'self'",
        "img-src 'self' blob: data:",
        "font-src 'self'",
        "connect-src 'self' blob: data:",
        "worker-src 'self' blob:",
        "media-src 'self' blob:",
        "manifest-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)
"""Everything comes from the server itself; no other page can frame it."""
_HEADERS: Final = {
    "Content-Security-Policy": CONTENT_SECURITY_POLICY,
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(self), xr-spatial-tracking=(self)",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
_TYPES: Final = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
}
_DOCUMENTED: Final[dict[int | str, dict[str, Any]]] = {
    200: {"description": "The page", "content": {"text/html": {}}},
    **UNCHANGED,
    **documented("page-not-built"),
}


@dataclass(frozen=True)
class PageFile:
    """A file of the page: its bytes, as they are and compressed, its type and ETag."""

    data: bytes
    packed: bytes
    media_type: str
    etag: str


def page_folder() -> Path:
    """Return the folder of the built page, which may be missing in a checkout."""
    return Path(str(files("roomlight_server") / "page"))


@lru_cache(maxsize=4)
def page_files(folder: Path) -> dict[str, PageFile]:
    """Read a built page: its files by path, for example `/` and `/assets/index-1a2b.js`. Empty if it is not built.

    Raises:
        ValueError: The page is larger than `MAX_PAGE_BYTES`, or a file has an unknown type.
    """
    paths = {path: folder / name for path, name in PAGES.items() if (folder / name).is_file()}
    if (folder / "assets").is_dir():
        paths |= {f"{ASSETS}/{file.name}": file for file in sorted((folder / "assets").iterdir()) if file.is_file()}
    size = sum(file.stat().st_size for file in paths.values())
    if size > MAX_PAGE_BYTES:
        raise ValueError(f"{folder}: the page has {size} bytes; at most {MAX_PAGE_BYTES}")
    return {path: _read(file) for path, file in paths.items()}


def _read(file: Path) -> PageFile:
    data, suffix = file.read_bytes(), file.suffix.lower()
    if suffix not in _TYPES:
        raise ValueError(f"{file}: no media type is known for {suffix or 'files without a suffix'}")
    return PageFile(data, gzip.compress(data, mtime=0), _TYPES[suffix], etag_of(data))


@router.get("/", summary="The live page", response_class=Response, responses=_DOCUMENTED)
async def page(request: Request) -> Response:
    """Return the live page: sessions, the room in 3D, probes and their light."""
    return _answer(request, "/", "no-cache")


@router.get("/phone", summary="The phone's page", response_class=Response, responses=_DOCUMENTED)
async def phone_page(request: Request) -> Response:
    """Return the page that streams a phone's camera to this server."""
    return _answer(request, "/phone", "no-cache")


@router.get(
    ASSETS + "/{name}",
    summary="A file of the pages",
    response_class=Response,
    responses={**UNCHANGED, **documented("not-found", "invalid")},
)
async def asset(request: Request, name: str) -> Response:
    """Return a file of the pages; its name changes with its content."""
    return _answer(request, f"{ASSETS}/{name}", "public, max-age=31536000, immutable")


def _answer(request: Request, path: str, cache: str) -> Response:
    file = page_files(page_folder()).get(path)
    if file is None:
        if path in PAGES:
            advice = "run `npm ci` and `npm run build` in client/page"
            raise ProblemError("page-not-built", f"this installation has no built page; {advice}")
        raise ProblemError("not-found", f"the page has no file {path[:200]}")
    headers = {**_HEADERS, "ETag": file.etag, "Cache-Control": cache, "Vary": "Accept-Encoding"}
    if same := unchanged(request, headers):
        return same
    if "gzip" in request.headers.get("accept-encoding", ""):
        return Response(file.packed, media_type=file.media_type, headers=headers | {"Content-Encoding": "gzip"})
    return Response(file.data, media_type=file.media_type, headers=headers)
