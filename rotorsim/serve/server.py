"""The server of the page: files of the page, the API, and the live connection, on this machine only."""

from __future__ import annotations

import asyncio
import json
import math
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib import resources
from threading import Event
from typing import Any

from tornado.httpserver import HTTPServer
from tornado.web import Application, StaticFileHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from rotorsim.errors import Problem, RotorsimError
from rotorsim.serve.guard import REPORT_HEADERS, Guarded, foreign, is_token
from rotorsim.serve.session import Session
from rotorsim.serve.view import problem_of_block

LOOKED_AT = 0.25  # s, between looks at the file
CHANGING = ("edit", "part")  # messages after which the state may be another
THREADS_END = 0.5  # s, that threads are given at the end
TOKEN_WITHIN = 10.0  # s, in which a page has to send its token
WRONG_TOKEN = 4403  # code with which a connection without the token is closed
LARGEST_MESSAGE = 25_000_000  # bytes: a diagram has 20 MB at most


def application(session: Session, token: str) -> Application:
    """Return the application of a session."""
    pages = Pages(session)
    static = str(resources.files("rotorsim.serve") / "static")
    return Application(
        [
            (r"/()", _Static, {"path": static, "default_filename": "index.html"}),
            (r"/static/(.*)", _Static, {"path": static}),
            (r"/api/live", _Live, {"pages": pages}),
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


class Pages:
    """The pages that are open, and the work that they have asked for; one piece of it at a time."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.open: set[_Live] = set()
        self.worker = ThreadPoolExecutor(1)
        self.drawer = ThreadPoolExecutor(1)
        self._shown = ""

    def tell_all(self) -> None:
        """Send every page the state, where it is not the one that they have."""
        text = _text(self.session.state())
        if text != self._shown:
            self._shown = text
            for page in list(self.open):
                page.send_message(text)

    def look(self) -> None:
        """Look whether the file was changed by hand, and tell the pages."""
        if self.session.file is not None and self.session.file.refresh():
            self.tell_all()

    def close(self) -> None:
        """Stop what runs, and end the threads."""
        for page in list(self.open):
            page.stop_all()
            page.close(1001)
        self.session.outcomes.close()
        self.worker.shutdown(wait=False, cancel_futures=True)
        self.drawer.shutdown(wait=False, cancel_futures=True)


def _text(data: Any) -> str:
    return json.dumps(_finite(data), ensure_ascii=False)


def _message(data: dict[str, Any]) -> str | bytes:
    """Return a message: as JSON, or with the numbers of a run behind it, which take a tenth of the time so.

    Then: length of the JSON (4 bytes, little-endian), JSON with spaces up to a multiple of 8, time (64 bit), rows.
    """
    if "values" not in data:
        return _text(data)
    time, rows = data["time"], data["values"]
    head = _text({**data, "time": len(time), "values": len(rows)}).encode()
    head += b" " * (-(len(head) + 4) % 8)
    return b"".join([len(head).to_bytes(4, "little"), head, time.tobytes(), *(row.tobytes() for row in rows)])


def _finite(value: Any) -> Any:
    """Return data without numbers that JSON cannot hold."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    return [_finite(one) for one in value] if isinstance(value, list | tuple) else value


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

    def answer(self, data: Any) -> None:
        """Send data as JSON."""
        self.set_header("Content-Type", "application/json; charset=utf-8")
        self.finish(_text(data))

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
        made: Callable[[], Any] = getattr(self.session, what)
        self.answer(made())


class _Picture(_Api):
    """The diagram as SVG."""

    def initialize(self, session: Session) -> None:
        self.session = session

    def get(self) -> None:
        self.send_picture(lambda: (self.session.picture().encode(), ".svg"))


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


class _Live(WebSocketHandler):
    """The live connection of a page: nothing is said or done before it has sent the token."""

    def initialize(self, pages: Pages) -> None:
        self.pages = pages
        self.known = False
        self.running: dict[Any, Callable[[], object]] = {}  # what stops it
        self.tasks: set[asyncio.Task[None]] = set()

    def check_origin(self, origin: str) -> bool:
        return not foreign(self.request)

    def prepare(self) -> None:
        if foreign(self.request):
            self.set_status(403)
            self.finish("forbidden\n")

    def open(self, *arguments: str, **named: str) -> None:
        asyncio.get_running_loop().call_later(TOKEN_WITHIN, self._refuse_silence)

    def _refuse_silence(self) -> None:
        if not self.known:
            self.close(WRONG_TOKEN, "no token")

    def on_message(self, message: str | bytes) -> None:
        try:
            data = json.loads(message)
        except ValueError:
            data = None
        if not self.known:
            if not isinstance(data, dict) or not is_token(data.get("token"), self.settings["token"]):
                self.close(WRONG_TOKEN, "wrong token")
                return
            self.known = True
            self.pages.look()
            self.pages.open.add(self)
            self.send(self.pages.session.state())
        elif isinstance(data, dict) and isinstance(data.get("id"), int):
            self._answer(data)

    def _answer(self, data: dict[str, Any]) -> None:
        if data.get("kind") == "cancel":
            if stop := self.running.get(data.get("id")):
                stop()
        elif data.get("kind") in ("run", "analyse", "find"):
            work = self._find(data) if data.get("kind") == "find" else self._work(data)
            task = asyncio.ensure_future(work)  # the next message may be to stop it
            if data.get("kind") == "find":
                self.running[data.get("id")] = task.cancel
            self.tasks.add(task)
            task.add_done_callback(self.tasks.discard)
        else:
            try:
                found = self.pages.session.answer(data)
            except Exception as error:  # the page must not wait for ever
                found = {**self.pages.session.refused(_unexpected(error)), "id": data.get("id")}
            self.send(found)
            if data.get("kind") in CHANGING:
                self.pages.tell_all()

    async def _work(self, data: dict[str, Any]) -> None:
        self.pages.look()  # what runs is what stands in the file now
        number, loop, stopped = data.get("id"), asyncio.get_running_loop(), Event()
        self.running[number] = stopped.set

        def progress(share: float) -> None:
            loop.call_soon_threadsafe(self.send, {"kind": "progress", "id": number, "share": share})

        def made() -> str | bytes:
            try:
                found = self.pages.session.work(data, stopped, _seldom(progress))
            except RotorsimError as error:
                found = self.pages.session.refused(error)
            except Exception as error:  # the page must not wait for ever
                found = self.pages.session.refused(_unexpected(error))
            return _message({**found, "id": number})

        try:
            self.send_message(await loop.run_in_executor(self.pages.worker, made))
        finally:
            self.running.pop(number, None)

    async def _find(self, data: dict[str, Any]) -> None:
        self.pages.look()
        number = data.get("id")

        def progress(share: float, text: str) -> None:
            self.send({"kind": "progress", "id": number, "share": share, "text": text})

        try:
            found = await self.pages.session.find(data, progress)
        except RotorsimError as error:
            found = self.pages.session.refused(error)
        except asyncio.CancelledError:
            found = self.pages.session.refused(RotorsimError(Problem("stopped", str(data.get("verb")))))
        except Exception as error:  # the page must not wait for ever
            found = self.pages.session.refused(_unexpected(error))
        self.running.pop(number, None)
        self.send({**found, "id": number})

    def stop_all(self) -> None:
        """Stop what this page has asked for."""
        for stop in list(self.running.values()):
            stop()

    def on_close(self) -> None:
        self.pages.open.discard(self)
        self.stop_all()

    def send(self, data: Any) -> None:
        """Send data to the page, if it is still there."""
        self.send_message(_text(data))

    def send_message(self, message: str | bytes) -> None:
        """Send a message to the page, if it is still there."""
        try:
            self.write_message(message, binary=isinstance(message, bytes))
        except WebSocketClosedError:
            self.on_close()


def _unexpected(error: Exception) -> RotorsimError:
    """Return what is said of an error that is rotorsim's own."""
    what = f"{type(error).__name__}: {str(error)[:300]}"
    return RotorsimError(Problem(what, "rotorsim", hint="this is a mistake of rotorsim, please report it"))


def _seldom(progress: Callable[[float], None]) -> Callable[[float], None]:
    """Return a progress that is told at most 50 times."""
    told = [0.0]

    def tell(share: float) -> None:
        if share >= told[0] + 0.02:
            told[0] = share
            progress(share)

    return tell


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
