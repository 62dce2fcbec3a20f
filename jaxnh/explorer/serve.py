"""The server of the page: on the loopback alone, or with a token. It serves no files."""

from __future__ import annotations

import hmac
import secrets
import signal
import socket
from collections.abc import Callable, Mapping
from typing import Any

import panel as pn
from bokeh.server.auth_provider import AuthProvider
from bokeh.server.server import Server
from tornado.ioloop import IOLoop
from tornado.web import RequestHandler

from jaxnh.exceptions import ArgumentError
from jaxnh.explorer.page import Page
from jaxnh.explorer.source import PictureSource
from jaxnh.explorer.worker import Worker

LOOPBACK = ("127.0.0.1", "localhost")
"""Addresses that this machine alone reaches."""

_COOKIE = "jaxnh_token"


class _Refusal(RequestHandler):
    """The answer to a request without a token."""

    def get(self) -> None:
        self.set_status(403)
        self.finish("This page needs the token that jaxnh explore has printed: ?token=...")


class TokenAuth(AuthProvider):
    """Admits requests with the token: once in the address, from then on in a cookie of this site."""

    def __init__(self, token: str) -> None:
        self._token = token
        super().__init__()

    @property
    def get_user(self) -> Callable[[Any], Any]:
        """The user of a request: "user", or None where it has no token."""

        def known(handler: Any) -> str | None:
            given = handler.get_argument("token", None) or handler.get_cookie(_COOKIE, "")
            if not hmac.compare_digest(given.encode(), self._token.encode()):
                return None
            if handler.get_cookie(_COOKIE) != given and hasattr(handler, "_finished"):
                handler.set_cookie(_COOKIE, given, httponly=True, samesite="Strict")
            return "user"

        return known

    @property
    def get_user_async(self) -> None:
        """There is none."""
        return None

    @property
    def login_url(self) -> str:
        """Return the address that other requests are sent to."""
        return "/refused"

    @property
    def get_login_url(self) -> None:
        """There is none."""
        return None

    @property
    def login_handler(self) -> type[RequestHandler]:
        """The handler of that address."""
        return _Refusal

    @property
    def logout_url(self) -> None:
        """There is none."""
        return None

    @property
    def logout_handler(self) -> None:
        """There is none."""
        return None


def make_server(source: PictureSource, worker: Worker, address: str, port: int) -> tuple[Server, str]:
    """The server, listening but not yet started, and the address of its page.

    Raises:
        ArgumentError: the address cannot be used.
    """
    pn.extension(sizing_mode="fixed", notifications=False)
    token = "" if address in LOOPBACK else secrets.token_urlsafe(24)
    names = [address] if address in LOOPBACK else [address, socket.gethostname()]

    def page() -> pn.viewable.Viewable:
        document = pn.state.curdoc
        assert document is not None
        query: Mapping[str, str] = {key: values[0].decode() for key, values in pn.state.session_args.items()}
        made = Page(source, worker, document, query)
        document.on_session_destroyed(lambda _: made.end())
        pn.state.onload(made.begin)
        return made.layout()

    try:
        listening = _listen(address, port)
        port = listening[1]
        options: dict[str, Any] = {"auth_provider": TokenAuth(token)} if token else {}
        server = pn.io.server.get_server(
            {"/": page},
            port=port,
            address=address,
            websocket_origin=[f"{name}:{port}" for name in dict.fromkeys([*names, *(LOOPBACK if not token else ())])],
            title="jaxnh explore",
            **options,
        )
    except OSError as error:
        raise ArgumentError("port", f"{address}:{port} cannot be listened on: {error.strerror}") from None
    return server, f"http://{address}:{port}/{f'?token={token}' if token else ''}"


def _listen(address: str, port: int) -> tuple[str, int]:
    """An address that can be listened on; a free port in place of 0."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    with socket.socket(family) as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        trial.bind((address, port))
        return address, trial.getsockname()[1]


def run(server: Server, worker: Worker) -> None:
    """Serve until SIGINT or SIGTERM."""
    loop: IOLoop = server.io_loop
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: loop.add_callback_from_signal(loop.stop))
    server.start()
    try:
        loop.start()
    finally:
        worker.stop()
        server.stop()
