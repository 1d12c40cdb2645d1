"""The server of the page, on the loopback interface.

Pages of other sites cannot send requests: a request must carry a token that only the address of the page contains,
its Host header must name the loopback interface, and its Origin header the page. The size of requests is limited.
"""

from __future__ import annotations

import hmac
import json
import secrets
import shutil
import threading
from collections.abc import Callable, Iterator
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, cast
from urllib.parse import parse_qs, unquote

from manifold.core.disk import refuse_constant
from manifold.core.errors import UsageError
from manifold.page.commands import COMMANDS, Context, call_of
from manifold.page.jobs import Job, Queue

LOOPBACK = "127.0.0.1"
MOST_JSON = 1 << 20  # bytes
MOST_FILE = 1 << 28
_BLOCK = 1 << 16
_LONGEST_NAME = 40  # characters of a command's name
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class _RequestError(Exception):
    """A request that is answered by a status and a sentence."""

    def __init__(self, status: HTTPStatus, message: str) -> None:
        super().__init__(message)
        self.status = status


class ExplorerServer(ThreadingHTTPServer):
    """Serves one page on the loopback interface.

    Attributes:
        token: token that requests must carry.
        naming: lock that is held from the choice of a free name until its job is queued.
    """

    daemon_threads = True
    request_queue_size = 128  # connections that wait to be accepted

    def __init__(self, page: str, context: Context, port: int = 0, queue: Queue | None = None) -> None:
        """Listen on a port; 0 is any free port."""
        try:
            super().__init__((LOOPBACK, port), _Handler)
        except OSError as error:
            raise UsageError(f"cannot listen on port {port} ({error.strerror}); choose another") from None
        self.page, self.context = page.encode(), context
        self.token = secrets.token_urlsafe(24)
        self.queue = Queue() if queue is None else queue
        self.naming = threading.Lock()

    def server_close(self) -> None:
        """Stop listening, cancel everything, and remove dropped files."""
        super().server_close()
        if hasattr(self, "queue"):  # the base class closes a server that could not listen
            self.queue.close()

    @property
    def address(self) -> str:
        """Return the address of the page, including the token."""
        return f"http://{LOOPBACK}:{self.server_port}/?token={self.token}"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore broken connections."""


class _Handler(BaseHTTPRequestHandler):
    server_version, sys_version = "manifold", ""
    timeout = 10.0  # seconds without a byte

    @property
    def _explorer(self) -> ExplorerServer:
        return cast(ExplorerServer, self.server)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing, because addresses hold the token."""

    def do_GET(self) -> None:
        """Answer with the page, the state of jobs, and rendered pictures."""
        self._answer(self._get)

    def do_POST(self) -> None:
        """Answer calls of commands."""
        self._answer(self._post)

    def _answer(self, method: Callable[[], None]) -> None:
        try:
            method()
        except _RequestError as error:
            self._send_json(error.status, {"error": str(error)})
        except UsageError as error:
            self._send_json(HTTPStatus.BAD_REQUEST, {"error": str(error)})

    def _get(self) -> None:
        path, _, query = self.path.partition("?")
        self._require_page(parse_qs(query).get("token", [""])[0] or self.headers.get("X-Token", ""))
        jobs = self._explorer.queue.jobs
        if path == "/":
            self._send(HTTPStatus.OK, "text/html; charset=utf-8", self._explorer.page)
        elif path == "/jobs":
            self._send_json(HTTPStatus.OK, {"jobs": [job.to_json() for job in jobs]})
        elif pictures := [j.call.picture for j in jobs if j.has_picture and path == f"/picture/{j.number}"]:
            self._send(HTTPStatus.OK, "image/png", cast(Path, pictures[0]).read_bytes())
        else:
            raise _RequestError(HTTPStatus.NOT_FOUND, "no such address")

    def _post(self) -> None:
        self._require_page(self.headers.get("X-Token", ""))
        if self.headers.get("Origin") != f"http://{self.headers.get('Host')}":
            raise _RequestError(HTTPStatus.FORBIDDEN, "the request comes from another page")
        server, name = self._explorer, self.path.removeprefix("/do/")
        if name == "cancel":
            is_cancelled = server.queue.cancel(self._json_body().get("number", 0))
            self._send_json(HTTPStatus.OK, {"cancelled": is_cancelled})
            return
        name = name[:_LONGEST_NAME]
        job = self._file_call(name) if COMMANDS[name].takes_file else self._call(name, self._json_body())
        self._send_json(HTTPStatus.ACCEPTED, {"number": job.number})

    def _call(self, name: str, request: dict[str, Any], file: Path | None = None) -> Job:
        """Queue a call of a command."""
        server = self._explorer
        with server.naming:
            return server.queue.add(call_of(name, request, server.context, self._is_taken, file))

    def _file_call(self, name: str) -> Job:
        """Queue a call about the body, a file in a folder of its own, which is removed if the call is refused."""
        request = _json_object(unquote(self.headers.get("X-Request", ""), errors="replace"))
        COMMANDS[name].check(request)
        folder = Path(mkdtemp(dir=self._explorer.queue.inputs))
        try:
            with (folder / request["name"]).open("wb") as stream:
                stream.writelines(self._blocks(MOST_FILE))
            return self._call(name, request, folder / request["name"])
        except BaseException:  # also of a connection that ends early
            shutil.rmtree(folder)
            raise

    def _is_taken(self, path: Path) -> bool:
        return path.exists() or self._explorer.queue.is_writing(path)

    def _require_page(self, token: str) -> None:
        """Raise _RequestError unless a request comes from the page."""
        port = self._explorer.server_port
        if self.headers.get("Host") not in (f"{LOOPBACK}:{port}", f"localhost:{port}"):
            raise _RequestError(HTTPStatus.FORBIDDEN, "the request names another host")
        if not hmac.compare_digest(token.encode(), self._explorer.token.encode()):
            raise _RequestError(
                HTTPStatus.FORBIDDEN, "no token, or an old one; open the address that manifold printed"
            )

    def _json_body(self) -> dict[str, Any]:
        return _json_object(b"".join(self._blocks(MOST_JSON)))

    def _blocks(self, most: int) -> Iterator[bytes]:
        """Yield the body in blocks, at most `most` bytes."""
        text = self.headers.get("Content-Length", "")
        if not text.isdecimal():
            raise _RequestError(HTTPStatus.LENGTH_REQUIRED, "expected Content-Length")
        left = int(text[:20])
        if left > most:
            raise _RequestError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"expected at most {most} bytes")
        while left:
            block = self.rfile.read1(min(left, _BLOCK))
            if not block:
                raise ConnectionError("the body ended early")
            left -= len(block)
            yield block

    def _send_json(self, status: HTTPStatus, content: dict[str, Any]) -> None:
        self._send(status, "application/json", json.dumps(content).encode())

    def _send(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self.send_response(status)
        for name, value in {**_HEADERS, "Content-Type": kind, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)


def _json_object(text: str | bytes) -> dict[str, Any]:
    try:
        content = json.loads(text, parse_constant=refuse_constant)
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise _RequestError(HTTPStatus.BAD_REQUEST, "expected a JSON object")
    return content
