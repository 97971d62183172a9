"""A small HTTP server for a page on this machine, which no other web site can use or stop.

Only who knows the address with its secret, new at each start, gets an answer, and only on this
machine. A web site that is open in the same browser cannot read it under another name (DNS
rebinding: Host), nor ask in its own (Origin, Sec-Fetch-Site), nor frame it. A request is a short
GET; all else is refused with a status and its standard text. Requests are answered one after the
other, unless the client has hung up meanwhile, and nothing is kept between requests, so that no
client can write to another's page. See the OWASP cheat sheets on cross-site request forgery and
HTTP headers.
"""

from __future__ import annotations

import hmac
import io
import re
import secrets
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from socketserver import TCPServer, ThreadingMixIn
from types import MappingProxyType
from urllib.parse import parse_qsl, urlsplit

from fenics_joints.errors import InputError

HOST = "127.0.0.1"
#: Names of this machine; another port is that of a tunnel, as by ssh -L.
_HOSTS = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d{1,5})?", re.ASCII | re.IGNORECASE)
#: Bytes of a request up to its empty line; a browser sends about 1,000.
_LONGEST_HEAD = 16384
#: Most fields of a query; the page sends half as many.
_MOST_FIELDS = 20
#: Most connections at once, while others wait; and most of them without a request yet, the oldest
#: of which are closed for new ones.
_MOST_AT_ONCE, _MOST_IDLE = 128, 32
#: Seconds between checks whether the client of a waiting request is still connected.
_TO_LOOK = 0.1
#: Seconds for a request to come, for a reply to leave, and for the client to hang up after it.
_TO_COME, _TO_LEAVE, _TO_HANG_UP = 5.0, 10.0, 0.5
#: Seconds for answers under way when the page ends.
_TO_END = 10.0
#: Or the signal of a closed pipe could end the process.
_NO_SIGNAL = getattr(socket, "MSG_NOSIGNAL", 0)
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
#: A picture has styles of its own, and opened alone it is a page that may do nothing.
_PICTURE_POLICY = "default-src 'none'; style-src 'unsafe-inline'; sandbox; frame-ancestors 'none'"
_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Refused(Exception):
    """A request that gets no answer.

    Args:
        status: Why.
    """

    def __init__(self, status: HTTPStatus):
        super().__init__(status.phrase)
        self.status = status


@dataclass(frozen=True)
class Reply:
    """The answer to a request.

    Attributes:
        body: Bytes, text in UTF-8.
        kind: Media type.
    """

    body: bytes
    kind: str


class PageServer(ThreadingMixIn, TCPServer):
    """Listens on this machine only, from its making on; `serve_forever` answers.

    Args:
        answer: Reply to a path below the secret one ("" for the page) and the fields of the query;
            raises `Refused`. Called from several threads, one at a time.
        port: 0 for any that is free.

    Attributes:
        url: Address of the page, with the secret.

    Raises:
        InputError: If the port is taken.
    """

    daemon_threads = allow_reuse_address = True
    request_queue_size = 128

    def __init__(self, answer: Callable[[str, Mapping[str, str]], Reply], port: int):
        self._answer, self._free = answer, threading.Semaphore(_MOST_AT_ONCE)
        self._turn, self._idle = threading.Lock(), dict[socket.socket, None]()
        try:
            super().__init__((HOST, port), _Request)
        except OSError as error:
            raise InputError(
                f"--port {port}: {error.strerror}; expected one that is free, or 0 for any"
            ) from error
        self._secret = secrets.token_urlsafe(24)
        self.url = f"http://{HOST}:{self.server_address[1]}/{self._secret}/"

    def answer(self, path: str, fields: Mapping[str, str], client: socket.socket) -> Reply:
        """The reply to a path below the secret one; raises `Refused`, or ConnectionError if the
        client hung up before its turn."""
        while not self._turn.acquire(timeout=_TO_LOOK):
            client.settimeout(0.0)
            with suppress(BlockingIOError):  # connected, and silent
                if not client.recv(1, socket.MSG_PEEK):
                    raise ConnectionAbortedError
        try:
            return self._answer(path, fields)
        finally:
            self._turn.release()

    def server_close(self) -> None:
        """Accept no more requests and wait for the current answer: ending while a picture is drawn
        would crash the interpreter."""
        super().server_close()
        self._turn.acquire(timeout=_TO_END)

    def listening(self, client: socket.socket, begins: bool) -> None:
        """Register a client before and after its request; too many silent ones are cut off."""
        if not begins:
            self._idle.pop(client, None)
            return
        self._idle[client] = None
        for oldest in list(self._idle)[:-_MOST_IDLE]:
            with suppress(OSError):
                oldest.shutdown(socket.SHUT_RD)

    def below_secret(self, path: str) -> str | None:
        """The rest of a path that begins with the secret; None for any other."""
        secret, slash, rest = path.removeprefix("/").partition("/")
        known = hmac.compare_digest(secret.encode(), self._secret.encode())
        return rest if known and slash else None

    def process_request(self, request, client_address) -> None:
        """Answer in a thread of its own, once one of a bounded number is free."""
        self.listening(request, True)
        self._free.acquire()
        try:
            super().process_request(request, client_address)
        except BaseException:  # as when the machine has no more threads
            self._free.release()
            raise

    def process_request_thread(self, request, client_address) -> None:
        """Answer, in the thread."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self.listening(request, False)
            self._free.release()

    def handle_error(self, request, client_address) -> None:
        """A client that hangs up is no error; anything else is said here, never to the client."""
        error = sys.exc_info()[1]
        if not isinstance(error, OSError):
            print(f"error: unexpected {error!r} in the page", file=sys.stderr, flush=True)


class _Request(BaseHTTPRequestHandler):
    """One request, one reply, then the connection is closed."""

    server: PageServer
    #: Until another is read: refusals have a status line, to the oldest clients too.
    default_request_version = "HTTP/1.0"

    def setup(self) -> None:
        self.connection, self.wfile = self.request, io.BytesIO()

    def handle(self) -> None:
        head = self._head()
        self.server.listening(self.connection, False)
        if len(head) > _LONGEST_HEAD:
            self.requestline, self.request_version = "", self.default_request_version
            self.send_error(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)
        else:
            self.rfile = io.BytesIO(head)
            self.handle_one_request()

    def finish(self) -> None:
        """Send, and read on until the client hangs up: else it could lose the reply."""
        self.connection.settimeout(_TO_LEAVE)
        self.connection.sendall(self.wfile.getvalue(), _NO_SIGNAL)
        self.connection.shutdown(socket.SHUT_WR)
        self._received(_TO_HANG_UP, lambda rest: len(rest) > _LONGEST_HEAD)

    def _head(self) -> bytes:
        """The request's head to its empty line, or too much; empty if it does not come in time."""
        ended = re.compile(rb"\n\r?\n")
        head = self._received(
            _TO_COME, lambda head: len(head) > _LONGEST_HEAD or ended.search(head) is not None
        )
        return head if ended.search(head) or len(head) > _LONGEST_HEAD else b""

    def _received(self, seconds: float, enough: Callable[[bytes], bool]) -> bytes:
        """Bytes received until they are enough, the client ends, or the time is over."""
        end, received = time.monotonic() + seconds, b""
        while not enough(received):
            self.connection.settimeout(max(end - time.monotonic(), 1e-3))
            try:
                part = self.connection.recv(4096)
            except OSError:
                break
            if not part:
                break
            received += part
        return received

    def do_GET(self) -> None:
        try:
            path = self._checked()
            reply = self.server.answer(path, self._fields(), self.connection)
        except ConnectionError:
            pass
        except Refused as refused:
            self.send_error(refused.status)
        except Exception:
            self.server.handle_error(self.connection, self.client_address)
            self.send_error(HTTPStatus.INTERNAL_SERVER_ERROR)
        else:
            self._reply(HTTPStatus.OK, reply)

    def _checked(self) -> str:
        """The path below the secret; raises `Refused` for what this page would never send."""
        headers = self.headers
        if not headers:  # as of HTTP/0.9, for which Python 3.14 makes no message of them
            raise Refused(HTTPStatus.BAD_REQUEST)
        hosts = headers.get_all("Host", [])
        if len(hosts) != 1:
            raise Refused(HTTPStatus.BAD_REQUEST)
        own = [f"http://{hosts[0]}".lower()]
        origins = [origin.lower() for origin in headers.get_all("Origin", own)]
        site = headers.get("Sec-Fetch-Site", "none")  # "none": typed, or opened by a program
        if not _HOSTS.fullmatch(hosts[0]) or origins != own or site not in ("none", "same-origin"):
            raise Refused(HTTPStatus.FORBIDDEN)
        if "Upgrade" in headers or "Transfer-Encoding" in headers:
            raise Refused(HTTPStatus.BAD_REQUEST)
        if headers.get("Content-Length", "0") != "0":
            raise Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
        try:
            path = self.server.below_secret(urlsplit(self.path).path)
        except ValueError as error:
            raise Refused(HTTPStatus.BAD_REQUEST) from error
        if path is None:
            raise Refused(HTTPStatus.FORBIDDEN)
        return path

    def _fields(self) -> Mapping[str, str]:
        """Fields of the query, each once."""
        try:
            pairs = parse_qsl(
                urlsplit(self.path).query,
                keep_blank_values=True,
                errors="strict",
                max_num_fields=_MOST_FIELDS,
            )
        except ValueError as error:
            raise Refused(HTTPStatus.BAD_REQUEST) from error
        if len(dict(pairs)) != len(pairs):
            raise Refused(HTTPStatus.BAD_REQUEST)
        return MappingProxyType(dict(pairs))

    def send_error(self, code, message=None, explain=None) -> None:
        """The status in its standard words: nothing of the request, nor of what went wrong."""
        status = HTTPStatus(code)
        more = ""
        if status is HTTPStatus.FORBIDDEN:
            more = "Open the address that 'fenics-joints database web' has printed.\n"
        text = f"{status.value} {status.phrase}\n{more}"
        self._reply(status, Reply(text.encode(), "text/plain; charset=utf-8"))

    def _reply(self, status: HTTPStatus, reply: Reply) -> None:
        picture = reply.kind.startswith("image/")
        self.send_response(status)
        self.send_header("Content-Type", reply.kind)
        self.send_header("Content-Length", str(len(reply.body)))
        self.send_header("Content-Security-Policy", _PICTURE_POLICY if picture else _POLICY)
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(reply.body)

    def version_string(self) -> str:
        return "fenics-joints"

    def log_message(self, format, *arguments) -> None:
        """Says nothing: addresses hold the secret."""
