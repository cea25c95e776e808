"""Server of the page, for browsers of this computer alone."""

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
_ENDING_SECONDS = 2.0
_HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


@contextmanager
def serving(history: History, port: int | None = None) -> Iterator[str]:
    """Serve the page of a film on 127.0.0.1 until the context ends; yields its URL. No port is any free one.

    Raises UsageError if the port is taken.
    """
    with closing(_listen(port or 0)) as listener:
        port = listener.getsockname()[1]
        application = _application(history, port)
        config = uvicorn.Config(
            application, log_level="critical", lifespan="off", timeout_graceful_shutdown=1
        )
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
        thread.start()
        try:
            yield f"http://{HOST}:{port}/"
        finally:
            history.has_ended = True
            server.should_exit = True
            thread.join(_ENDING_SECONDS)


def _listen(port: int) -> socket.socket:
    if not 0 <= port <= 65535:
        raise UsageError(f"--port is {port}; choose 1 to 65535, or 0 for any free one")
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
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


def _application(history: History, port: int) -> Starlette:
    async def show(request: Request) -> HTMLResponse:
        return HTMLResponse(page(), headers=_HEADERS)

    async def stream(request: Request) -> StreamingResponse:
        return StreamingResponse(_events(history), media_type="text/event-stream", headers=_HEADERS)

    routes = [Route("/", show), Route("/events", stream)]
    return Starlette(routes=routes, middleware=[Middleware(OwnPagesOnly, port=port)])


class OwnPagesOnly:
    """Refuses what another site asks for, also one whose name was made to lead here (DNS rebinding)."""

    def __init__(self, app: ASGIApp, port: int) -> None:
        self._app = app
        self._hosts = {f"{name}:{port}".encode() for name in (HOST, "localhost")}
        self._origins = {b"http://" + host for host in self._hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or answer 403."""
        headers = dict(scope.get("headers", []))
        is_own = (
            headers.get(b"host") in self._hosts
            and headers.get(b"origin", next(iter(self._origins))) in self._origins
            and headers.get(b"sec-fetch-site", b"none") in (b"none", b"same-origin")
        )
        answer = self._app if is_own else PlainTextResponse("this page is for this computer alone", 403)
        await answer(scope, receive, send)


async def _events(history: History) -> AsyncIterator[str]:
    """Server-sent events: a ``stage`` for each generation, its ``block``s, ``report``s, at last ``end``."""
    generation, index, has_begun, has_ended, report = 0, 0, False, False, None
    while not has_ended:
        has_ended = history.has_ended  # read before the states, so that none is left behind
        before, update = generation, history.states_since(generation, index)
        generation, stage, states = update.generation, update.description, update.states
        if not has_begun or generation != before:
            yield _event("stage", encode_description(stage))
            has_begun, index = True, 0
        if states:
            index += len(states)
            yield _event("block", await asyncio.to_thread(encode_states, states, stage))
        if history.report is not report:
            report = history.report
            yield _event("report", report)
        await asyncio.sleep(_SECONDS_BETWEEN_BLOCKS)
    yield _event("end", None)


def _event(name: str, content: object) -> str:
    return f"event: {name}\ndata: {json.dumps(content)}\n\n"
