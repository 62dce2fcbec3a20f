"""The server of the page, for whoever has its token: on the loopback, or where it is asked for. It serves no files."""

from __future__ import annotations

import hmac
import secrets
import signal
import socket
from collections.abc import Callable
from typing import Any

import panel as pn
from bokeh.server.auth_provider import AuthProvider
from bokeh.server.server import Server
from tornado.ioloop import IOLoop
from tornado.web import RequestHandler

from jaxnh.exceptions import ArgumentError
from jaxnh.explorer.editor import EditorState
from jaxnh.explorer.opening import PageContent
from jaxnh.explorer.page import Page, Run
from jaxnh.explorer.page_style import HEAD, NARROW
from jaxnh.explorer.worker import Worker

LOOPBACK = ("127.0.0.1", "localhost")
"""Addresses that this machine alone reaches: all of its users, so that the page needs the token there too."""

_MESSAGE = 1 << 22  # bytes of a message from a browser, at most


class _Refusal(RequestHandler):
    """The answer to a request without a token."""

    def get(self) -> None:
        self.set_status(403)
        self.finish("This page needs the token that jaxnh explore has printed: ?token=...")


class TokenAuth(AuthProvider):
    """Admits requests with the token: once in the address, from then on in a cookie of this site."""

    def __init__(self, token: str, port: int) -> None:
        self._token, self._cookie = token, f"jaxnh_token_{port}"  # a browser gives cookies to all ports of a machine
        super().__init__()

    @property
    def get_user(self) -> Callable[[Any], Any]:
        """The user of a request: "user", or None where it has no token."""

        def known(handler: Any) -> str | None:
            given = handler.get_argument("token", None) or handler.get_cookie(self._cookie, "")
            if not hmac.compare_digest(given.encode(), self._token.encode()):
                return None
            if handler.get_cookie(self._cookie) != given and hasattr(handler, "_finished"):
                handler.set_cookie(self._cookie, given, httponly=True, samesite="Strict")
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


def make_server(
    opened: PageContent, worker: Worker, address: str, port: int, run: Run | None = None
) -> tuple[Server, str]:
    """The server, listening but not yet started, and the address of its page.

    Args:
        opened: what is shown.
        run: opens edited texts, which is done on the loopback alone.

    Raises:
        ArgumentError: the address cannot be used.
    """
    pn.extension(sizing_mode="fixed", notifications=False)
    token = secrets.token_urlsafe(24)
    names = [*LOOPBACK] if address in LOOPBACK else [address, socket.gethostname()]
    run = run if address in LOOPBACK else None

    def page() -> pn.viewable.Viewable:
        document = pn.state.curdoc
        assert document is not None
        document.template = HEAD  # pyright: ignore[reportAttributeAccessIssue] # blocks in place of Panel's own
        query = {key: values[0].decode() for key, values in pn.state.session_args.items() if key != "token"}
        holder = pn.Column(sizing_mode="stretch_width", css_classes=["whole"], stylesheets=[NARROW])
        pages: list[Page] = []

        def show(opened: PageContent, editor: EditorState | None) -> Page:
            for old in pages:
                old.end()
            pages[:] = [Page(opened, worker, document, {} if editor else query, reopen, editor, run)]
            holder.objects = [pages[0].layout()]
            return pages[0]

        def reopen(opened: PageContent, editor: EditorState) -> None:
            show(opened, editor).begin()

        show(opened, None)
        document.on_session_destroyed(lambda _: pages[0].end())
        pn.state.onload(lambda: pages[0].begin())
        return holder

    try:
        listening = _listen(address, port)
        port = listening[1]
        server = pn.io.server.get_server(
            {"/": page},
            port=port,
            address=address,
            websocket_origin=[f"{name}:{port}" for name in names],
            title="jaxnh explore",
            auth_provider=TokenAuth(token, port),
            websocket_max_message_size=_MESSAGE,
        )
    except OSError as error:
        raise ArgumentError("port", f"{address}:{port} cannot be listened on: {error.strerror}") from None
    return server, f"http://{address}:{port}/?token={token}"


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
