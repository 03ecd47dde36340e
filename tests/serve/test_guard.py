"""Who is answered: a table of requests that get 403, and the headers of every answer."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest
from tornado.httpclient import HTTPClientError

from rotorsim.serve.session import Session
from rotorsim.serve.store import DiagramFile
from tests.serve.serving import TOKEN, Served, opened, served, talk

PATHS = ("/", "/static/vendor/README", "/api/palette", "/api/gallery", "/api/figure/1/overview", "/nothing")


@pytest.fixture
def at(mine: Path) -> Iterator[Served]:
    with served(Session(mine.parent, DiagramFile(mine))) as found:
        yield found


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize(
    ("headers", "why"),
    [
        ({"Host": "evil.example"}, "Host is 'evil.example', not 127.0.0.1 or localhost"),
        ({"Host": "evil.example:{port}"}, "Host is 'evil.example:{port}', not 127.0.0.1 or localhost"),
        ({"Host": "127.0.0.1.evil.example:{port}"}, "Host is '127.0.0.1.evil.example:{port}', not"),
        ({"Host": "localhost.:{port}"}, "Host is 'localhost.:{port}', not"),
        ({"Host": ""}, "Host is '', not 127.0.0.1 or localhost"),
        ({"Origin": "http://evil.example"}, "Origin is 'http://evil.example', not this server"),
        ({"Origin": "https://127.0.0.1:{port}"}, "Origin is 'https://127.0.0.1:{port}', not this server"),
        ({"Origin": "http://127.0.0.1:1"}, "Origin is 'http://127.0.0.1:1', not this server"),
        ({"Origin": "null"}, "Origin is 'null', not this server"),
        ({"Sec_Fetch_Site": "cross-site"}, "it is a cross-site request"),
        ({"Sec_Fetch_Site": "same-site"}, "it is a same-site request"),
    ],
)
def test_foreign_requests_get_403(at: Served, path: str, headers: dict[str, str], why: str) -> None:
    """With the token, too: a page elsewhere that knows it is still a page elsewhere."""
    given = {name: value.format(port=at.port) for name, value in headers.items()}
    answer, body = at.ask(path, X_Rotorsim_Token=TOKEN, **given)
    assert answer.status == 403
    assert body.decode().startswith(f"forbidden: {why.format(port=at.port)}")


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "OPTIONS"])
def test_other_methods_get_403(at: Served, path: str, method: str) -> None:
    answer, body = at.ask(path, method, X_Rotorsim_Token=TOKEN)
    assert (answer.status, body.decode()) == (403, f"forbidden: method {method} is not served\n")


@pytest.mark.parametrize("path", [path for path in PATHS if path.startswith("/api/")])
@pytest.mark.parametrize("token", [{}, {"X_Rotorsim_Token": ""}, {"X_Rotorsim_Token": TOKEN[:-1]}])
def test_the_api_needs_the_token(at: Served, path: str, token: dict[str, str]) -> None:
    answer, body = at.ask(path, **token)
    expected = "forbidden: X-Rotorsim-Token is missing or wrong: open the address that rotorsim serve printed\n"
    assert (answer.status, body.decode()) == (403, expected)


@pytest.mark.parametrize("path", [*PATHS, "/static/../../serve/guard.py", "/static/%2e%2e/guard.py", "/etc/passwd"])
def test_every_answer_has_the_headers(at: Served, path: str) -> None:
    answer, body = at.ask(path, X_Rotorsim_Token=TOKEN)
    assert answer.status in (200, 403, 404)
    policy = answer.headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; script-src 'self'; ")
    assert "unsafe" not in policy
    assert "frame-ancestors 'none'" in policy
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    assert answer.headers["X-Frame-Options"] == "DENY"
    assert answer.headers["Referrer-Policy"] == "no-referrer"
    assert answer.headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert answer.headers["Cross-Origin-Opener-Policy"] == "same-origin"
    assert b"def " not in body


def test_requests_of_this_server_are_answered(at: Served) -> None:
    for host in (at.host, f"localhost:{at.port}", "localhost:9999", f"[::1]:{at.port}"):  # 9999: a tunnel
        for more in ({}, {"Origin": f"http://{host}", "Sec_Fetch_Site": "same-origin"}, {"Sec_Fetch_Site": "none"}):
            answer, body = at.ask("/api/gallery", Host=host, X_Rotorsim_Token=TOKEN, **more)
            assert answer.status == 200, (host, more, body)


@pytest.mark.parametrize(
    "headers", [{"Origin": "http://evil.example"}, {"Host": "evil.example"}, {"Sec-Fetch-Site": "cross-site"}]
)
def test_foreign_pages_get_no_live_connection(at: Served, headers: dict[str, str]) -> None:
    async def talking() -> None:
        with pytest.raises(HTTPClientError) as refused:
            await opened(at, **headers)
        assert refused.value.code == 403

    talk(talking)


def test_nothing_is_said_without_the_token(at: Served) -> None:
    async def talking() -> None:
        for token in ("", TOKEN[:-1], TOKEN + "x"):
            page = await opened(at, token)
            assert page.state == {}
            await asyncio.sleep(0)
            assert page.connection.close_code == 4403

    talk(talking)
