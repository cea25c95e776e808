"""The server of a swarm's web page: whom it answers, the events that it sends, how it ends, and its port."""

from __future__ import annotations

import http.client
import json
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import closing
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.view import server
from mcp_asdf_tools.view.history import NO_LINKS, History, HistoryUpdate, RunDescription, State
from mcp_asdf_tools.view.page import make_page
from mcp_asdf_tools.view.server import serve_page
from support import PATIENCE, wait_until

DESCRIPTION = RunDescription("two </script> robots", [0, 1], fill_ratio=0.5)


def make_state(tick: int) -> State:
    """Return a state of robots 0 and 1, which do not receive each other."""
    return State(tick, np.full((4, 2), 0.25), NO_LINKS, positions=None)


def history_of_running_swarm() -> History:
    """Return the history of robots 0 and 1, which run and have no states yet."""
    return History(DESCRIPTION)


def history_of_ended_swarm(states: int) -> History:
    """Return the history of robots 0 and 1, which have run and have this number of states."""
    return History(DESCRIPTION, [make_state(tick) for tick in range(states)])


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    """The URL of the page of a swarm that has ended, while it is served."""
    with serve_page(history_of_ended_swarm(states=5)) as url:
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


def read_first_event(client: socket.socket) -> None:
    """Read from a socket up to the end of the first event in an answer.

    An event ends with two line feeds. The head of the answer does not, as its lines end with CR and LF.
    """
    text = b""
    while not text.endswith(b"\n\n"):
        text += client.recv(1)


def read_until_server_closes(client: socket.socket) -> str:
    """Return all text that comes on a connection until the server closes it."""
    return client.makefile().read()


def request_for(url: str, path: str) -> str:
    """Return a request in HTTP/1.0, by which the server closes the connection after its answer."""
    return f"GET {path} HTTP/1.0\r\nHost: {urlsplit(url).netloc}\r\n\r\n"


# --- Whom it answers ----------------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["/", "/?step=3"])
def test_server_sends_the_page_to_a_user_who_opens_it_and_ignores_a_query(path: str, url: str) -> None:
    """The part "?step=3" of an address is a query. The status 200 means OK."""
    status, content = get(url, path)
    assert status == 200
    assert content == make_page()


@pytest.mark.parametrize(
    ("header", "value"),
    [
        ("Host", "localhost:PORT"),
        ("Origin", "http://127.0.0.1:PORT"),
        ("Origin", "http://localhost:PORT"),
        ("Sec-Fetch-Site", "same-origin"),
        ("Sec-Fetch-Site", "none"),
    ],
)
def test_server_answers_requests_that_a_browser_makes_for_its_own_page(
    url: str, header: str, value: str
) -> None:
    """One such request has the header "Origin: http://localhost:PORT", where PORT is the server's port."""
    port = str(urlsplit(url).port)
    headers = {header: value.replace("PORT", port)}
    status, _content = get(url, "/", **headers)
    assert status == 200


@pytest.mark.parametrize(
    ("header", "value"),
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
def test_server_refuses_requests_that_a_browser_makes_for_another_site(
    url: str, header: str, value: str
) -> None:
    """One has the header "Origin: http://evil.example": another site must not read a user's swarm.

    PORT stands for the server's port, and the status 403 for Forbidden.
    """
    port = str(urlsplit(url).port)
    headers = {header: value.replace("PORT", port)}
    status, content = get(url, "/events", **headers)
    assert status == 403
    assert "This page is for this computer alone." in content


def test_server_refuses_to_send_its_page_to_another_site(url: str) -> None:
    """The answer to a request from http://evil.example has the status 403, Forbidden."""
    status, _content = get(url, "/", Origin="http://evil.example")
    assert status == 403


def test_server_refuses_a_request_without_a_host(url: str) -> None:
    """Its answer begins with the status 403, Forbidden."""
    with connect(url, "GET / HTTP/1.0\r\n\r\n") as client:
        assert client.makefile().readline() == "HTTP/1.0 403 Forbidden\n"


def test_server_sends_no_files_of_the_computer(url: str) -> None:
    """The answer to a request for /etc/passwd is that there is no such page: status 404."""
    status, _content = get(url, "/etc/passwd")
    assert status == 404


def test_server_listens_on_the_address_127_0_0_1_alone(url: str) -> None:
    """127.0.0.2 is an address of the same computer, but a connection to it is refused."""
    with socket.socket() as client, pytest.raises(ConnectionRefusedError):
        client.connect(("127.0.0.2", urlsplit(url).port))


@pytest.mark.parametrize("path", ["/", "/events", "/none"])
def test_the_head_of_an_answer_forbids_to_cache_it_and_to_embed_it_in_other_sites(
    url: str, path: str
) -> None:
    """This holds for the page, for its events, and for the error about an address without anything."""
    with connect(url, request_for(url, path)) as client:
        head, _empty_line, _content = read_until_server_closes(client).partition("\n\n")

    assert {
        "Cache-Control: no-store",
        "Cross-Origin-Resource-Policy: same-origin",
        "X-Content-Type-Options: nosniff",
        "X-Frame-Options: DENY",
    } <= set(head.splitlines())


# --- Events -------------------------------------------------------------------------------------------


Event = tuple[str, Any]


class ScriptedHistory(History):
    """A history of robots 0 and 1 that changes each time after the server has read its states.

    It has one state at first. Then come a second one, a report, robot 7, and the end.
    """

    def __init__(self) -> None:
        super().__init__(DESCRIPTION)
        self.add(make_state(0))
        self._reads = 0

    def states_since(self, generation: int = -1, index: int = 0) -> HistoryUpdate:
        update = super().states_since(generation, index)
        self._reads += 1
        if self._reads == 1:
            self.add(make_state(1))
        elif self._reads == 2:
            self.report = {"robots": [], "frames": []}
        elif self._reads == 3:
            self.add_robot(7)
        else:
            self.has_ended = True
        return update


@pytest.fixture(scope="module")
def live_events() -> list[Event]:
    """All events of a swarm that takes a step, gets a report and robot 7, and ends."""
    with serve_page(ScriptedHistory()) as url:
        return read_events(url)


def test_the_server_sends_the_events_of_a_running_swarm_in_the_order_of_its_changes(
    live_events: list[Event],
) -> None:
    """The swarm has a state at first. Then come a second one, a report, a robot that joins, and the end.

    A block holds states. A new robot needs a new description, and a block with all states so far.
    """
    names = [name for name, _content in live_events]
    assert names == ["description", "block", "block", "report", "description", "block", "end"]


def test_after_a_robot_has_joined_the_server_sends_a_new_description_and_all_states_again(
    live_events: list[Event],
) -> None:
    """Robot 7 joins the robots 0 and 1. Three blocks hold the first state, the second state, and both."""
    lists_of_robots = [content["robots"] for name, content in live_events if name == "description"]
    numbers_of_states = [content["count"] for name, content in live_events if name == "block"]
    assert lists_of_robots == [[0, 1], [0, 1, 7]]
    assert numbers_of_states == [1, 1, 2]


def test_the_server_sends_the_latest_report_on_the_robots(live_events: list[Event]) -> None:
    """The only report of this swarm has neither robots nor frames."""
    (report,) = [content for name, content in live_events if name == "report"]
    assert report == {"robots": [], "frames": []}


def test_the_server_sends_all_states_of_a_swarm_that_has_ended_in_one_block() -> None:
    """The swarm has five states. Its three events are a description, a block of states, and the end.

    The description has its title, "two </script> robots".
    """
    with serve_page(history_of_ended_swarm(states=5)) as url:
        (first_name, description), (second_name, block), (third_name, content_of_end) = read_events(url)

    assert (first_name, second_name, third_name) == ("description", "block", "end")
    assert description["title"] == "two </script> robots"
    assert block["count"] == 5
    assert content_of_end is None


def test_two_open_pages_both_get_the_states_of_a_swarm() -> None:
    """The second page is opened after the only state has been added, and the first one before.

    A block is an event that holds states.
    """
    history = history_of_running_swarm()
    with serve_page(history) as url, connect(url, request_for(url, "/events")) as first_page:
        history.add(make_state(tick=0))
        with connect(url, request_for(url, "/events")) as second_page:
            history.has_ended = True
            first_text = read_until_server_closes(first_page)
            second_text = read_until_server_closes(second_page)

    assert first_text.count("event: block") == 1
    assert second_text.count("event: block") == 1


# --- Clients that break off, stay silent or do not read ------------------------------------------------


def test_the_server_ends_its_thread_for_a_page_that_was_closed() -> None:
    """Otherwise it would have one thread more for each page that was ever open.

    The page has read its first event when it is closed, by the end of the inner block.
    """
    threads_before = set(threading.enumerate())  # some may be of earlier tests and end meanwhile

    def count_threads_of_server_and_pages() -> int:
        return len(set(threading.enumerate()) - threads_before)

    with serve_page(history_of_running_swarm()) as url:
        with connect(url, request_for(url, "/events")) as client:
            read_first_event(client)
            assert count_threads_of_server_and_pages() == 2  # one of the server, one of the page

        wait_until(lambda: count_threads_of_server_and_pages() == 1)


def test_a_client_that_resets_its_connection_causes_no_message(capfd: pytest.CaptureFixture[str]) -> None:
    """The client leaves while it gets 5000 states. The server prints nothing and answers another request."""
    with serve_page(history_of_ended_swarm(states=5000)) as url:
        client = connect(url, request_for(url, "/events"))
        # Without lingering, closing a connection resets it, which fails the server's next write.
        is_lingering_for_0_s = struct.pack("ii", True, 0)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, is_lingering_for_0_s)
        client.close()
        status, _content = get(url)

    assert status == 200
    output, errors = capfd.readouterr()
    assert output == ""
    assert errors == ""


def test_the_server_closes_a_connection_whose_request_has_no_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """The client sends one line and no more. An empty line would end the request.

    The server waits for a tenth of a second here, and then closes.
    """
    monkeypatch.setattr(server._PageRequestHandler, "timeout", 0.1)
    with serve_page(history_of_running_swarm()) as url, connect(url, "GET / HTTP/1.0\r\n") as client:
        answer = read_until_server_closes(client)
    assert answer == ""


def test_the_server_ends_its_thread_for_a_client_that_does_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """The client reads one byte of a page of 20 MB. The server waits for a tenth of a second here.

    The end of the server waits for all threads, so it would never come otherwise.
    """
    monkeypatch.setattr(server, "make_page", lambda: "x" * 20_000_000)
    monkeypatch.setattr(server, "_ANSWER_TIMEOUT", 0.1)
    with serve_page(history_of_running_swarm()) as url:
        threads_without_clients = set(threading.enumerate())
        with connect(url, request_for(url, "/")) as client:
            client.recv(1)
            wait_until(lambda: set(threading.enumerate()) <= threads_without_clients)


def test_when_the_server_ends_an_open_page_gets_the_event_that_the_swarm_has_ended() -> None:
    """The page has read one byte of the events when the server ends, and then reads the rest."""
    with serve_page(history_of_running_swarm()) as url:
        client = connect(url, request_for(url, "/events"))
        client.recv(1)
    with client:
        assert read_until_server_closes(client).endswith("event: end\ndata: null\n\n")


def test_the_server_does_not_end_before_the_threads_of_open_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread of a page looks for new states every 0.2 s here, so it takes a while to notice the end."""
    monkeypatch.setattr(server, "_SECONDS_BETWEEN_BLOCKS", 0.2)
    threads_before = set(threading.enumerate())  # some may be of earlier tests and end meanwhile
    with serve_page(history_of_running_swarm()) as url:
        client = connect(url, request_for(url, "/events"))
        client.recv(1)
    threads_after = set(threading.enumerate())
    client.close()
    assert threads_after <= threads_before


# --- Ports --------------------------------------------------------------------------------------------


def test_a_second_server_can_have_the_port_of_one_that_has_just_ended() -> None:
    """The first server closes a connection itself, so the system would keep its port for a minute."""
    history = history_of_running_swarm()
    with serve_page(history, port=65535) as url, connect(url, request_for(url, "/")) as client:
        read_until_server_closes(client)
    with serve_page(history, port=65535) as url:
        assert url == "http://127.0.0.1:65535/"


def test_a_port_that_another_program_uses_is_refused() -> None:
    """A UsageError has the address and advises to choose another port."""
    with socket.create_server(("127.0.0.1", 0)) as other_server:
        _, port = other_server.getsockname()
        message = rf"127.0.0.1:{port}: Address already in use; choose another --port"
        with pytest.raises(UsageError, match=message), serve_page(history_of_running_swarm(), port):
            pass


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_port_out_of_range_is_refused(port: int) -> None:
    """The user chooses the port by --port, and a port is a number up to 65535."""
    message = f"--port is {port}; choose 1 to 65535"
    with pytest.raises(UsageError, match=message), serve_page(history_of_running_swarm(), port):
        pass
