"""An HTTP server of the view's page, for browsers of this computer alone."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
from collections.abc import AsyncIterator, Iterator
from contextlib import closing, contextmanager

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from mcp_asdf_tools.bus.slcan_server import HOST
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.view.film import History
from mcp_asdf_tools.view.page import encode_description, encode_states, page

_SECONDS_BETWEEN_BLOCKS = 0.1
"""Seconds from one look for new states to the next."""
_SHUTDOWN_SECONDS = 2.0
"""Longest time that the end of the context waits for the server's thread."""
_HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
"""Headers of every answer: no cache keeps it, and no other site can embed it."""


@contextmanager
def serving(history: History, port: int | None = None) -> Iterator[str]:
    """Serve the page of a history on 127.0.0.1 until the context ends; yield its URL.

    Without ``port``, or with 0, it is any free one. The server runs in a thread of its own. The end of the
    context sets ``history.has_ended``, so that open pages learn of the end. Raises UsageError if the port is
    out of range or taken.
    """
    with closing(_listen(port or 0)) as listener:
        bound_port = listener.getsockname()[1]
        config = uvicorn.Config(
            _make_application(history, bound_port),
            log_level="critical",
            lifespan="off",
            timeout_graceful_shutdown=1,
        )
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
        thread.start()
        try:
            yield f"http://{HOST}:{bound_port}/"
        finally:
            # Streams of events go on until the history ends, and would keep the server from ending.
            history.has_ended = True
            server.should_exit = True
            thread.join(_SHUTDOWN_SECONDS)


def _listen(port: int) -> socket.socket:
    """Return a socket that listens on ``port`` of 127.0.0.1, or on any free port if it is 0.

    Raises UsageError if the port is out of range or taken.
    """
    if not 0 <= port <= 65535:
        raise UsageError(f"--port is {port}; choose 1 to 65535, or 0 for any free one")
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    # A port stays reserved for a minute after its last connection; the next run may use it at once.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, True)
    try:
        listener.bind((HOST, port))
        listener.listen()
    except OSError as error:
        listener.close()
        raise UsageError(
            f"cannot serve the page at {HOST}:{port}: {error.strerror}; choose another --port"
        ) from error
    return listener


def _make_application(history: History, port: int) -> Starlette:
    """Return the application: "/" is the page, and "/events" the stream of the history that it follows."""

    async def send_page(request: Request) -> HTMLResponse:
        return HTMLResponse(page(), headers=_HEADERS)

    async def send_events(request: Request) -> StreamingResponse:
        return StreamingResponse(_stream_events(history), media_type="text/event-stream", headers=_HEADERS)

    routes = [Route("/", send_page), Route("/events", send_events)]
    return Starlette(routes=routes, middleware=[Middleware(SameOriginOnly, port=port)])


class SameOriginOnly:
    """ASGI middleware that refuses requests other than those of this server's own page.

    It also refuses a site whose name was made to lead to 127.0.0.1 (DNS rebinding), by the Host header.
    """

    def __init__(self, app: ASGIApp, port: int) -> None:
        """Guard ``app``, which is served on ``port`` of 127.0.0.1, also known as localhost."""
        self._app = app
        self._hosts = {f"{name}:{port}".encode() for name in (HOST, "localhost")}
        self._origins = {b"http://" + host for host in self._hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on to the application, or answer it with status 403."""
        headers = dict(scope.get("headers", []))
        host = headers.get(b"host")
        origin = headers.get(b"origin")
        fetch_site = headers.get(b"sec-fetch-site")
        # A browser leaves out Origin when a user opens the page, and old ones leave out Sec-Fetch-Site.
        has_own_origin = origin is None or origin in self._origins
        comes_from_own_page = fetch_site in (None, b"none", b"same-origin")
        if host in self._hosts and has_own_origin and comes_from_own_page:
            await self._app(scope, receive, send)
        else:
            refusal = PlainTextResponse("this page is for this computer alone", 403)
            await refusal(scope, receive, send)


async def _stream_events(history: History) -> AsyncIterator[str]:
    """Yield a history as server-sent events until it has ended.

    The events are a "stage" (the description) at the start and for each new generation, after which all
    states come again; a "block" for the states that are new; a "report" for each new one; at last an "end".
    """
    generation = -1  # no history has this one, so the first update begins with a description
    sent_states = 0
    sent_report = None
    has_ended = False
    while not has_ended:
        # Read before the states: those added after an earlier look are still sent when this is true.
        has_ended = history.has_ended
        update = history.states_since(generation, sent_states)
        if update.generation != generation:
            yield _format_event("stage", encode_description(update.description))
            generation = update.generation
            sent_states = 0
        if update.states:
            sent_states += len(update.states)
            # Compression takes long; in a thread it does not hold up other pages.
            block = await asyncio.to_thread(encode_states, update.states, update.description)
            yield _format_event("block", block)
        if history.report is not sent_report:
            sent_report = history.report
            yield _format_event("report", sent_report)
        await asyncio.sleep(_SECONDS_BETWEEN_BLOCKS)
    yield _format_event("end", None)


def _format_event(name: str, content: object) -> str:
    """Return a server-sent event with this name, and ``content`` as JSON."""
    return f"event: {name}\ndata: {json.dumps(content)}\n\n"
