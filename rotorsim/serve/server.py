"""The server of the page: files of the page, the API, and the live connection, on this machine only."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from importlib import resources
from typing import Any

from tornado.httpserver import HTTPServer
from tornado.web import Application, StaticFileHandler

from rotorsim.errors import Problem, RotorsimError
from rotorsim.serve.guard import REPORT_HEADERS, Guarded, foreign, is_token
from rotorsim.serve.live import Live, Pages, as_text
from rotorsim.serve.session import Session
from rotorsim.serve.view import problem_of_block

LOOKED_AT = 0.25  # s, between looks at the file
THREADS_END = 0.5  # s, that threads are given at the end
LARGEST_MESSAGE = 25_000_000  # bytes: a diagram has 20 MB at most


def application(session: Session, token: str) -> Application:
    """Return the application of a session."""
    pages = Pages(session)
    static = str(resources.files("rotorsim.serve") / "static")
    return Application(
        [
            (r"/()", _Static, {"path": static, "default_filename": "index.html"}),
            (r"/static/(.*)", _Static, {"path": static}),
            (r"/api/live", Live, {"pages": pages}),
            (r"/api/(palette|gallery|recordings)", _Lists, {"session": session}),
            (r"/api/outcome/([0-9]{1,9})/([A-Za-z0-9_.-]{1,80})", _OutcomeFile, {"session": session}),
            (r"/report/([0-9]{1,9})/([A-Za-z0-9_-]{1,80})", _Report, {"session": session}),
            (r"/api/picture", _Picture, {"session": session}),
            (r"/api/copy", _Copy, {"pages": pages}),
            (r"/api/figure/([0-9]{1,9})/([a-z]{1,20})", _Figure, {"pages": pages}),
        ],
        default_handler_class=_Nothing,
        token=token,
        pages=pages,
        websocket_max_message_size=LARGEST_MESSAGE,
        log_function=lambda handler: None,
    )


class _Static(Guarded, StaticFileHandler):
    """The files of the page."""


class _Nothing(Guarded):
    """Everything that is not served."""

    def prepare(self) -> None:
        why = foreign(self.request)
        if why:
            self.refuse(why)
            return
        self.set_status(404)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish("there is nothing here\n")


class _Api(Guarded):
    needs_token = True

    def asked(self, session: Session) -> Session:
        """Return the session of the sub-diagram that a page shows, that of the file where it is none any more."""
        try:
            return session.inner(self.get_query_argument("part", ""))
        except RotorsimError:
            return session

    def answer(self, data: Any) -> None:
        """Send data as JSON."""
        self.set_header("Content-Type", "application/json; charset=utf-8")
        self.finish(as_text(data))

    def send_picture(self, make: Callable[[], tuple[bytes, str]]) -> None:
        """Send a picture that is made here, with its suffix; 404 with the reason where it cannot be."""
        try:
            content, suffix = make()
        except RotorsimError as error:
            self.set_status(404)
            self.answer({"kind": "refused", "problems": [problem_of_block(one, ()) for one in error.problems]})
            return
        self.set_header("Content-Type", "image/svg+xml" if suffix == ".svg" else "image/png")
        self.finish(content)


class _Lists(_Api):
    """Types of blocks, shipped diagrams, and recordings: methods of the session."""

    def initialize(self, session: Session) -> None:
        self.session = session

    def get(self, what: str) -> None:
        made: Callable[[], Any] = getattr(self.asked(self.session), what)
        self.answer(made())


class _Picture(_Api):
    """The diagram as SVG."""

    def initialize(self, session: Session) -> None:
        self.session = session

    def get(self) -> None:
        self.send_picture(lambda: (self.asked(self.session).picture().encode(), ".svg"))


class _OutcomeFile(_Api):
    """Figures that a verb has drawn."""

    def initialize(self, session: Session) -> None:
        self.session = session

    def get(self, number: str, name: str) -> None:
        def read() -> tuple[bytes, str]:
            found = self.session.outcomes.kept.get(int(number))
            if found is None or name.endswith(".html"):
                raise RotorsimError(Problem("there is no such file", name))
            file = found.file(name)
            return file.read_bytes(), file.suffix

        self.send_picture(read)


class _Report(Guarded):
    """A report in a frame of the page: a key of its own opens it, since a frame sends no token; it may run nothing."""

    def initialize(self, session: Session) -> None:
        self.session = session

    def get(self, number: str, key: str) -> None:
        found = self.session.outcomes.kept.get(int(number))
        if found is None or not is_token(key, found.key):
            self.refuse("this report has another key")
            return
        for name, value in REPORT_HEADERS.items():
            self.set_header(name, value)
        self.finish(found.file("report.html").read_bytes())


class _Copy(_Api):
    """Copies a shipped diagram, and opens it."""

    def initialize(self, pages: Pages) -> None:
        self.pages = pages

    def post(self) -> None:
        try:
            body = json.loads(self.request.body or b"{}")
            data = self.pages.session.copy(body.get("name") if isinstance(body, dict) else None)
        except (ValueError, RotorsimError) as error:
            self.set_status(400)
            self.answer(self.pages.session.refused(error) if isinstance(error, RotorsimError) else {"kind": "refused"})
            return
        self.pages.tell_all()
        self.answer(data)


class _Figure(_Api):
    """Figures of runs, as SVG."""

    def initialize(self, pages: Pages) -> None:
        self.pages = pages

    async def get(self, number: str, kind: str) -> None:
        draw = self.pages.session.runs.figure
        try:
            made = await asyncio.get_running_loop().run_in_executor(self.pages.drawer, draw, int(number), kind)
        except RotorsimError as error:
            self.set_status(404)
            self.answer(self.pages.session.refused(error))
            return
        self.set_header("Content-Type", "image/svg+xml")
        self.finish(made)


async def serve(session: Session, token: str, port: int, ready: Callable[[int], None]) -> None:
    """Serve a session on 127.0.0.1 until SIGINT or SIGTERM; ready is called with the port (0: one that is free)."""
    app = application(session, token)
    pages: Pages = app.settings["pages"]
    server = HTTPServer(app, max_buffer_size=LARGEST_MESSAGE)
    listening = socket.create_server(("127.0.0.1", port))
    listening.setblocking(False)
    server.add_socket(listening)
    done, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, done.set)
    ready(listening.getsockname()[1])

    async def watch() -> None:
        while not done.is_set():
            try:
                pages.look()
            except Exception as error:  # the next look may be better
                print(f"rotorsim serve: {type(error).__name__}: {error}", file=sys.stderr)
            await asyncio.sleep(LOOKED_AT)

    watching = asyncio.ensure_future(watch())
    await done.wait()
    watching.cancel()
    pages.close()
    server.stop()
    await server.close_all_connections()


def end_threads() -> None:
    """End the process where a thread still computes what cannot be stopped: nobody waits for it any more."""
    begun = time.monotonic()
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and not thread.daemon:
            thread.join(max(THREADS_END - (time.monotonic() - begun), 0.0))
            if thread.is_alive():
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(0)
