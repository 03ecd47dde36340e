"""The live connection of a page: messages, their answers, and the state after every change."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from tornado.websocket import WebSocketClosedError, WebSocketHandler

from rotorsim.errors import Problem, RotorsimError
from rotorsim.serve.guard import foreign, is_token
from rotorsim.serve.job import Job
from rotorsim.serve.session import Session

CHANGING = ("edit", "part")  # messages after which the state may be another
WORKING = ("run", "cosim", "measured", "analyse", "find")  # messages that take their time
TOKEN_WITHIN = 10.0  # s, in which a page has to send its token
WRONG_TOKEN = 4403  # code with which a connection without the token is closed


class Pages:
    """The pages that are open, and the work that they have asked for; one piece of it at a time."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.open: set[Live] = set()
        self.worker = ThreadPoolExecutor(1)
        self.drawer = ThreadPoolExecutor(1)

    def tell_all(self) -> None:
        """Send every page the state of what it shows, where it is not the one that it has."""
        texts: dict[int, str] = {}
        for page in list(self.open):
            key = id(page.session)
            if key not in texts:
                texts[key] = as_text(page.session.state())
            page.show(texts[key])

    def look(self) -> None:
        """Look whether a file was changed by hand, and tell the pages."""
        if self.session.refresh():
            self.tell_all()

    def close(self) -> None:
        """Stop what runs, and end the threads."""
        for page in list(self.open):
            page.stop_all()
            page.close(1001)
        self.session.outcomes.close()
        self.worker.shutdown(wait=False, cancel_futures=True)
        self.drawer.shutdown(wait=False, cancel_futures=True)


def as_text(data: Any) -> str:
    """Return data as JSON; numbers that it cannot hold are null."""
    return json.dumps(_finite(data), ensure_ascii=False)


def _message(data: dict[str, Any]) -> str | bytes:
    """Return a message: as JSON, or with the numbers of a run behind it, which take a tenth of the time so.

    Then: length of the JSON (4 bytes, little-endian), JSON with spaces up to a multiple of 8, time (64 bit), rows.
    """
    if "values" not in data:
        return as_text(data)
    time, rows = data["time"], data["values"]
    head = as_text({**data, "time": len(time), "values": len(rows)}).encode()
    head += b" " * (-(len(head) + 4) % 8)
    return b"".join([len(head).to_bytes(4, "little"), head, time.tobytes(), *(row.tobytes() for row in rows)])


def _finite(value: Any) -> Any:
    """Return data without numbers that JSON cannot hold."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    return [_finite(one) for one in value] if isinstance(value, list | tuple) else value


class Live(WebSocketHandler):
    """The live connection of a page: nothing is said or done before it has sent the token."""

    def initialize(self, pages: Pages) -> None:
        self.pages = pages
        self.session = pages.session
        self.known = False
        self.shown = ""
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
            self.enter(data.get("part"))
        elif isinstance(data, dict) and isinstance(data.get("id"), int):
            self._answer(data)

    def _answer(self, data: dict[str, Any]) -> None:
        if data.get("kind") == "enter":
            self.send({**self.enter(data.get("part")), "id": data.get("id")})
        elif data.get("kind") == "cancel":
            if stop := self.running.get(data.get("id")):
                stop()
        elif data.get("kind") in WORKING:
            work = self._find(data) if data.get("kind") == "find" else self._work(data)
            task = asyncio.ensure_future(work)  # the next message may be to stop it
            if data.get("kind") == "find":
                self.running[data.get("id")] = task.cancel
            self.tasks.add(task)
            task.add_done_callback(self.tasks.discard)
        else:
            try:
                found = self.session.answer(data)
            except Exception as error:  # the page must not wait for ever
                found = {**self.session.refused(_unexpected(error)), "id": data.get("id")}
            self.send(found)
            if data.get("kind") in CHANGING:
                self.pages.tell_all()

    async def _work(self, data: dict[str, Any]) -> None:
        self.pages.look()  # what runs is what stands in the file now
        number, loop, job = data.get("id"), asyncio.get_running_loop(), Job()
        session = self.session  # the page may enter another meanwhile
        self.running[number] = job.stop

        def progress(share: float) -> None:
            loop.call_soon_threadsafe(self.send, {"kind": "progress", "id": number, "share": share})

        def made() -> str | bytes:
            try:
                found = job.do(lambda: session.work(data, _seldom(progress)))
            except RotorsimError as error:
                found = session.refused(error)
            except Exception as error:  # the page must not wait for ever
                found = session.refused(_unexpected(error))
            return _message({**found, "id": number})

        try:
            self.send_message(await loop.run_in_executor(self.pages.worker, made))
        finally:
            self.running.pop(number, None)

    async def _find(self, data: dict[str, Any]) -> None:
        self.pages.look()
        number, session = data.get("id"), self.session

        def progress(share: float, text: str) -> None:
            self.send({"kind": "progress", "id": number, "share": share, "text": text})

        try:
            found = await session.find(data, progress)
        except RotorsimError as error:
            found = session.refused(error)
        except asyncio.CancelledError:
            found = session.refused(RotorsimError(Problem("stopped", str(data.get("verb")))))
        except Exception as error:  # the page must not wait for ever
            found = session.refused(_unexpected(error))
        self.running.pop(number, None)
        self.send({**found, "id": number})

    def enter(self, part: Any) -> dict[str, Any]:
        """Show the page the file of a sub-diagram, of the diagram itself where there is none of this name."""
        found: dict[str, Any] = {"kind": "entered"}
        try:
            self.session = self.pages.session.inner(part if isinstance(part, str) else "")
        except RotorsimError as error:
            self.session, found = self.pages.session, self.pages.session.refused(error)
        self.show(as_text(self.session.state()))
        return found

    def show(self, state: str) -> None:
        """Send the state, where it is not the one that the page has."""
        if state != self.shown:
            self.shown = state
            self.send_message(state)

    def stop_all(self) -> None:
        """Stop what this page has asked for."""
        for stop in list(self.running.values()):
            stop()

    def on_close(self) -> None:
        self.pages.open.discard(self)
        self.stop_all()

    def send(self, data: Any) -> None:
        """Send data to the page, if it is still there."""
        self.send_message(as_text(data))

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
