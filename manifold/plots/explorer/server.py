"""The server of the page, on the loopback interface.

A page of another site cannot ask: requests carry a token that only the address of the page holds, the Host header
names the loopback interface, and the Origin header the page. Bodies are bounded in size and in time.
"""

from __future__ import annotations

import hmac
import json
import os
import secrets
import shutil
import socket
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, cast
from urllib.parse import SplitResult, parse_qs, unquote, urlsplit

from manifold.errors import UsageError
from manifold.plots.explorer.actions import Action, Context, action, complete, locate, plain_name
from manifold.plots.explorer.jobs import Queue
from manifold.system import temporary

LOOPBACK = "127.0.0.1"
MOST_JSON = 1 << 20  # bytes
MOST_FILE = 1 << 28
_SOCKET_S, _BODY_S = 10.0, 60.0  # without a byte, and for all headers; for a whole body
_MOST_CONNECTIONS = 32
_BLOCK = 1 << 16
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


class _Refused(Exception):
    """A request that is answered by a status and a sentence."""

    def __init__(self, status: HTTPStatus, words: str) -> None:
        super().__init__(words)
        self.status = status


class ExplorerServer(ThreadingHTTPServer):
    """Serves one page on the loopback interface.

    Attributes:
        token: what requests must carry.
        queue: of actions.
        dropped: folder of the files that were dropped, removed with the server.
    """

    daemon_threads = True
    allow_reuse_address = True
    request_queue_size = 128  # connections that wait to be taken: of more, some are reset

    def __init__(self, page: str, context: Context, port: int = 0, queue: Queue | None = None) -> None:
        """Listen on a port; 0 is any that is free.

        Raises:
            UsageError: the port is taken, or may not be used.
        """
        self.page, self.context = page.encode(), context
        self.token = secrets.token_urlsafe(24)
        self.queue = Queue(context.folder) if queue is None else queue
        self.naming = threading.Lock()  # from the choice of a free name until its job is queued
        self._connections = threading.BoundedSemaphore(_MOST_CONNECTIONS)
        self._folders = ExitStack()
        self.dropped = self._folders.enter_context(temporary.folder())
        try:
            super().__init__((LOOPBACK, port), _Handler)
        except (OSError, OverflowError) as error:
            raise UsageError(f"port {port} cannot be listened on ({error}); choose another --port") from None

    def server_close(self) -> None:
        """Stop listening, cancel everything, and remove what was dropped."""
        super().server_close()
        self.queue.close()
        self._folders.close()

    @property
    def address(self) -> str:
        """Of the page, token included."""
        return f"http://{LOOPBACK}:{self.server_port}/?token={self.token}"

    def process_request(self, request: Any, client_address: Any) -> None:
        """Take a connection, or close it where too many are open."""
        if not self._connections.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a connection in its thread."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._connections.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore broken connections."""


class _Handler(BaseHTTPRequestHandler):
    server_version, sys_version = "manifold", ""
    timeout = _SOCKET_S

    @property
    def _explorer(self) -> ExplorerServer:
        return cast(ExplorerServer, self.server)

    def handle(self) -> None:
        """Serve one request, whose headers must have come before long: drop by drop they would hold a connection."""
        self._headers_due = threading.Timer(_SOCKET_S, self._hang_up)
        self._headers_due.daemon = True
        self._headers_due.start()
        try:
            super().handle()
        finally:
            self._headers_due.cancel()

    def _hang_up(self) -> None:
        with suppress(OSError):
            self.connection.shutdown(socket.SHUT_RDWR)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing is logged: addresses hold the token."""

    def do_GET(self) -> None:
        """The page, the state of jobs, and pictures that were rendered."""
        self._answer(self._get)

    def do_POST(self) -> None:
        """Actions."""
        self._answer(self._post)

    def _answer(self, method: Any) -> None:
        self._headers_due.cancel()
        try:
            method()
        except _Refused as refused:
            self._send(refused.status, "application/json", _json({"error": str(refused)}))
        except UsageError as error:
            self._send(HTTPStatus.BAD_REQUEST, "application/json", _json({"error": str(error)}))
        except TimeoutError:
            self.close_connection = True

    def _get(self) -> None:
        parts = self._address()
        given = parse_qs(parts.query).get("token", [""])[0] or self.headers.get("X-Token", "")
        self._require_here(given)
        if parts.path == "/":
            self._send(HTTPStatus.OK, "text/html; charset=utf-8", self._explorer.page)
        elif parts.path == "/jobs":
            self._send_jobs()
        elif parts.path.startswith("/picture/"):
            self._send_picture(parts.path.removeprefix("/picture/"))
        else:
            raise _Refused(HTTPStatus.NOT_FOUND, "no such address")

    def _post(self) -> None:
        self._require_here(self.headers.get("X-Token", ""))
        if self._single_header("Origin") != f"http://{self._single_header('Host')}":
            raise _Refused(HTTPStatus.FORBIDDEN, "the request comes from another page")
        path = self._address().path
        if path == "/do/locate":
            name = plain_name(self.headers.get("X-Name"))
            self._take_file(name, lambda dropped: locate(dropped, self._explorer.context))
        elif path == "/do/complete":
            name, context = plain_name(self.headers.get("X-Name")), self._explorer.context
            sample = unquote(self.headers.get("X-Sample", ""), errors="replace")
            replace = self.headers.get("X-Replace") == "true"
            self._take_file(
                name,
                lambda dropped: complete(dropped, name, sample, context, self._is_taken, replace=replace),
            )
        elif path == "/do/cancel":
            number = self._json_body().get("number")
            found = isinstance(number, int) and self._explorer.queue.cancel(number)
            self._send(HTTPStatus.OK, "application/json", _json({"cancelled": found}))
        elif path.startswith("/do/"):
            self._do(path.removeprefix("/do/"))
        else:
            raise _Refused(HTTPStatus.NOT_FOUND, "no such address")

    def _do(self, kind: str) -> None:
        body = self._json_body()
        with self._explorer.naming:
            job = self._explorer.queue.add(action(kind, body, self._explorer.context, self._is_taken))
        self._send(HTTPStatus.ACCEPTED, "application/json", _json({"number": job.number}))

    def _is_taken(self, path: Path) -> bool:
        return os.path.lexists(path) or self._explorer.queue.is_writing(path)

    def _single_header(self, name: str) -> str | None:
        """A header that is there once."""
        values = self.headers.get_all(name, [])
        return values[0] if len(values) == 1 else None

    def _address(self) -> SplitResult:
        try:
            parts = urlsplit(self.path)
        except ValueError:
            parts = None
        if parts is None or parts.netloc:  # a proxy's
            raise _Refused(HTTPStatus.BAD_REQUEST, "no such address")
        return parts

    def _require_here(self, token: str) -> None:
        port = self._explorer.server_port
        ports = [f":{port}", *[""] * (port == 80)]  # that of HTTP is not said
        if self._single_header("Host") not in [
            f"{host}{p}" for host in (LOOPBACK, "localhost") for p in ports
        ]:
            raise _Refused(HTTPStatus.FORBIDDEN, "the request names another host")
        if not hmac.compare_digest(token.encode(), self._explorer.token.encode()):
            raise _Refused(
                HTTPStatus.FORBIDDEN, "no token, or an old one; open the address that manifold printed"
            )

    def _json_body(self) -> dict[str, Any]:
        if self.headers.get("Content-Type", "").split(";")[0] != "application/json":
            raise _Refused(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "expected application/json")
        blocks = bytearray()
        for block in self._blocks(MOST_JSON):
            blocks += block
        try:
            content = json.loads(blocks)
        except (ValueError, RecursionError):
            content = None
        if not isinstance(content, dict):
            raise _Refused(HTTPStatus.BAD_REQUEST, "expected a JSON object")
        return content

    def _blocks(self, most: int) -> Any:
        """The body in blocks, at most so many bytes, within a time."""
        text = self.headers.get("Content-Length", "")
        if not text.isdecimal() or self.headers.get("Transfer-Encoding"):
            self.close_connection = True
            raise _Refused(HTTPStatus.LENGTH_REQUIRED, "expected Content-Length")
        left, end = int(text[:20]), time.monotonic() + _BODY_S
        if left > most:
            self.close_connection = True
            raise _Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"expected at most {most} bytes")
        while left:
            block = self.rfile.read1(min(left, _BLOCK))
            if not block or time.monotonic() > end:
                raise TimeoutError
            left -= len(block)
            yield block

    def _take_file(self, name: str, asked: Callable[[Path], Action]) -> None:
        """Keep a dropped file aside, under its plain name, until what is asked for is done.

        A request that is refused is not read.
        """
        folder = Path(mkdtemp(dir=self._explorer.dropped))

        def remove() -> None:
            shutil.rmtree(folder, ignore_errors=True)

        try:
            dropped = folder / name
            asked(dropped)  # raises where it would be refused, before the body is read
            with dropped.open("wb") as stream:
                for block in self._blocks(MOST_FILE):
                    stream.write(block)
            with self._explorer.naming:
                job = self._explorer.queue.add(asked(dropped), remove)
        except BaseException:
            remove()
            raise
        self._send(HTTPStatus.ACCEPTED, "application/json", _json({"number": job.number}))

    def _send_jobs(self) -> None:
        jobs = [job.to_json() for job in self._explorer.queue.jobs()]
        self._send(HTTPStatus.OK, "application/json", _json({"jobs": jobs}))

    def _send_picture(self, number: str) -> None:
        for job in self._explorer.queue.jobs():
            if str(job.number) == number and job.has_picture and job.action.picture is not None:
                self._send(HTTPStatus.OK, "image/png", job.action.picture.read_bytes())
                return
        raise _Refused(HTTPStatus.NOT_FOUND, "no such picture")

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """What the base class refuses, such as other methods, in the words and headers of all answers."""
        self._send(HTTPStatus(code), "application/json", _json({"error": HTTPStatus(code).phrase}))

    def _send(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self.send_response(status)
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)


def _json(content: dict[str, Any]) -> bytes:
    return json.dumps(content).encode()
