"""An HTTP server of the view's page, for browsers of this computer alone."""

from __future__ import annotations

import json
import selectors
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler
from socketserver import ThreadingTCPServer
from typing import Any
from urllib.parse import urlsplit

from mcp_asdf_tools.bus.slcan_server import HOST
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.view.film import History
from mcp_asdf_tools.view.page import encode_description, encode_states, page

_SECONDS_BETWEEN_BLOCKS = 0.1
"""Seconds from one look for new states to the next."""
_CLIENT_TIMEOUT = 30.0
"""Longest time in seconds to wait for a client to send its request, or to receive a piece of the answer."""
_SHUTDOWN_SECONDS = 2.0
"""Longest time that the end of the server waits for the answers that are under way."""
_MAX_CONNECTIONS = 100
"""Connections at the same time, each of which has a thread; an open page needs one."""
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

    Without ``port``, or with 0, it is any free one. The server runs in threads of its own. The end of the
    context sets ``history.has_ended``, so that open pages learn of the end. Raises UsageError if the port is
    out of range or taken.
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
            server.end_connections()


def _bind_server(history: History, port: int) -> _PageServer:
    """Return a server that listens on ``port`` of 127.0.0.1, or on any free port if it is 0.

    Raises UsageError if the port is out of range or taken.
    """
    if not 0 <= port <= 65535:
        raise UsageError(f"--port is {port}; choose 1 to 65535, or 0 for any free one")
    try:
        return _PageServer(history, port)
    except OSError as error:
        raise UsageError(
            f"cannot serve the page at {HOST}:{port}: {error.strerror}; choose another --port"
        ) from error


class _PageServer(ThreadingTCPServer):
    """A TCP server that answers each connection in a thread of its own.

    Attributes:
        history: The history that its pages follow.
        port: The port that it listens on.
    """

    # A port stays reserved for a minute after its last connection; the next run may use it at once.
    allow_reuse_address = True
    daemon_threads = True

    def __init__(self, history: History, port: int) -> None:
        """Listen on ``port`` of 127.0.0.1, or on any free port if it is 0. Raises OSError if it is taken."""
        super().__init__((HOST, port), _PageRequestHandler)
        self.history = history
        self.port = int(self.server_address[1])
        self._connections: set[Any] = set()
        self._connection_closed = threading.Condition()

    def verify_request(self, request: Any, client_address: Any) -> bool:
        """Return whether to answer a new connection: only if there are fewer than _MAX_CONNECTIONS."""
        with self._connection_closed:
            return len(self._connections) < _MAX_CONNECTIONS

    def process_request(self, request: Any, client_address: Any) -> None:
        """Start the thread that answers a new connection, and remember the connection until it is closed."""
        with self._connection_closed:
            self._connections.add(request)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection, whether it was answered or refused."""
        super().shutdown_request(request)
        with self._connection_closed:
            self._connections.discard(request)
            self._connection_closed.notify_all()

    def end_connections(self) -> None:
        """End all connections: idle ones at once, others when their answer is complete.

        Answers that are not complete after _SHUTDOWN_SECONDS are broken off.
        """
        with self._connection_closed:
            # A thread that waits for a request now reads the end of the connection, and gives up.
            self._shut_connections(socket.SHUT_RD)
            self._connection_closed.wait_for(lambda: not self._connections, _SHUTDOWN_SECONDS)
            self._shut_connections(socket.SHUT_RDWR)

    def _shut_connections(self, direction: int) -> None:
        """Shut one or both directions of all connections."""
        for connection in self._connections:
            with suppress(OSError):  # the client may have closed it just now
                connection.shutdown(direction)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore that a client broke off or was too slow; print the traceback of any other error."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _PageRequestHandler(BaseHTTPRequestHandler):
    """Answers one request: "/" is the page, and "/events" the stream of the history that it follows."""

    timeout = _CLIENT_TIMEOUT
    server: _PageServer

    def do_GET(self) -> None:
        """Send the page or the events, or status 403 or 404 and the reason."""
        path = urlsplit(self.path).path
        if not self._comes_from_own_page():
            self._send_text(403, "this page is for this computer alone")
        elif path == "/":
            self._send_text(200, page(), "text/html")
        elif path == "/events":
            self._send_events()
        else:
            self._send_text(404, "there is no such page")

    def _comes_from_own_page(self) -> bool:
        """Return whether the headers are those of a user who opens the page, or of the page itself.

        The Host header shows a site whose name was made to lead to 127.0.0.1 (DNS rebinding).
        """
        hosts = {f"{name}:{self.server.port}" for name in (HOST, "localhost")}
        own_origins = {f"http://{host}" for host in hosts}
        # A browser leaves out Origin when a user opens the page, and old ones leave out Sec-Fetch-Site.
        has_own_origin = self.headers.get("Origin") in {None, *own_origins}
        comes_from_own_site = self.headers.get("Sec-Fetch-Site") in {None, "none", "same-origin"}
        return self.headers.get("Host") in hosts and has_own_origin and comes_from_own_site

    def _send_text(self, status: int, text: str, media_type: str = "text/plain") -> None:
        """Send a complete answer."""
        self._send_head(status, media_type)
        self.wfile.write(text.encode())

    def _send_head(self, status: int, media_type: str) -> None:
        """Send the status and the headers; the answer ends where the connection does, as in HTTP 1.0."""
        self.send_response(status)
        self.send_header("Content-Type", f"{media_type}; charset=utf-8")
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.end_headers()

    def _send_events(self) -> None:
        """Send the history as server-sent events until it has ended, or the client has closed the page."""
        self._send_head(200, "text/event-stream")
        with selectors.DefaultSelector() as selector:
            selector.register(self.connection, selectors.EVENT_READ)
            for events in _generate_events(self.server.history):
                self.wfile.write(events.encode())
                # A browser sends nothing after its request, so only the connection's end can be read.
                is_closed = selector.select(_SECONDS_BETWEEN_BLOCKS)
                # At the end of the server it is shut for reading, too; the last events are still sent.
                if is_closed and not self.server.history.has_ended:
                    return

    def log_message(self, *_: object) -> None:
        """Print nothing: the terminal is for the run."""


def _generate_events(history: History) -> Iterator[str]:
    """Yield the new server-sent events of a history, perhaps none, at each step, until it has ended.

    The events are a "description" at the start and for each new generation, after which all
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
