"""A viewer of a status page: receives each event, and fetches the pictures of each cycle, as the page does.

python tools/pageviewer.py PORT [NAME PASSWORD]; says "looking" after the first pictures, and runs until it
is stopped.
"""

from __future__ import annotations

import asyncio
import json
import sys
from typing import Any

import aiohttp


async def look(port: int, *who: str) -> None:
    """View the page for ever. who : name and password, if the page asks for them."""
    said = False
    jar = aiohttp.CookieJar(unsafe=True)  # cookies of an IP address
    origin = f"http://127.0.0.1:{port}"
    for_ever = aiohttp.ClientTimeout(total=None)  # otherwise a stream of events ends after five minutes
    headers = {"Origin": origin}
    async with aiohttp.ClientSession(origin, cookie_jar=jar, headers=headers, timeout=for_ever) as session:
        if who:
            form = dict(zip(("name", "password"), who, strict=True))
            async with session.post("/login", data=form, allow_redirects=False) as answer:
                answer.raise_for_status()
        async with session.get("/events") as events:
            async for line in events.content:
                if line.startswith(b"data: "):
                    await fetch_pictures(session, json.loads(line[6:]))
                    if not said:
                        print("looking", flush=True)
                    said = True


async def fetch_pictures(session: aiohttp.ClientSession, status: dict[str, Any]) -> int:
    """Size of both pictures and of the thumbnail; the cycle may no longer be in memory."""
    if not status["picture"]:
        return 0
    size = 0
    for name in ("left", "right", "left/small"):
        async with session.get(f"/picture/{status['picture']['cycle']}/{name}") as answer:
            size += len(await answer.read()) if answer.status == 200 else 0
    return size


if __name__ == "__main__":
    asyncio.run(look(int(sys.argv[1]), *sys.argv[2:]))
