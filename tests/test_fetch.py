"""`manifold.library.fetch` against a local server that misbehaves on request."""

from __future__ import annotations

import hashlib
import socket
import ssl
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from sample_files import write_samples

from manifold.errors import FetchError, UsageError
from manifold.library import downloading
from manifold.library.downloading import Downloader
from manifold.library.fetch import IncompleteFetchError, fetch
from manifold.library.rgl_table import Entry, rgl_table

CONTENT = np.random.default_rng(7).integers(0, 256, 300_000, dtype=np.uint8).tobytes()
HASH = hashlib.sha256(CONTENT).hexdigest()
QUICK = {"timeout_s": 0.3, "pause_s": 0.01}


@dataclass
class Behaviour:
    """How the server treats one material; lists are consumed, one element per request."""

    content: bytes = CONTENT
    status: int | None = None
    ignore_range: bool = False
    announce_length: bool = True
    stop_after: list[int] = field(default_factory=list)  # bytes of body, then the connection ends
    stall_after: list[int] = field(default_factory=list)  # bytes of body, then silence
    drip_s: float | None = None  # one byte per so many seconds
    location: str | None = None
    extra: bytes = b""
    shift: int = 0  # the range starts so many bytes before the asked one


class Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.behaviours: dict[str, Behaviour] = {}
        self.requests: list[tuple[str, str | None]] = []
        self.stopping = threading.Event()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/materials"

    def handle_error(self, request: object, client_address: object) -> None:
        """A client that hangs up is part of these tests."""


class Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"

    def log_message(self, *_: object) -> None:
        pass

    def do_GET(self) -> None:
        self.close_connection = True
        name = self.path.split("/")[-2]
        assert self.path == f"/materials/{name}/{name}_spec.bsdf"
        asked = self.headers.get("Range")
        self.server.requests.append((name, asked))
        behaviour = self.server.behaviours.get(name, Behaviour(status=404))
        if behaviour.status or behaviour.location:
            self.send_response(behaviour.status or 302)
            if behaviour.location:
                self.send_header("Location", behaviour.location)
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        self.send_body(behaviour, asked)

    def send_body(self, behaviour: Behaviour, asked: str | None) -> None:
        content, start = behaviour.content, 0
        if asked and not behaviour.ignore_range:
            start = int(asked.removeprefix("bytes=").removesuffix("-")) - behaviour.shift
            if start >= len(content):
                self.send_response(416)
                self.send_header("Content-Range", f"bytes */{len(content)}")
                self.send_header("Content-Length", "0")
                self.end_headers()
                return
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}")
        else:
            self.send_response(200)
        if behaviour.announce_length:
            self.send_header("Content-Length", str(len(content) - start + len(behaviour.extra)))
        self.end_headers()
        body = content[start:] + behaviour.extra
        if behaviour.drip_s:
            while not self.server.stopping.wait(behaviour.drip_s):
                self.wfile.write(b"x")
        if behaviour.stop_after:
            body = body[: behaviour.stop_after.pop(0)]
        if behaviour.stall_after:
            self.wfile.write(body[: behaviour.stall_after.pop(0)])
            self.server.stopping.wait(10)
            return
        self.wfile.write(body)


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server()
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield server
    server.stopping.set()
    server.shutdown()
    server.server_close()
    thread.join()


def table(*names: str) -> dict[str, Entry]:
    return {name: Entry(name, len(CONTENT), HASH) for name in names}


def test_any_break_of_the_connection_is_tried_again(server, tmp_path, monkeypatch):
    """Such as `ssl.SSLError`, an `OSError` that is no `ConnectionError`."""
    server.behaviours["broken"] = Behaviour()
    once, calls = Downloader._once, []

    def breaking(self, entry: Entry, part: Path, deadline: float) -> None:
        calls.append(entry.name)
        if len(calls) == 1:
            raise ssl.SSLError("record layer failure")
        once(self, entry, part, deadline)

    monkeypatch.setattr(Downloader, "_once", breaking)
    fetch(["broken"], tmp_path, base_url=server.url, table=table("broken"), **QUICK)
    assert calls == ["broken", "broken"]
    assert files(tmp_path) == {"broken_spec.bsdf"}


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_the_table_holds_51_isotropic_and_11_anisotropic_files() -> None:
    entries = rgl_table().values()
    isotropic = [entry for entry in entries if entry.is_isotropic]
    assert len(isotropic) == 51
    assert len(entries) == 62
    assert sum(entry.size_bytes or 0 for entry in isotropic) == 397_553_744
    assert all(len(bytes.fromhex(entry.sha256 or "")) == 32 for entry in isotropic)


def test_a_file_arrives_whole_under_its_name(server: Server, tmp_path: Path) -> None:
    server.behaviours["felt"] = Behaviour()
    seen: list[tuple[int, int, str]] = []
    result = fetch(
        ["felt"],
        tmp_path / "new",
        base_url=server.url,
        table=table("felt"),
        on_progress=lambda *a: seen.append(a),
    )
    assert result.downloaded == (tmp_path / "new" / "felt_spec.bsdf",)
    assert result.downloaded[0].read_bytes() == CONTENT
    assert files(tmp_path / "new") == {"felt_spec.bsdf"}
    assert seen[-1] == (len(CONTENT), len(CONTENT), "felt_spec.bsdf")
    assert [done for done, _, _ in seen] == sorted(done for done, _, _ in seen)


def test_without_names_all_files_come(server: Server, tmp_path: Path) -> None:
    server.behaviours |= {"a": Behaviour(), "b": Behaviour()}
    fetch(None, tmp_path, base_url=server.url + "/", table=table("a", "b"))
    assert files(tmp_path) == {"a_spec.bsdf", "b_spec.bsdf"}


def test_a_file_already_there_is_not_downloaded_again(server: Server, tmp_path: Path) -> None:
    (tmp_path / "felt_spec.bsdf").write_bytes(CONTENT)
    result = fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"))
    assert result.present == (tmp_path / "felt_spec.bsdf",)
    assert server.requests == []


def test_a_damaged_file_already_there_is_replaced(server: Server, tmp_path: Path) -> None:
    server.behaviours["felt"] = Behaviour()
    (tmp_path / "felt_spec.bsdf").write_bytes(CONTENT[:-1] + b"?")
    fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"))
    assert (tmp_path / "felt_spec.bsdf").read_bytes() == CONTENT


def test_a_partial_download_is_resumed(server: Server, tmp_path: Path) -> None:
    server.behaviours["felt"] = Behaviour()
    (tmp_path / "felt_spec.bsdf.part").write_bytes(CONTENT[:1000])
    fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"))
    assert server.requests == [("felt", "bytes=1000-")]
    assert (tmp_path / "felt_spec.bsdf").read_bytes() == CONTENT
    assert files(tmp_path) == {"felt_spec.bsdf"}


def test_a_whole_part_needs_no_request(server: Server, tmp_path: Path) -> None:
    (tmp_path / "felt_spec.bsdf.part").write_bytes(CONTENT)
    fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"))
    assert server.requests == []
    assert files(tmp_path) == {"felt_spec.bsdf"}


@pytest.mark.parametrize("announce_length", [True, False])
def test_a_server_that_ignores_ranges_sends_the_file_anew(
    server: Server, tmp_path: Path, announce_length: bool
) -> None:
    server.behaviours["felt"] = Behaviour(ignore_range=True, announce_length=announce_length)
    (tmp_path / "felt_spec.bsdf.part").write_bytes(b"x" * 1000)
    fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"))
    assert (tmp_path / "felt_spec.bsdf").read_bytes() == CONTENT


def test_a_part_longer_than_the_file_is_begun_again(server: Server, tmp_path: Path) -> None:
    server.behaviours["felt"] = Behaviour()
    (tmp_path / "felt_spec.bsdf.part").write_bytes(CONTENT + b"more")
    fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"), **QUICK)
    assert (tmp_path / "felt_spec.bsdf").read_bytes() == CONTENT


def test_a_part_of_a_shrunken_file_is_begun_again_on_416(server: Server, tmp_path: Path) -> None:
    server.behaviours["felt"] = Behaviour(content=CONTENT[:100])
    (tmp_path / "felt_spec.bsdf.part").write_bytes(CONTENT[:5000])
    with pytest.raises(FetchError, match="has 100 bytes, expected 300000"):
        fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"), **QUICK)
    assert server.requests == [("felt", "bytes=5000-"), ("felt", None)]
    assert "felt_spec.bsdf" not in files(tmp_path)


def test_another_range_than_asked_is_not_trusted(server: Server, tmp_path: Path) -> None:
    server.behaviours["felt"] = Behaviour(shift=10)
    (tmp_path / "felt_spec.bsdf.part").write_bytes(CONTENT[:1000])
    fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"), **QUICK)
    assert (tmp_path / "felt_spec.bsdf").read_bytes() == CONTENT


def test_rotten_bytes_of_an_old_part_cost_one_more_download(server: Server, tmp_path: Path) -> None:
    server.behaviours["felt"] = Behaviour()
    (tmp_path / "felt_spec.bsdf.part").write_bytes(b"rotten")
    fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"), **QUICK)
    assert server.requests == [("felt", "bytes=6-"), ("felt", None)]
    assert (tmp_path / "felt_spec.bsdf").read_bytes() == CONTENT


def test_wrong_bytes_are_refused_and_deleted(server: Server, tmp_path: Path) -> None:
    server.behaviours["felt"] = Behaviour(content=CONTENT[:-1] + b"?")
    with pytest.raises(
        FetchError, match=r"felt_spec\.bsdf: what arrived has SHA-256 .* expected " + HASH[:12]
    ):
        fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"))
    assert files(tmp_path) == set()


def test_a_dropped_connection_is_continued(server: Server, tmp_path: Path) -> None:
    server.behaviours["felt"] = Behaviour(stop_after=[100_000, 0, 50_000])
    fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"), **QUICK)
    assert (tmp_path / "felt_spec.bsdf").read_bytes() == CONTENT
    ranges = [asked for _, asked in server.requests]
    assert ranges == [None, "bytes=100000-", "bytes=100000-", "bytes=150000-"]


def test_a_file_truncated_every_time_is_an_error_and_keeps_its_part(server: Server, tmp_path: Path) -> None:
    server.behaviours["felt"] = Behaviour(stop_after=[5000] + [0] * 50)
    with pytest.raises(
        FetchError, match="ended after 5000 of 300000 bytes, 4 times without a new byte; 5000 bytes"
    ):
        fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"), **QUICK)
    assert files(tmp_path) == {"felt_spec.bsdf.part"}
    assert len(server.requests) == 4  # The first brought bytes, and counts as the first of four.


def test_a_short_file_is_refused_at_once(server: Server, tmp_path: Path) -> None:
    server.behaviours["felt"] = Behaviour(content=CONTENT[:-1])
    with pytest.raises(FetchError, match="the server's file has 299999 bytes, expected 300000"):
        fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"), **QUICK)
    assert len(server.requests) == 1
    assert "felt_spec.bsdf" not in files(tmp_path)


def test_a_file_without_end_is_cut_off(server: Server, tmp_path: Path) -> None:
    server.behaviours["felt"] = Behaviour(extra=b"x" * 3_000_000, announce_length=False)
    with pytest.raises(FetchError, match="more than the expected 300000 bytes"):
        fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"), **QUICK)
    assert "felt_spec.bsdf" not in files(tmp_path)


def test_a_stalled_server_is_an_error_after_the_timeout(server: Server, tmp_path: Path) -> None:
    server.behaviours["felt"] = Behaviour(stall_after=[10] * 50)
    with pytest.raises(FetchError, match=r"the server stalled for 0\.1 s"):
        fetch(
            ["felt"],
            tmp_path,
            base_url=server.url,
            table=table("felt"),
            timeout_s=0.1,
            attempts=1,
            pause_s=0.01,
        )
    assert files(tmp_path) == {"felt_spec.bsdf.part"}


def test_a_stall_is_overcome_by_another_connection(server: Server, tmp_path: Path) -> None:
    server.behaviours["felt"] = Behaviour(stall_after=[10])
    fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"), **QUICK)
    assert (tmp_path / "felt_spec.bsdf").read_bytes() == CONTENT


def test_a_dripping_server_counts_as_stalled(server: Server, tmp_path: Path) -> None:
    server.behaviours["felt"] = Behaviour(drip_s=0.02)
    start = time.monotonic()
    with pytest.raises(FetchError, match="stalled"):
        fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"), timeout_s=0.2, attempts=1)
    assert time.monotonic() - start < 5  # 300,000 bytes at 50 bytes/s would take over an hour


def test_a_missing_file_is_not_asked_for_twice(server: Server, tmp_path: Path) -> None:
    with pytest.raises(FetchError, match=r"felt_spec\.bsdf: the server answers 404 .* check the name"):
        fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"), **QUICK)
    assert len(server.requests) == 1
    assert files(tmp_path) == set()


def test_a_busy_server_is_asked_again_and_then_an_error(server: Server, tmp_path: Path) -> None:
    server.behaviours["felt"] = Behaviour(status=503)
    with pytest.raises(FetchError, match="answers 503"):
        fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"), **QUICK)
    assert len(server.requests) == 4


def test_a_vanished_server_ends_the_whole_fetch(tmp_path: Path) -> None:
    gone = Server()
    url = gone.url
    gone.server_close()
    with pytest.raises(IncompleteFetchError, match=r"1 not tried .*cannot reach") as caught:
        fetch(None, tmp_path, base_url=url, table=table("a", "b"), **QUICK)
    assert list(caught.value.failed) == ["a"]


def test_one_bad_file_does_not_stop_the_others(server: Server, tmp_path: Path) -> None:
    server.behaviours |= {"a": Behaviour(), "b": Behaviour(content=b"?" * len(CONTENT)), "d": Behaviour()}
    with pytest.raises(IncompleteFetchError, match="2 of 4 files failed") as caught:
        fetch(None, tmp_path, base_url=server.url, table=table("a", "b", "c", "d"), **QUICK)
    assert files(tmp_path) == {"a_spec.bsdf", "d_spec.bsdf"}
    assert set(caught.value.failed) == {"b", "c"}
    assert [path.name for path in caught.value.result.downloaded] == ["a_spec.bsdf", "d_spec.bsdf"]


def test_a_full_disk_is_one_error_and_leaves_no_file(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    server.behaviours["felt"] = Behaviour()
    monkeypatch.setattr(downloading, "_write_all", full)
    with pytest.raises(FetchError, match="No space left on device; make room"):
        fetch(["felt"], tmp_path, base_url=server.url, table=table("felt"), **QUICK)
    assert "felt_spec.bsdf" not in files(tmp_path)


def test_a_folder_that_cannot_be_made_is_one_error(server: Server, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(FetchError, match="choose another folder"):
        fetch(["felt"], tmp_path / "file" / "folder", base_url=server.url, table=table("felt"))


def test_an_unknown_name_gets_near_matches(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"paper_whit: no such material.*paper_white"):
        fetch(["paper_whit"], tmp_path)


@pytest.mark.parametrize("url", ["file:///etc", "ftp://example.org/x", "/local/folder", "http://"])
def test_only_web_addresses_are_taken(tmp_path: Path, url: str) -> None:
    with pytest.raises(UsageError, match="not a web address"):
        fetch(["felt"], tmp_path, base_url=url, table=table("felt"))


def test_a_redirect_to_a_local_file_is_refused(server: Server, tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(CONTENT)
    server.behaviours["felt"] = Behaviour(location=secret.as_uri())
    with pytest.raises(FetchError):
        fetch(["felt"], tmp_path / "to", base_url=server.url, table=table("felt"), **QUICK)
    assert files(tmp_path / "to") == set()


def test_a_file_without_checksum_must_at_least_be_valid(server: Server, tmp_path: Path) -> None:
    server.behaviours["aniso"] = Behaviour()
    with pytest.raises(FetchError, match="no checksum known, and the content is not a valid file"):
        fetch(["aniso"], tmp_path, base_url=server.url, table={"aniso": Entry("aniso", None, None, False)})
    assert files(tmp_path) == set()


def test_a_valid_file_without_checksum_is_taken_and_named(server: Server, tmp_path: Path) -> None:
    path = write_samples(tmp_path / "made", 1)[0]
    server.behaviours["aniso"] = Behaviour(content=path.read_bytes())
    (tmp_path / "to").mkdir()
    (tmp_path / "to" / "aniso_spec.bsdf.part").write_bytes(path.read_bytes())  # whole: the server answers 416
    for _ in range(2):
        result = fetch(
            ["aniso"], tmp_path / "to", base_url=server.url, table={"aniso": Entry("aniso", None, None)}
        )
        assert result.without_checksum == ("aniso",)
    assert len(result.present) == 1
    assert (tmp_path / "to" / "aniso_spec.bsdf").read_bytes() == path.read_bytes()


def _raw_server(answer) -> tuple[str, threading.Thread]:
    """A server that answers every connection by a function of its socket; its URL."""
    listening = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with listening:
            for _ in range(2):
                connection, _ = listening.accept()
                with connection, suppress(OSError):
                    connection.recv(65536)
                    answer(connection)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    return f"http://127.0.0.1:{listening.getsockname()[1]}/m", thread


def _endless_continue(connection) -> None:
    while True:
        connection.sendall(b"HTTP/1.1 100 Continue\r\n\r\n")
        time.sleep(0.02)


def _dripping_headers(connection) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\nX: ")
    while True:
        connection.sendall(b"x")
        time.sleep(0.02)


def _dripping_chunks(connection) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n1;")
    while True:
        connection.sendall(b"x")
        time.sleep(0.02)


def _just_fast_enough(connection) -> None:
    connection.sendall(f"HTTP/1.1 200 OK\r\nContent-Length: {len(CONTENT)}\r\n\r\n".encode())
    for byte in range(0, len(CONTENT), 1000):
        connection.sendall(CONTENT[byte : byte + 1000])
        time.sleep(0.02)


@pytest.mark.parametrize(
    "answer", [_endless_continue, _dripping_headers, _dripping_chunks, _just_fast_enough]
)
def test_a_server_that_never_ends_is_given_up(tmp_path, answer):
    url, _ = _raw_server(answer)
    began = time.monotonic()
    with pytest.raises(FetchError, match=r"stalled|not done after"):
        fetch(["m"], tmp_path, base_url=url, table=table("m"), attempts=2, deadline_s=1.0, **QUICK)
    assert time.monotonic() - began < 4.0  # 1 s, and what a busy machine takes


def test_lengths_of_thousands_of_digits_and_odd_redirections_are_one_error(server, tmp_path):
    url, _ = _raw_server(
        lambda c: c.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: " + b"9" * 5000 + b"\r\n\r\nx")
    )
    with pytest.raises(FetchError):
        fetch(["m"], tmp_path, base_url=url, table=table("m"), attempts=2, **QUICK)
    server.behaviours["odd"] = Behaviour(location="http://[bad")
    with pytest.raises(FetchError):
        fetch(["odd"], tmp_path, base_url=server.url, table=table("odd"), attempts=1, **QUICK)


@pytest.mark.parametrize(
    "url",
    [
        "http://[",
        "http://h:99999999",
        "http://h:x",
        "http://a b/",
        "http://h\x1b/",
        "http:///x",
        "http://h/?q=1",
    ],
)
def test_base_urls_that_are_none_are_refused(tmp_path, url):
    with pytest.raises(UsageError, match="web address"):
        fetch(["m"], tmp_path, base_url=url, table=table("m"))


def test_a_password_in_a_base_url_is_not_repeated(tmp_path):
    for url in ("http://me:secret@host/", "https://me:secret@[", "ftp://me:secret@host"):
        with pytest.raises(UsageError) as caught:
            fetch(["m"], tmp_path, base_url=url, table=table("m"))
        assert "secret" not in str(caught.value)


def test_a_planted_part_does_not_lead_elsewhere(server, tmp_path):
    server.behaviours["m"] = Behaviour()
    (tmp_path / "victim").write_text("mine")
    (tmp_path / "to").mkdir()
    (tmp_path / "to" / "m_spec.bsdf.part").symlink_to(tmp_path / "victim")
    fetch(["m"], tmp_path / "to", base_url=server.url, table=table("m"), **QUICK)
    assert (tmp_path / "victim").read_text() == "mine"
    assert (tmp_path / "to" / "m_spec.bsdf").read_bytes() == CONTENT
