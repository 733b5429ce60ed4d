"""The manual over real HTTP: its files and nothing else, for those who may see the status page."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from hashlib import sha256
from pathlib import Path

import aiohttp
import pytest
from helpers.browsersession import browsing
from helpers.pagesources import FixedSources
from yarl import URL

from edged.adapters.web import WebPublisher, WebSettings
from edged.identity.passwords import hash_password

SCRIPT = "let theme = 1 < 2"
FILES = {
    "index.html": f"<html><script>{SCRIPT}</script><script src='assets/app.js'></script>manual</html>",
    "how-to/plc.html": "<html>registers</html>",
    "assets/app.0123abcd.min.js": "run()",
    "assets/app.js": "run()",
    "assets/icon.svg": "<svg/>",
    "assets/style.css": "body {}",
    "search/search_index.json": "{}",
    "objects.inv": "?",
}


@pytest.fixture
def built(tmp_path: Path) -> Path:
    """A small manual, beside a file that is not part of it."""
    folder = tmp_path / "manual"
    for name, text in FILES.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (tmp_path / "secret.html").write_text("secret")
    return folder


@asynccontextmanager
async def served(
    manual: Path, password_hash: str = ""
) -> AsyncIterator[tuple[WebPublisher, aiohttp.ClientSession]]:
    """A status page with this manual, and a browser's session with it."""
    nothing = FixedSources(lambda: pytest.fail("nothing asks"))
    settings = WebSettings(port=0, password_hash=password_hash)
    web = WebPublisher("cell", settings, nothing, manual=manual)
    await web.start()
    try:
        async with browsing(f"http://127.0.0.1:{web.port}") as session:
            yield web, session
    finally:
        await web.close()


async def test_each_file_is_sent_as_what_it_is(built: Path) -> None:
    """Each file has its content and type, whatever the machine's MIME table; the folder is index.html."""
    async with served(built) as (_, session):
        types = {}
        for name, text in FILES.items():
            async with session.get(f"/manual/{name}") as answer:
                assert (200, text) == (answer.status, await answer.text())
                types[Path(name).suffix] = answer.headers["Content-Type"]
        assert types == {
            ".html": "text/html; charset=utf-8",
            ".js": "text/javascript; charset=utf-8",
            ".svg": "image/svg+xml",
            ".css": "text/css; charset=utf-8",
            ".json": "application/json",
            ".inv": "application/octet-stream",
        }
        for path in ("/manual", "/manual/"):
            async with session.get(path) as answer:
                assert ("/manual/", FILES["index.html"]) == (answer.url.path, await answer.text())


@pytest.mark.parametrize(
    "path",
    [
        "/manual/../secret.html",
        "/manual/..%2fsecret.html",
        "/manual/%2e%2e/secret.html",
        "/manual/how-to/..%2f..%2f..%2fsecret.html",
        "/manual//etc/passwd",
        "/manual/%2fetc%2fpasswd",
        "/manual/how-to",
        "/manual/how-to/",
        "/manual/index.html%00.js",
        "/manual/nowhere.html",
        "/manualx",
    ],
)
async def test_nothing_else_is_sent(built: Path, path: str) -> None:
    """No path leads out of the folder, no folder is listed, and the server stays up."""
    async with served(built) as (_, session):
        async with session.get(URL(path, encoded=True)) as answer:
            assert 404 == answer.status
            assert "secret" not in await answer.text()
        async with session.get("/manual/") as answer:
            assert 200 == answer.status


async def test_only_what_the_pages_hold_may_run(built: Path) -> None:
    """Inline scripts are allowed by hash, foreign hosts are not; the status page keeps its stricter
    policy."""
    async with served(built) as (_, session):
        async with session.get("/manual/") as answer:
            policy = answer.headers["Content-Security-Policy"]
            assert "nosniff" == answer.headers["X-Content-Type-Options"]
        digest = b64encode(sha256(SCRIPT.encode()).digest()).decode()
        directives = dict(part.strip().split(" ", 1) for part in policy.split(";"))
        assert f"'self' 'sha256-{digest}'" == directives["script-src"]
        assert "'none'" == directives["default-src"] == directives["frame-ancestors"]
        assert not re.search(r"https?:|\*|unsafe-eval", policy)
        async with session.get("/") as answer:
            assert "sha256" not in answer.headers["Content-Security-Policy"]
            assert "unsafe" not in answer.headers["Content-Security-Policy"]


async def test_a_browser_asks_before_it_shows_an_old_page(built: Path) -> None:
    """Pages are revalidated and sent if changed; a file named by its content is cached as immutable."""
    async with served(built) as (_, session):
        async with session.get("/manual/index.html") as answer:
            assert "private, no-cache" == answer.headers["Cache-Control"]
            tag = answer.headers["ETag"]
        async with session.get("/manual/index.html", headers={"If-None-Match": tag}) as answer:
            assert (304, b"") == (answer.status, await answer.read())
        (built / "index.html").write_text("another version")
        async with session.get("/manual/index.html", headers={"If-None-Match": tag}) as answer:
            assert (200, "another version") == (answer.status, await answer.text())
        async with session.get("/manual/assets/app.0123abcd.min.js") as answer:
            assert "immutable" in answer.headers["Cache-Control"]
        async with session.get("/manual/assets/app.js") as answer:
            assert "immutable" not in answer.headers["Cache-Control"]


@pytest.mark.slow
async def test_it_is_shown_to_whom_the_status_page_is(built: Path) -> None:
    """Without the password there is a 401 or the log-in form, and nothing for a foreign host name."""
    password = "correct horse"
    async with served(built, hash_password(password)) as (_, session):
        for name in ("", *FILES, "nowhere.html"):
            async with session.get(f"/manual/{name}") as answer:
                assert 401 == answer.status, name
                assert "manual</html>" not in await answer.text()
        async with session.get("/manual/how-to/plc.html", headers={"Accept": "text/html"}) as answer:
            assert "/login" == answer.url.path
        own = {"Origin": str(session._base_url).rstrip("/")}  # noqa: SLF001  (what the browser would send)
        await (await session.post("/login", data={"password": password}, headers=own)).read()
        async with session.get("/manual/how-to/plc.html") as answer:
            assert FILES["how-to/plc.html"] == await answer.text()
    async with served(built) as (_, session):
        async with session.get("/manual/", headers={"Host": "evil.example"}) as answer:
            assert 421 == answer.status
        async with session.post("/manual/", data=b"x") as answer:
            assert 405 == answer.status


async def test_where_it_was_not_built_the_page_says_how(tmp_path: Path) -> None:
    """A 404 says how to build it, and it is shown without a restart once built."""
    async with served(tmp_path / "manual") as (_, session):
        for path in ("/manual/", "/manual/how-to/plc.html"):
            async with session.get(path) as answer:
                assert 404 == answer.status
                assert "tools/manual" in await answer.text()
        (tmp_path / "manual").mkdir()
        (tmp_path / "manual" / "index.html").write_text("built")
        async with session.get("/manual/") as answer:
            assert (200, "built") == (answer.status, await answer.text())


async def test_the_status_page_leads_to_it(built: Path) -> None:
    """The status page has a link to it that works without scripts."""
    async with served(built) as (_, session), session.get("/") as answer:
        assert '<a href="/manual/">' in await answer.text()
