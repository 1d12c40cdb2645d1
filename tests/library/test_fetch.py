"""`manifold.library.fetch` against a local server that misbehaves on request."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from helpers.paths import REPOSITORY
from helpers.sample_files import write_samples

from manifold.core import progress
from manifold.core.errors import FetchError, UsageError
from manifold.library.fetch import Entry, IncompleteFetchError, fetch, rgb_table, rgl_table, select

CONTENT = np.random.default_rng(7).integers(0, 256, 300_000, dtype=np.uint8).tobytes()
HASH = hashlib.sha256(CONTENT).hexdigest()
QUICK = {"timeout_s": 0.5, "attempts": 1}


@dataclass
class Behaviour:
    """How the server treats one material."""

    content: bytes = CONTENT
    status: int | None = None
    stop_after: int | None = None  # bytes of body, then the connection ends
    stall_after: int | None = None  # bytes of body, then silence
    location: str | None = None


class Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.behaviours: dict[str, Behaviour] = {}
        self.requests: list[str] = []
        self.stopping = threading.Event()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/materials"

    def handle_error(self, request: object, client_address: object) -> None:
        """A client that hangs up is part of these tests."""


class Handler(BaseHTTPRequestHandler):
    server: Server

    def log_message(self, *_: object) -> None:
        pass

    def do_GET(self) -> None:
        name = self.path.split("/")[-2]
        assert self.path in (f"/materials/{name}/{name}_{kind}.bsdf" for kind in ("spec", "rgb"))
        self.server.requests.append(name)
        behaviour = self.server.behaviours.get(name, Behaviour(status=404))
        self.send_response(behaviour.status or (302 if behaviour.location else 200))
        if behaviour.location:
            self.send_header("Location", behaviour.location)
        body = b"" if behaviour.status or behaviour.location else behaviour.content
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if behaviour.stall_after is not None:
            self.wfile.write(body[: behaviour.stall_after])
            self.server.stopping.wait(30)
        else:
            self.wfile.write(body[: behaviour.stop_after])


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server()
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    yield server
    server.stopping.set()
    server.shutdown()
    server.server_close()


def table(*names: str) -> dict[str, Entry]:
    return {name: Entry(name, len(CONTENT), HASH) for name in names}


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_the_table_holds_51_isotropic_and_11_anisotropic_files() -> None:
    isotropic = [entry for entry in rgl_table().values() if entry.is_isotropic]
    assert len(isotropic) == 51
    assert sum(entry.size_bytes or 0 for entry in isotropic) == 397_553_744
    assert sum(not entry.is_isotropic and entry.sha256 is None for entry in rgl_table().values()) == 11


def test_rgb_files_without_names_are_the_twenty_of_the_evaluation() -> None:
    page = (REPOSITORY / "docs/explanation/data.md").read_text(encoding="utf-8")
    chosen = select(None, rgb_table(), anisotropic=False)
    assert len(chosen) == 20
    for entry in chosen:
        assert f"`{entry.file}`" in page
    assert [entry.file for entry in select(["satin_gold"], rgb_table(), False)] == ["satin_gold_rgb.bsdf"]


def test_rgb_files_have_their_own_names(server: Server, tmp_path: Path) -> None:
    server.behaviours = {"a": Behaviour(content=CONTENT)}
    result = fetch(
        ["a"],
        tmp_path,
        base_url=server.url,
        rgb=True,
        table={"a": Entry("a", len(CONTENT), HASH, is_rgb=True)},
    )
    assert [path.name for path in result.downloaded] == ["a_rgb.bsdf"]
    with pytest.raises(UsageError, match="expected one"):
        fetch(None, tmp_path, base_url=server.url, rgb=True, anisotropic=True)


def test_files_arrive_whole_and_are_not_downloaded_again(server: Server, tmp_path: Path) -> None:
    server.behaviours = {"a": Behaviour(), "b": Behaviour()}
    steps: list[tuple[int, int, str]] = []
    options = {"base_url": server.url, "table": table("a", "b"), **QUICK}
    with progress.listen(lambda *step: steps.append(step)):
        result = fetch(None, tmp_path / "new", **options)
    assert files(tmp_path / "new") == {"a_spec.bsdf", "b_spec.bsdf"}
    assert all(path.read_bytes() == CONTENT for path in result.downloaded)
    assert steps[-1] == (2 * len(CONTENT), 2 * len(CONTENT), "b_spec.bsdf")
    (tmp_path / "new" / "a_spec.bsdf").write_bytes(b"damaged")
    result = fetch(None, tmp_path / "new", **options)
    assert [path.name for path in result.downloaded] == ["a_spec.bsdf"]
    assert [path.name for path in result.present] == ["b_spec.bsdf"]
    assert server.requests == ["a", "b", "a"]


@pytest.mark.parametrize(
    "behaviour",
    [
        Behaviour(content=CONTENT[:-1] + b"x"),
        Behaviour(content=CONTENT[:1000]),
        Behaviour(content=CONTENT * 4),
        Behaviour(stop_after=1000),
        Behaviour(stall_after=1000),
        Behaviour(status=404),
        Behaviour(status=503),
        Behaviour(location="file:///etc/hostname"),
        Behaviour(location="http://[::1"),
    ],
    ids=["bytes", "short", "long", "dropped", "stalled", "missing", "busy", "local file", "odd redirection"],
)
def test_a_bad_file_is_one_line_and_does_not_stop_the_others(server, tmp_path, behaviour) -> None:
    server.behaviours = {"a": Behaviour(), "bad": behaviour, "c": Behaviour()}
    with pytest.raises(
        IncompleteFetchError, match=r"1 of 3 files failed \(bad_spec\.bsdf: .*\); 2 are in"
    ) as e:
        fetch(None, tmp_path, base_url=server.url, table=table("a", "bad", "c"), **QUICK)
    assert "\n" not in str(e.value)
    assert list(e.value.failed) == ["bad"]
    assert files(tmp_path) == {"a_spec.bsdf", "c_spec.bsdf"}


def test_a_busy_server_is_asked_again(server: Server, tmp_path: Path) -> None:
    server.behaviours["a"] = Behaviour(status=503)
    with pytest.raises(FetchError, match="503"):
        fetch(["a"], tmp_path, base_url=server.url, table=table("a"), timeout_s=0.5, attempts=2)
    assert server.requests == ["a", "a"]


def test_a_server_that_cannot_be_reached_ends_the_whole_fetch(tmp_path: Path) -> None:
    with pytest.raises(IncompleteFetchError) as error:
        fetch(None, tmp_path, base_url="http://127.0.0.1:9", table=table("a", "b"), **QUICK)
    assert list(error.value.failed) == ["a", "b"]
    assert error.value.failed["a"] == "no network (host 127.0.0.1 cannot be reached)"
    assert error.value.failed["b"] == "not tried"
    assert "2 of 2 files failed" in str(error.value)


def test_files_that_are_there_are_counted_when_the_server_cannot_be_reached(
    server: Server, tmp_path: Path
) -> None:
    server.behaviours = {"b": Behaviour()}
    fetch(["b"], tmp_path, base_url=server.url, table=table("b"), **QUICK)
    with pytest.raises(IncompleteFetchError, match=r"2 of 3 files failed.*; 1 are in") as error:
        fetch(None, tmp_path, base_url="http://127.0.0.1:9", table=table("a", "b", "c"), **QUICK)
    assert [path.name for path in error.value.result.present] == ["b_spec.bsdf"]


def test_a_folder_that_cannot_be_made_is_one_error(server: Server, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(FetchError, match="choose another folder"):
        fetch(["a"], tmp_path / "file" / "x", base_url=server.url, table=table("a"), **QUICK)


def test_an_unknown_name_gets_near_matches(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="paper_blue"):
        fetch(["paper_blu"], tmp_path)


@pytest.mark.parametrize(
    "url", ["file:///etc", "ftp://example.org/x", "/local", "http://", "http://a/?x", "http://["]
)
def test_only_web_addresses_of_folders_are_taken(tmp_path: Path, url: str) -> None:
    with pytest.raises(UsageError, match="expected http"):
        fetch(["a"], tmp_path, base_url=url, table=table("a"))


def test_a_file_without_checksum_must_be_valid_and_is_named(server: Server, tmp_path: Path) -> None:
    (path,) = write_samples(tmp_path / "made", 1)
    server.behaviours = {"good": Behaviour(content=path.read_bytes()), "bad": Behaviour()}
    known = {name: Entry(name, None, None, is_isotropic=False) for name in ("good", "bad")}
    (tmp_path / "to").mkdir()
    (tmp_path / "to" / "good_spec.bsdf").write_bytes(b"an earlier, damaged one")
    with pytest.raises(IncompleteFetchError, match="no checksum known") as error:
        fetch(["good", "bad"], tmp_path / "to", base_url=server.url, table=known, **QUICK)
    assert error.value.result.without_checksum == ("good",)
    assert files(tmp_path / "to") == {"good_spec.bsdf"}
