"""The server answers browsers of this computer that show its own page, and nobody else."""

from __future__ import annotations

import http.client
import json
import socket
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from urllib.parse import urlsplit

import numpy as np
import pytest

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.view.film import Film, LiveFilm, Samples, Stage
from mcp_asdf_tools.view.page import page
from mcp_asdf_tools.view.server import serving
from support import PATIENCE

STAGE = Stage("two </script> robots", [0, 1], fill_ratio=0.5)
SAMPLES = Samples(np.arange(5), np.full((5, 4, 2), 0.25), np.zeros((5, 2, 2), np.bool_), None)


@contextmanager
def asked(
    url: str, path: str = "/", headers: dict[str, str] | None = None
) -> Iterator[http.client.HTTPResponse]:
    """The answer to a request with these headers."""
    with closing(http.client.HTTPConnection(urlsplit(url).netloc, timeout=PATIENCE)) as connection:
        connection.request("GET", path, headers=headers or {})
        with connection.getresponse() as response:
            yield response


def status(url: str, path: str = "/", headers: dict[str, str] | None = None) -> int:
    with asked(url, path, headers) as response:
        return response.status


def test_only_the_page_itself_is_answered() -> None:
    with serving(LiveFilm.of(Film(STAGE, SAMPLES))) as url:
        port = urlsplit(url).port or 0
        assert url.startswith("http://127.0.0.1:")
        own = {"Origin": f"http://127.0.0.1:{port}", "Sec-Fetch-Site": "same-origin"}
        for headers in ({}, own, {"Host": f"localhost:{port}"}, {"Sec-Fetch-Site": "none"}):
            assert status(url, headers=headers) == 200
        strangers = [
            {"Host": "evil.example"},
            {"Host": f"evil.example:{port}"},
            {"Host": "127.0.0.1"},
            {"Host": f"127.0.0.1:{port + 1}"},
            {"Origin": "http://evil.example"},
            {"Origin": "null"},
            {"Origin": f"https://127.0.0.1:{port}"},
            {"Origin": f"http://127.0.0.1:{port + 1}"},
            {"Sec-Fetch-Site": "cross-site"},
            {"Sec-Fetch-Site": "same-site"},
        ]
        for headers in strangers:
            for path in ("/", "/events"):
                assert status(url, path, headers) == 403, headers
        assert status(url, "/etc/passwd") == 404


def test_it_listens_on_this_computer_alone() -> None:
    with (
        serving(LiveFilm.of(Film(STAGE, SAMPLES))) as url,
        socket.socket() as other,
        pytest.raises(ConnectionRefusedError),
    ):
        other.connect(("127.0.0.2", urlsplit(url).port))


def test_events_are_the_film() -> None:
    with serving(LiveFilm.of(Film(STAGE, SAMPLES))) as url, asked(url, "/events") as response:
        text = response.read().decode()
    events = [dict(line.split(": ", 1) for line in each.splitlines()) for each in text.split("\n\n") if each]
    assert [each["event"] for each in events] == ["stage", "block", "end"]
    assert json.loads(events[0]["data"])["title"] == STAGE.title
    assert json.loads(events[1]["data"])["count"] == 5


def test_a_run_that_ends_ends_its_streams() -> None:
    live = LiveFilm(STAGE)
    with serving(live) as url, asked(url, "/events") as response:
        live.end()
        assert response.read().decode().endswith("event: end\ndata: null\n\n")


def test_no_text_of_a_film_ends_its_script() -> None:
    text = page(Film(STAGE, SAMPLES))
    begin = text.index('<script id="film"')
    assert "two \\u003c/script>" in text[begin : text.index("</script>", begin)]
    assert "__" not in text[:begin].replace("__proto__", "")
    assert "Permission is hereby granted" in text


def test_a_port_that_is_taken_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(UsageError, match=rf"127.0.0.1:{port}: Address already in use; choose another"):
            serving(LiveFilm(STAGE), port).__enter__()
    with pytest.raises(UsageError, match="--port is 65536; choose 1 to 65535"):
        serving(LiveFilm(STAGE), 65536).__enter__()


@pytest.mark.parametrize("package", ["uvicorn", "starlette.applications"])
def test_the_extra_is_named_where_it_is_missing(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(UsageError, match=r"needs the package .*: pip install 'mcp-asdf\[view\]'"):
        serving(LiveFilm(STAGE)).__enter__()
