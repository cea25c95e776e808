"""The server of the page: whom it answers, the events that it sends, how it ends, and its port."""

from __future__ import annotations

import http.client
import json
import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.view import server
from mcp_asdf_tools.view.history import History, HistoryUpdate, RunDescription, State
from mcp_asdf_tools.view.page import make_page
from mcp_asdf_tools.view.server import serve_page
from support import PATIENCE, wait_until

DESCRIPTION = RunDescription("two </script> robots", [0, 1], fill_ratio=0.5)
STATES = [State(tick, np.full((4, 2), 0.25), np.zeros((2, 2), np.bool_), None) for tick in range(5)]


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    """The URL of a page, whose run has ended, while it is served."""
    with serve_page(History(DESCRIPTION, STATES)) as url:
        yield url


def get(url: str, path: str = "/", **headers: str) -> tuple[int, str]:
    """Send a GET request; return status and content of the answer."""
    with closing(http.client.HTTPConnection(urlsplit(url).netloc, timeout=PATIENCE)) as connection:
        connection.request("GET", path, headers=headers)
        with connection.getresponse() as response:
            return response.status, response.read().decode()


def read_events(url: str) -> list[tuple[str, Any]]:
    """Read the stream of events until it ends; return the name and the content of each event."""
    _, text = get(url, "/events")
    lines = [event.splitlines() for event in text.split("\n\n") if event]
    return [(name.removeprefix("event: "), json.loads(data.removeprefix("data: "))) for name, data in lines]


def connect(url: str, request: str = "") -> socket.socket:
    """Return a socket that is connected to the server and has sent the text of a request."""
    address = urlsplit(url)
    client = socket.create_connection((address.hostname, address.port), timeout=PATIENCE)
    client.sendall(request.encode())
    return client


def read_to(client: socket.socket, end: str) -> None:
    """Read from a socket until the text so far ends with ``end``."""
    text = b""
    while not text.endswith(end.encode()):
        text += client.recv(1)


def request_for(url: str, path: str) -> str:
    return f"GET {path} HTTP/1.0\r\nHost: {urlsplit(url).netloc}\r\n\r\n"


# --- Whom it answers ----------------------------------------------------------------------------------


def test_server_sends_the_page_to_a_user_who_opens_it(url: str) -> None:
    assert get(url) == (200, make_page())


def test_server_ignores_the_query_of_an_address(url: str) -> None:
    assert get(url, "/?step=3") == (200, make_page())


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("Host", "localhost:PORT"),
        ("Origin", "http://127.0.0.1:PORT"),
        ("Origin", "http://localhost:PORT"),
        ("Sec-Fetch-Site", "same-origin"),
        ("Sec-Fetch-Site", "none"),
    ],
)
def test_server_answers_its_own_page(url: str, name: str, value: str) -> None:
    port = str(urlsplit(url).port)
    status, _ = get(url, **{name: value.replace("PORT", port)})
    assert status == 200


@pytest.mark.parametrize("path", ["/", "/events"])
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("Host", "evil.example"),
        ("Host", "evil.example:PORT"),
        ("Host", "127.0.0.1"),
        ("Host", "127.0.0.1:1"),
        ("Origin", "http://evil.example"),
        ("Origin", "null"),
        ("Origin", "https://127.0.0.1:PORT"),
        ("Origin", "http://127.1.0.1:PORT"),
        ("Sec-Fetch-Site", "cross-site"),
        ("Sec-Fetch-Site", "same-site"),
    ],
)
def test_server_refuses_requests_of_other_sites(url: str, path: str, name: str, value: str) -> None:
    port = str(urlsplit(url).port)
    status, text = get(url, path, **{name: value.replace("PORT", port)})
    assert status == 403
    assert "This page is for this computer alone." in text


def test_server_refuses_a_request_without_a_host(url: str) -> None:
    with connect(url, "GET / HTTP/1.0\r\n\r\n") as client:
        assert client.makefile().readline() == "HTTP/1.0 403 Forbidden\n"


def test_server_has_no_other_files(url: str) -> None:
    status, _ = get(url, "/etc/passwd")
    assert status == 404


def test_server_listens_on_one_address_alone(url: str) -> None:
    with socket.socket() as client, pytest.raises(ConnectionRefusedError):
        client.connect(("127.0.0.2", urlsplit(url).port))


@pytest.mark.parametrize("path", ["/", "/events", "/none"])
def test_answers_are_neither_cached_nor_embedded_by_other_sites(url: str, path: str) -> None:
    with connect(url, request_for(url, path)) as client:
        head = client.makefile().read().partition("\n\n")[0] + "\n"

    assert "Cache-Control: no-store\n" in head
    assert "Cross-Origin-Resource-Policy: same-origin\n" in head
    assert "X-Content-Type-Options: nosniff\n" in head
    assert "X-Frame-Options: DENY\n" in head


# --- Events -------------------------------------------------------------------------------------------


class ScriptedHistory(History):
    """A live history of robots 0 and 1 that changes each time after the server has read its states."""

    def __init__(self) -> None:
        super().__init__(DESCRIPTION)
        self.add(STATES[0])
        self._reads = 0

    def states_since(self, generation: int = -1, index: int = 0) -> HistoryUpdate:
        update = super().states_since(generation, index)
        self._reads += 1
        if self._reads == 1:
            self.add(STATES[1])
        elif self._reads == 2:
            self.report = {"robots": [], "frames": []}
        elif self._reads == 3:
            self.add_robot(7)
        else:
            self.has_ended = True
        return update


@pytest.fixture(scope="module")
def live_events() -> list[tuple[str, Any]]:
    with serve_page(ScriptedHistory()) as url:
        return read_events(url)


def test_events_follow_a_run_in_the_order_in_which_it_goes(live_events: list[tuple[str, Any]]) -> None:
    names = [name for name, _ in live_events]
    assert names == ["description", "block", "block", "report", "description", "block", "end"]


def test_a_robot_that_joins_begins_the_history_anew(live_events: list[tuple[str, Any]]) -> None:
    robots = [content["robots"] for name, content in live_events if name == "description"]
    counts = [content["count"] for name, content in live_events if name == "block"]
    assert robots == [[0, 1], [0, 1, 7]]
    assert counts == [1, 1, 2]


def test_events_have_the_latest_report(live_events: list[tuple[str, Any]]) -> None:
    assert dict(live_events)["report"] == {"robots": [], "frames": []}


def test_a_run_that_has_ended_comes_in_one_block(url: str) -> None:
    (_, description), (_, block), end = read_events(url)
    assert description["title"] == "two </script> robots"
    assert block["count"] == 5
    assert end == ("end", None)


# --- Clients that break off, stay silent or do not read ------------------------------------------------


def test_two_pages_follow_one_run() -> None:
    history = History(DESCRIPTION)
    with serve_page(history) as url, connect(url, request_for(url, "/events")) as first:
        history.add(STATES[0])
        with connect(url, request_for(url, "/events")) as second:
            history.has_ended = True
            texts = [client.makefile().read() for client in (first, second)]

    assert [text.count("event: block") for text in texts] == [1, 1]


def test_server_ends_the_stream_of_a_page_that_was_closed() -> None:
    """Or it would have one thread more for each page that was ever open."""
    threads_before = threading.active_count()
    with serve_page(History(DESCRIPTION)) as url:
        with connect(url, request_for(url, "/events")) as client:
            read_to(client, "\n\n")
            assert threading.active_count() == threads_before + 2  # the server's own, and that of the stream

        wait_until(lambda: threading.active_count() == threads_before + 1)


def test_a_client_that_breaks_off_leaves_no_message(capfd: pytest.CaptureFixture[str]) -> None:
    with serve_page(History(DESCRIPTION, STATES * 1000)) as url:
        client = connect(url, request_for(url, "/events"))
        # Without lingering, closing a connection resets it, which fails the server's next write.
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        client.close()
        assert get(url)[0] == 200

    assert capfd.readouterr() == ("", "")


def test_server_gives_up_a_client_that_completes_no_request() -> None:
    with serve_page(History(DESCRIPTION)) as url, connect(url, "GET / HTTP/1.0\r\n") as client:
        assert get(url)[0] == 200
        client.makefile().read()  # until the server closes the connection


def test_server_gives_up_a_client_that_does_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "_ANSWER_TIMEOUT", 0.1)
    monkeypatch.setattr(server, "make_page", lambda: "x" * 20_000_000)
    with serve_page(History(DESCRIPTION)) as url:
        threads_without_clients = set(threading.enumerate())
        with connect(url, request_for(url, "/")) as client:
            client.recv(1)
            wait_until(lambda: set(threading.enumerate()) <= threads_without_clients)


def test_the_end_does_not_wait_for_a_client_that_does_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "_SHUTDOWN_SECONDS", 0.05)
    monkeypatch.setattr(server, "_ANSWER_TIMEOUT", PATIENCE)
    monkeypatch.setattr(server, "make_page", lambda: "x" * 20_000_000)
    start_time = time.monotonic()
    with serve_page(History(DESCRIPTION)) as url:
        client = connect(url, request_for(url, "/"))
        client.recv(1)
    with client:
        assert time.monotonic() - start_time < PATIENCE / 2


def test_the_end_of_the_server_is_the_last_event_of_an_open_page() -> None:
    with serve_page(History(DESCRIPTION)) as url:
        client = connect(url, request_for(url, "/events"))
        client.recv(1)
    with client:
        assert client.makefile().read().endswith("event: end\ndata: null\n\n")


def test_the_end_of_the_server_waits_until_open_pages_have_the_last_event(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(server, "_SECONDS_BETWEEN_BLOCKS", 0.2)
    threads_before = set(threading.enumerate())  # some may be of earlier tests and end meanwhile
    with serve_page(History(DESCRIPTION)) as url:
        client = connect(url, request_for(url, "/events"))
        client.recv(1)
    with client:
        assert set(threading.enumerate()) <= threads_before


# --- Ports --------------------------------------------------------------------------------------------


def test_a_port_is_free_again_at_once() -> None:
    with serve_page(History(DESCRIPTION), 65535) as url, connect(url, "GET / HTTP/1.0\r\n\r\n") as client:
        client.makefile().read()  # the server closes first, so that its port is in TIME_WAIT
    with serve_page(History(DESCRIPTION), 65535) as url:
        assert url == "http://127.0.0.1:65535/"


def test_a_port_that_is_taken_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        expected = rf"127.0.0.1:{port}: Address already in use; choose another --port"
        with pytest.raises(UsageError, match=expected):
            serve_page(History(DESCRIPTION), port).__enter__()


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_port_out_of_range_is_refused(port: int) -> None:
    with pytest.raises(UsageError, match=f"--port is {port}; choose 1 to 65535"):
        serve_page(History(DESCRIPTION), port).__enter__()
