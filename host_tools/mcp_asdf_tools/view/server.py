"""An HTTP server of the view's page, for browsers of this computer alone."""

from __future__ import annotations

import json
import selectors
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler
from socketserver import ThreadingTCPServer
from typing import Any
from urllib.parse import urlsplit

from mcp_asdf_tools.bus.slcan_server import HOST, MAX_PORT
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.view.history import History
from mcp_asdf_tools.view.page import encode_description, encode_states, make_page

_SECONDS_BETWEEN_BLOCKS = 0.1
"""Seconds from one look for new states to the next."""
_REQUEST_TIMEOUT = 1.0
"""Seconds without a byte of the request after which a client is given up; browsers send it at once."""
_ANSWER_TIMEOUT = 10.0
"""Seconds after which a client is given up that does not read what was sent. The end of the server waits for
all answers, so this is also the longest time that it takes."""
_HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
"""Headers of every answer: no cache keeps it, and no other site can embed it."""


@contextmanager
def serve_page(history: History, port: int | None = None) -> Iterator[str]:
    """Serve the page of a history on 127.0.0.1 until the context ends; yield its URL.

    Without ``port``, or with 0, it is any free one. The server runs in threads of its own. The end of the
    context sets ``history.has_ended``, so that open pages learn of the end, and waits until they have. Raises
    UsageError if the port is out of range or taken.
    """
    with _bind_server(history, port or 0) as server:
        # Between two looks for a request the server asks whether it is to end.
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
        thread.start()
        try:
            yield f"http://{HOST}:{server.port}/"
        finally:
            # Streams of events go on until the history ends.
            history.has_ended = True
            server.shutdown()


def _bind_server(history: History, port: int) -> _PageServer:
    """Return a server that listens on ``port`` of 127.0.0.1, or on any free port if it is 0.

    Raises UsageError if the port is out of range or taken.
    """
    if not 0 <= port <= MAX_PORT:
        raise UsageError(f"--port is {port}; choose 1 to {MAX_PORT}, or 0 for any free one")
    try:
        return _PageServer(history, port)
    except OSError as error:
        raise UsageError(
            f"cannot serve the page at {HOST}:{port}: {error.strerror}; choose another --port"
        ) from error


class _PageServer(ThreadingTCPServer):
    """A TCP server that answers each connection in a thread of its own, and at its end waits for all of them.

    Attributes:
        history: The history that its pages follow.
        port: The port that it listens on.
    """

    # A port stays reserved for a minute after its last connection; the next run may use it at once.
    allow_reuse_address = True

    def __init__(self, history: History, port: int) -> None:
        """Listen on ``port`` of 127.0.0.1, or on any free port if it is 0. Raises OSError if it is taken."""
        super().__init__((HOST, port), _PageRequestHandler)
        self.history = history
        self.port = int(self.server_address[1])

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore that a client broke off or was too slow; print the traceback of any other error."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _PageRequestHandler(BaseHTTPRequestHandler):
    """Answers one request: "/" is the page, and "/events" the stream of the history that it follows."""

    timeout = _REQUEST_TIMEOUT
    server: _PageServer

    def do_GET(self) -> None:
        """Send the page or the events; status 403 to another site or computer, 404 for another path."""
        self.connection.settimeout(_ANSWER_TIMEOUT)
        path = urlsplit(self.path).path
        if not self._comes_from_own_page():
            self.send_error(403, explain="This page is for this computer alone.")
        elif path == "/":
            self._send_head("text/html")
            self.wfile.write(make_page().encode())
        elif path == "/events":
            self._send_head("text/event-stream")
            self._send_events()
        else:
            self.send_error(404)

    def _comes_from_own_page(self) -> bool:
        """Return whether a user who opens the page sent the request, or the page itself, and no other site.

        Host, Origin and Sec-Fetch-Site decide, headers that a browser's scripts cannot change. Host betrays a
        site whose own name was made to lead to 127.0.0.1 (DNS rebinding): Host has the site's name.
        """
        hosts = {f"{name}:{self.server.port}" for name in (HOST, "localhost")}
        own_origins = {f"http://{host}" for host in hosts}
        # A header that is left out is None: a browser leaves out Origin when a user opens the page, and old
        # ones leave out Sec-Fetch-Site.
        has_own_origin = self.headers.get("Origin") in {None, *own_origins}
        comes_from_own_site = self.headers.get("Sec-Fetch-Site") in {None, "none", "same-origin"}
        return self.headers.get("Host") in hosts and has_own_origin and comes_from_own_site

    def _send_head(self, media_type: str) -> None:
        """Send status 200 and the headers; the answer ends where the connection does, as in HTTP 1.0."""
        self.send_response(200)
        self.send_header("Content-Type", f"{media_type}; charset=utf-8")
        self.end_headers()

    def end_headers(self) -> None:
        """Send the headers of every answer, also of errors, and end them."""
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        super().end_headers()

    def _send_events(self) -> None:
        """Send the history as server-sent events until it has ended, or the client has closed the page."""
        with selectors.DefaultSelector() as selector:
            selector.register(self.connection, selectors.EVENT_READ)
            for events in _generate_events(self.server.history):
                self.wfile.write(events.encode())
                # A browser sends nothing after its request, so only the connection's end can be read.
                is_closed = bool(selector.select(_SECONDS_BETWEEN_BLOCKS))
                if is_closed:
                    return

    def log_message(self, *_: object) -> None:
        """Print nothing: the terminal is for the run."""


def _generate_events(history: History) -> Iterator[str]:
    """Yield the server-sent events that are new since the last yield, until the history has ended.

    The text is empty if nothing is new. The events are a "description" at the start and for each new
    generation, after which all states come again; a "block" for the states that are new; a "report" for each
    new one; at last an "end".
    """
    generation = -1  # no history has this one, so the first update begins with a description
    sent_states = 0
    sent_report = None
    has_ended = False
    while not has_ended:
        # Read before the states. Read after them, it would hide states that were added between the two.
        has_ended = history.has_ended
        update = history.states_since(generation, sent_states)
        events = []
        if update.generation != generation:
            events.append(_format_event("description", encode_description(update.description)))
            generation = update.generation
            sent_states = 0
        if update.states:
            events.append(_format_event("block", encode_states(update.states, update.description)))
            sent_states += len(update.states)
        if history.report is not sent_report:
            sent_report = history.report
            events.append(_format_event("report", sent_report))
        yield "".join(events)
    yield _format_event("end", None)


def _format_event(name: str, content: object) -> str:
    """Return a server-sent event with this name, and ``content`` as JSON."""
    return f"event: {name}\ndata: {json.dumps(content)}\n\n"
