"""The page's own files under a name with their hash: a browser keeps them until one of them changes."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from starlette.responses import HTMLResponse, Response
from starlette.staticfiles import StaticFiles

if TYPE_CHECKING:
    import os

    from starlette.requests import Request
    from starlette.types import Scope

STATIC = Path(__file__).parent / "static"
INDEX = "index.html"
KEPT = "public, max-age=31536000, immutable"
HASH_DIGITS = 16


@cache
def place() -> str:
    """Path that all modules, styles and pictures lie below; modules name each other from there."""
    whole = hashlib.sha256()
    for path in sorted(STATIC.rglob("*")):
        if path.is_file():
            whole.update(path.relative_to(STATIC).as_posix().encode() + b"\0")
            whole.update(hashlib.sha256(path.read_bytes()).digest())
    return f"/static-{whole.hexdigest()[:HASH_DIGITS]}"


class KeptFiles(StaticFiles):
    """Files below `place`, which never change under that name."""

    def file_response(
        self,
        full_path: str | os.PathLike[str],
        stat_result: os.stat_result,
        scope: Scope,
        status_code: int = 200,
    ) -> Response:
        """See StaticFiles."""
        answer = super().file_response(full_path, stat_result, scope, status_code)
        answer.headers["cache-control"] = KEPT
        return answer


async def index(_: Request) -> Response:
    """The first page, which names the others where they are now; it is asked for each time."""
    return HTMLResponse(placed((STATIC / INDEX).read_text(encoding="utf-8")))


def placed(page: str) -> str:
    """A page whose files are named from its own folder, with them at their place."""
    for name in ("href", "src"):
        page = page.replace(f' {name}="', f' {name}="{place()[1:]}/')
    return page
