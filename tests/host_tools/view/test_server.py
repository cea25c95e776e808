"""The server answers browsers of this computer that show its own page, and nobody else."""

from __future__ import annotations

import http.client
import json
import socket
from contextlib import closing
from urllib.parse import urlsplit

import numpy as np
import pytest

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.view.film import History, HistoryUpdate, RunDescription, State
from mcp_asdf_tools.view.page import page
from mcp_asdf_tools.view.server import serving
from support import PATIENCE

STAGE = RunDescription("two </script> robots", [0, 1], fill_ratio=0.5)
STATES = [State(tick, np.full((4, 2), 0.25), np.zeros((2, 2), np.bool_), None) for tick in range(5)]
OVER = History(STAGE, STATES)


def answer(url: str, path: str = "/", **headers: str) -> tuple[int, str]:
    """Status and content of the answer to a request with these headers."""
    with closing(http.client.HTTPConnection(urlsplit(url).netloc, timeout=PATIENCE)) as connection:
        connection.request("GET", path, headers=headers)
        with connection.getresponse() as response:
            return response.status, response.read().decode()


def test_only_the_page_itself_is_answered_and_on_this_computer_alone() -> None:
    with serving(OVER) as url:
        port = urlsplit(url).port or 0
        assert url.startswith("http://127.0.0.1:")
        own = {"Origin": f"http://127.0.0.1:{port}", "Sec-Fetch-Site": "same-origin"}
        for headers in ({}, own, {"Host": f"localhost:{port}"}, {"Sec-Fetch-Site": "none"}):
            assert answer(url, **headers) == (200, page())
        strangers = {
            "Host": ("evil.example", f"evil.example:{port}", "127.0.0.1", f"127.0.0.1:{port + 1}"),
            "Origin": ("http://evil.example", "null", f"https://127.0.0.1:{port}", url.replace("7.0", "7.1")),
            "Sec-Fetch-Site": ("cross-site", "same-site"),
        }
        for name, values in strangers.items():
            for value in values:
                statuses = {answer(url, path, **{name: value})[0] for path in ("/", "/events")}
                assert statuses == {403}, value
        assert answer(url, "/etc/passwd")[0] == 404
        with socket.socket() as other, pytest.raises(ConnectionRefusedError):
            other.connect(("127.0.0.2", port))


class Growing(History):
    """History that grows each time somebody has looked: by a state, a report, a robot, and then no more."""

    looks = 0

    def states_since(self, generation: int = -1, index: int = 0) -> HistoryUpdate:
        found = super().states_since(generation, index)
        self.looks += 1
        if self.looks == 2:
            self.add(STATES[1])
        if self.looks == 3:
            self.report = {"robots": [], "frames": []}
        if self.looks == 4:
            self.add_robot(7)
        self.has_ended = self.looks == 6
        return found


def test_events_are_the_film_and_end_with_the_run() -> None:
    """Also where a state and a report come, a robot joins and the run ends while somebody watches."""
    live = Growing(STAGE)
    live.add(STATES[0])
    for history, robots, counts in ((live, [[0, 1], [0, 1, 7]], [1, 1, 2]), (OVER, [[0, 1]], [5])):
        with serving(history) as url:
            told = [each.splitlines() for each in answer(url, "/events")[1].split("\n\n") if each]
        assert told.pop() == ["event: end", "data: null"]
        contents = [(name, json.loads(data.removeprefix("data: "))) for name, data in told]
        stages = [content for name, content in contents if name == "event: stage"]
        assert [each["robots"] for each in stages] == robots
        assert [content["count"] for name, content in contents if name == "event: block"] == counts
        reports = [content for name, content in contents if name == "event: report"]
        assert reports == [history.report] * (history is live)
        assert {(each["title"], each["fill_ratio"]) for each in stages} == {(STAGE.title, 0.5)}


def test_a_port_is_free_again_at_once_and_one_that_is_taken_is_named() -> None:
    with serving(OVER, 65535) as url, socket.create_connection(("127.0.0.1", 65535)) as client:
        client.sendall(b"GET / HTTP/1.0\r\n\r\n")
        assert client.makefile().read().startswith("HTTP/1.1 403"), "the server closes first"
    with serving(OVER, 65535) as again:
        assert again == url == "http://127.0.0.1:65535/"
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(UsageError, match=rf"127.0.0.1:{port}: Address already in use; choose another"):
            serving(OVER, port).__enter__()
    for port in (-1, 65536):
        with pytest.raises(UsageError, match=f"--port is {port}; choose 1 to 65535"):
            serving(OVER, port).__enter__()
