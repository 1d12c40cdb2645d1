"""HTTP connections that end at a deadline, whatever the server does.

The timeout of a socket begins anew with every byte: headers that drip, and endless `100 Continue`, outlast it.
"""

from __future__ import annotations

import http.client
import socket
import threading
import urllib.request
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache


class _Watch(threading.local):
    """The connections of a thread, and whether their time is over."""

    def __init__(self) -> None:
        self.clock: _Clock | None = None


class _Clock:
    def __init__(self, sockets: Iterable[socket.socket]) -> None:
        self.is_over = False
        self.sockets = list(sockets)

    def ring(self) -> None:
        self.is_over = True
        for one in self.sockets:
            with suppress(OSError):  # closed already
                one.shutdown(socket.SHUT_RDWR)


_watch = _Watch()


@contextmanager
def time_limit(seconds: float, sockets: Iterable[socket.socket] = ()) -> Iterator[list[socket.socket]]:
    """End connections after a time: some that there are, and all that `opener` makes for this thread in the block.

    Yields:
        These connections.
    Raises:
        TimeoutError: that time is over.
    """
    clock, before = _Clock(sockets), _watch.clock
    timer = threading.Timer(max(seconds, 0.0), clock.ring)
    timer.daemon = True
    _watch.clock = clock
    timer.start()
    try:
        yield clock.sockets
    except Exception as error:
        if clock.is_over:
            raise TimeoutError from error
        raise
    finally:
        timer.cancel()
        _watch.clock = before
    if clock.is_over:
        raise TimeoutError


def _watched(connection: http.client.HTTPConnection) -> None:
    clock = _watch.clock
    if clock is not None:
        clock.sockets.append(connection.sock)
        if clock.is_over:
            raise TimeoutError


class _Connection(http.client.HTTPConnection):
    def connect(self) -> None:
        super().connect()
        _watched(self)


class _SecureConnection(http.client.HTTPSConnection):
    def connect(self) -> None:
        super().connect()
        _watched(self)


class _Handler(urllib.request.HTTPHandler):
    def http_open(self, request: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(_Connection, request)


class _SecureHandler(urllib.request.HTTPSHandler):
    def https_open(self, request: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(_SecureConnection, request)


@cache
def opener() -> urllib.request.OpenerDirector:
    """Speaks http and https, through the user's proxies; unlike `urlopen`, no file:, ftp: or data:."""
    made = urllib.request.OpenerDirector()
    for handler in (
        urllib.request.ProxyHandler,
        _Handler,
        _SecureHandler,
        urllib.request.HTTPRedirectHandler,
        urllib.request.HTTPErrorProcessor,
        urllib.request.HTTPDefaultErrorHandler,
        urllib.request.UnknownHandler,
    ):
        made.add_handler(handler())
    return made
