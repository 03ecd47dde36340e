"""A server in a thread of this process, and a client of its live connection."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPResponse
from typing import Any

import numpy as np
from tornado.httpclient import HTTPRequest
from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.websocket import WebSocketClientConnection, websocket_connect

from rotorsim.serve.live import Pages
from rotorsim.serve.server import LOOKED_AT, application
from rotorsim.serve.session import Session

TOKEN = "token-of-the-tests"
OPEN: list[Page] = []


@dataclass
class Served:
    """Where a session is served."""

    port: int
    session: Session

    @property
    def host(self) -> str:
        return f"127.0.0.1:{self.port}"

    def ask(self, path: str, method: str = "GET", body: str = "", **headers: str) -> tuple[HTTPResponse, bytes]:
        """Return the answer to a request as it is sent, Host and all."""
        connection = HTTPConnection("127.0.0.1", self.port, timeout=20)
        connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
        names = {"Host": self.host, "Content-Length": str(len(body))} | {
            name.replace("_", "-"): value for name, value in headers.items()
        }
        for name, value in names.items():
            connection.putheader(name, value)
        connection.endheaders(body.encode())
        answer = connection.getresponse()
        body = answer.read()
        connection.close()
        return answer, body


@contextmanager
def served(session: Session) -> Iterator[Served]:
    """Serve a session on a free port until the block ends."""
    started, ended, found = threading.Event(), asyncio.Event(), {}

    async def run() -> None:
        app = application(session, TOKEN)
        pages: Pages = app.settings["pages"]
        server = HTTPServer(app)
        sockets = bind_sockets(0, "127.0.0.1")
        server.add_sockets(sockets)
        found.update(port=sockets[0].getsockname()[1], loop=asyncio.get_running_loop())
        started.set()
        while not ended.is_set():
            pages.look()
            await asyncio.sleep(LOOKED_AT / 5)
        pages.close()
        server.stop()
        await server.close_all_connections()

    thread = threading.Thread(target=lambda: asyncio.run(run()))
    thread.start()
    assert started.wait(20)
    try:
        yield Served(found["port"], session)
    finally:
        found["loop"].call_soon_threadsafe(ended.set)
        thread.join(20)
        assert not thread.is_alive()


def unpacked(message: bytes) -> Any:
    """Return a message with numbers: length of the JSON, JSON, time (64 bit), rows (32 bit)."""
    length = int.from_bytes(message[:4], "little")
    data = json.loads(message[4 : 4 + length])
    n, count, first = data["time"], data["values"], 4 + length
    data["time"] = np.frombuffer(message, "<f8", n, first)
    data["values"] = np.frombuffer(message, "<f4", n * count, first + 8 * n).reshape(count, n)
    return data


class Page:
    """A page that is open."""

    def __init__(self, connection: WebSocketClientConnection) -> None:
        self.connection, self.count, self.state = connection, 0, {}

    async def next(self) -> Any:
        """Return the next message; None when the connection is closed."""
        text = await asyncio.wait_for(self.connection.read_message(), 30)
        return None if text is None else json.loads(text) if isinstance(text, str) else unpacked(text)

    async def ask(self, **message: Any) -> Any:
        """Return the answer to a message; states that come before it are kept."""
        self.count += 1
        await self.connection.write_message(json.dumps({"id": self.count, **message}))
        while True:
            found = await self.next()
            if found is None or (found.get("id") == self.count and found["kind"] != "progress"):
                return found
            if found["kind"] == "state":
                self.state = found

    async def edit(self, *operations: dict[str, Any], **more: Any) -> Any:
        """Return the answer to an edit of the state that the page has."""
        return await self.ask(
            kind="edit", base=more.pop("base", self.state["sha"]), operations=list(operations), **more
        )


async def opened(at: Served, token: str = TOKEN, part: str = "", **headers: str) -> Page:
    """Return a page that has sent its token, with the first state."""
    named = {"Origin": f"http://{at.host}"} | headers
    request = HTTPRequest(f"ws://{at.host}/api/live", headers=named)
    page = Page(await websocket_connect(request, max_message_size=50_000_000))
    await page.connection.write_message(json.dumps({"token": token, "part": part}))
    first = await page.next()
    page.state = first or {}
    OPEN.append(page)
    return page


def talk(talking: Callable[[], Coroutine[Any, Any, None]]) -> None:
    """Run a conversation; its pages are closed then."""

    async def run() -> None:
        try:
            await talking()
        finally:
            for page in OPEN:
                page.connection.close()
            while OPEN:
                last = OPEN.pop()
                while last.state and last.connection.close_code is None and await last.next() is not None:
                    pass
            await asyncio.sleep(0.02)

    asyncio.run(run())
