"""Who may talk to the server: pages of this machine that know the token; everything else gets 403."""

from __future__ import annotations

import hmac
import secrets
from urllib.parse import urlsplit

from tornado.httputil import HTTPServerRequest
from tornado.web import RequestHandler

HOSTS = ("127.0.0.1", "localhost", "[::1]")  # a foreign name that points here (DNS rebinding) is none of these
METHODS = ("GET", "HEAD", "POST")
OWN_SITE = ("same-origin", "none")  # none: typed into the address bar
TOKEN_HEADER = "X-Rotorsim-Token"
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


REPORT_HEADERS = {  # of a report in a frame: figures and style of its own, and nothing that runs
    "Content-Security-Policy": "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'self'",
    "X-Frame-Options": "SAMEORIGIN",
}


def new_token() -> str:
    """Return a token that nobody guesses, 256 bit."""
    return secrets.token_urlsafe(32)


def is_token(given: object, token: str) -> bool:
    """Return whether a text is the token, in a time that does not tell how much of it is right."""
    return isinstance(given, str) and hmac.compare_digest(given.encode(), token.encode())


def foreign(request: HTTPServerRequest) -> str:
    """Return why a request does not come from a page of this server, "" if it does.

    The port may be another one than the server's own: that of a tunnel (ssh -L).
    """
    host = request.headers.get("Host", "")
    name, _, port = host.rpartition(":") if not host.endswith("]") else (host, "", "")
    if (name or host) not in HOSTS or (port and not port.isdigit()):
        return f"Host is '{host[:80]}', not 127.0.0.1 or localhost"
    origin = request.headers.get("Origin")
    if origin is not None and (urlsplit(origin).scheme != "http" or urlsplit(origin).netloc != host):
        return f"Origin is '{origin[:80]}', not this server"
    site = request.headers.get("Sec-Fetch-Site")
    if site is not None and site not in OWN_SITE:
        return f"it is a {site[:40]} request"
    if request.method not in METHODS:
        return f"method {str(request.method)[:20]} is not served"
    return ""


class Guarded(RequestHandler):
    """A handler that refuses foreign requests, and below /api/ those without the token."""

    needs_token = False

    def set_default_headers(self) -> None:
        """Send what keeps a page from loading or running anything foreign."""
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        """Refuse a request with 403 and the reason."""
        why = foreign(self.request)
        if not why and self.needs_token:
            known = is_token(self.request.headers.get(TOKEN_HEADER), self.settings["token"])
            why = "" if known else f"{TOKEN_HEADER} is missing or wrong: open the address that rotorsim serve printed"
        if why:
            self.refuse(why)

    def refuse(self, why: str) -> None:
        """Answer 403 with a reason, as plain text."""
        self.set_status(403)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"forbidden: {why}\n")

    def check_xsrf_cookie(self) -> None:
        """Do nothing: there are no cookies; the token in a header is what a foreign page cannot send."""
