"""The page's server by a raw client: who gets an answer, and what it endures."""

from __future__ import annotations

import random
import socket
import struct
import threading
import time
from contextlib import contextmanager, suppress
from http import HTTPStatus
from urllib.parse import urlsplit

import pytest
from mpi4py import MPI

from fenics_joints.database.web.server import PageServer, Refused, Reply
from fenics_joints.errors import InputError

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")

#: Sent with every reply, whatever it is.
SAFE = {
    "x-content-type-options": "nosniff",
    "x-frame-options": "deny",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}


@contextmanager
def connected(url: str):
    address = urlsplit(url)
    with socket.create_connection((address.hostname, address.port), timeout=30) as client:
        yield client


def ask(url: str, request: bytes) -> tuple[int, dict[str, str], bytes]:
    """Status (0 for none), headers and body."""
    with connected(url) as client:
        received = b""
        try:
            client.sendall(request)
            if not request.endswith(b"\r\n\r\n"):  # or it would wait for the rest
                client.shutdown(socket.SHUT_WR)
            while part := client.recv(65536):
                received += part
        except ConnectionError:
            pass
    head, _, body = received.partition(b"\r\n\r\n")
    first, *lines = head.decode("latin-1").split("\r\n")
    headers = dict(line.lower().partition(": ")[::2] for line in lines)
    return int(first.split()[1]) if first.startswith("HTTP/") else 0, headers, body


def get(url: str, *lines: str, path: str | None = None, host: str | None = None) -> bytes:
    address = urlsplit(url)
    head = [
        f"GET {address.path if path is None else path} HTTP/1.1",
        f"Host: {address.netloc if host is None else host}",
        *lines,
    ]
    return "\r\n".join([*head, "", ""]).encode("latin-1")


def goes_on(url: str) -> bool:
    status, _, body = ask(url, get(url))
    return status == 200 and b"51.4" in body


@contextmanager
def served(answer):
    with PageServer(answer, 0) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def greet(path, fields) -> Reply:
    return Reply(b"hello", "text/plain")


@pytest.mark.parametrize(
    ("lines", "host", "status"),
    [
        ((), None, 200),
        ((), "localhost:9000", 200),  # a tunnel
        (("Origin: {own}", "Sec-Fetch-Site: same-origin"), None, 200),
        ((), "evil.example", 403),
        ((), "127.0.0.1.evil.example", 403),
        ((), "evil.example:80@127.0.0.1", 403),
        ((), "", 403),
        (("Host: evil.example",), None, 400),
        (("Origin: http://evil.example",), None, 403),
        (("Origin: null",), None, 403),
        (("Origin: {own}", "Origin: http://evil.example"), None, 403),
        (("Origin: http://localhost:1",), None, 403),
        (("Sec-Fetch-Site: cross-site",), None, 403),
        (("Sec-Fetch-Site: same-site",), None, 403),
        (("Connection: Upgrade", "Upgrade: websocket"), None, 400),
        (("Content-Length: 5",), None, 413),
        (("Transfer-Encoding: chunked",), None, 400),
        (("X-Long: " + "x" * 20000,), None, 431),
        (tuple(f"X-{i}: 1" for i in range(200)), None, 431),
    ],
)
def test_only_this_machine_and_the_page_itself_get_an_answer(lines, host, status):
    with served(greet) as server:
        own = "http://" + urlsplit(server.url).netloc
        lines = [line.format(own=own) if "{" in line else line for line in lines]
        found, headers, body = ask(server.url, get(server.url, *lines, host=host))
    assert (found, body == b"hello") == (status, status == 200)
    assert {name: headers[name] for name in SAFE} == SAFE
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert "default-src 'none'" in headers["content-security-policy"]


def test_the_secret_is_new_at_each_start_and_no_other_is_taken():
    with served(greet) as first, served(greet) as second:
        secret = urlsplit(first.url).path
        assert len(secret) > 30 and secret != urlsplit(second.url).path
        other = urlsplit(second.url).path
        wrong = ("/", secret[:-1], secret[:-2] + "/", "/../" + secret, "/é/", "//[/", other)
        for path in wrong:
            status, _, body = ask(first.url, get(first.url, path=path))
            assert status in (400, 403) and secret.encode() not in body, path


def test_a_query_has_few_fields_and_each_once():
    seen = []

    def answer(path, fields):
        seen.append(dict(fields))
        return greet(path, fields)

    with served(answer) as server:
        path = urlsplit(server.url).path
        for query, status in (
            ("a=1&b=%C3%A9", 200),
            ("a=1&a=2", 400),
            ("a=%FF", 400),
            ("&".join(f"a{i}=1" for i in range(21)), 400),
        ):
            assert ask(server.url, get(server.url, path=f"{path}?{query}"))[0] == status, query
    assert seen == [{"a": "1", "b": "é"}]


def test_what_goes_wrong_is_said_here_and_not_to_the_client(capfd):
    def answer(path, fields):
        if path:
            raise Refused(HTTPStatus.NOT_FOUND)
        raise RuntimeError("/home/someone/own.db \x1b[31m")

    with served(answer) as server:
        status, _, body = ask(server.url, get(server.url))
        assert (status, body) == (500, b"500 Internal Server Error\n")
        status, _, body = ask(server.url, get(server.url, path=urlsplit(server.url).path + "x"))
        assert (status, body) == (404, b"404 Not Found\n")
    errors = capfd.readouterr().err
    assert "own.db" in errors and "Traceback" not in errors and "\x1b" not in errors


def test_it_does_not_end_while_it_answers():
    asked, done = threading.Event(), threading.Event()

    def slow(path, fields) -> Reply:
        asked.set()
        time.sleep(0.3)
        done.set()
        return greet(path, fields)

    with served(slow) as server:
        client = threading.Thread(target=ask, args=(server.url, get(server.url)))
        client.start()
        assert asked.wait(10) and not done.is_set()
    assert done.is_set()
    client.join()


def test_a_port_that_is_taken_is_said():
    with served(greet) as server:
        port = urlsplit(server.url).port
        with pytest.raises(InputError, match=f"--port {port}: .*in use; expected one that is free"):
            PageServer(greet, port)


def test_what_nobody_waits_for_is_not_answered():
    """Of 200 requests whose clients hang up while one is answered, none is."""
    asked, go_on, answered = threading.Event(), threading.Event(), []

    def slow(path, fields) -> Reply:
        answered.append(path)
        asked.set()
        assert go_on.wait(30)
        return greet(path, fields)

    with served(slow) as server:
        first = threading.Thread(target=ask, args=(server.url, get(server.url)))
        first.start()
        assert asked.wait(10)
        path = urlsplit(server.url).path
        for _ in range(200):
            with connected(server.url) as client:
                client.sendall(get(server.url, path=path + "picture.svg"))
        time.sleep(1.0)
        go_on.set()
        assert ask(server.url, get(server.url))[0] == 200
        first.join()
    assert answered == ["", ""]


# -- the page of the command -----------------------------------------------------------------------


def _malformed(url: str, source: random.Random) -> bytes:
    """A good request with something wrong in it, or no request at all."""
    address = urlsplit(url)
    good = get(url, path=f"{address.path}?torque=100")
    typed = "torque=%3Cscript%3E torque=1e999 torque=nan torque=-1 torque=%D9%A1 =&=&= way=.. "
    typed += "bolt=%3Cimg+src%3Dx%3E output=picture picture=%3Csvg%3E %00=%00 extrapolate=<b> "
    typed += f"K={'9' * 9999} thickness=0x10 thickness=1&thickness=2"
    typed = source.choice(typed.split())
    below = source.choice(["ws", "../", "%2e%2e/", "x.svg", "%00"])
    place, byte = source.randrange(len(good)), bytes([source.randrange(256)])
    return source.choice(
        [
            source.randbytes(source.randrange(1, 3000)),
            good[:place] + byte + good[place + 1 :],
            good[:place],
            good.replace(
                b"GET", source.choice([b"POST", b"PUT", b"GET GET", b"", b"\x00", b"get"])
            ),
            good.replace(b"HTTP/1.1", source.choice([b"HTTP/9.0", b"HTTP/9", b"", b"ICY"])),
            good.replace(b"\r\n", b"\n\x0b"),
            good.replace(b"\r\n\r\n", b"\r\n: \r\n\r\n"),
            get(url, path=f"{address.path}?{typed}"),
            get(url, path=f"{address.path}{below}"),
            get(url, "X: " + "y" * source.randrange(40000)),
            b"\x16\x03\x01\x02\x00\x01\x00" + source.randbytes(60),  # TLS
        ]
    )


def test_it_goes_on_after_1000_malformed_requests(page_url):
    source, seen = random.Random(13), {}
    for _ in range(1000):
        request = _malformed(page_url, source)
        status, _, body = ask(page_url, request)
        seen[status] = seen.get(status, 0) + 1
        assert status < 500 or status in (501, 505), (request, body)
        assert b"Traceback" not in body and b"<script>" not in body and b"<img src=x" not in body
    assert {0, 200, 400, 403, 404, 431, 501, 505} <= set(seen), seen
    assert goes_on(page_url)


def test_it_goes_on_after_1000_aborted_connections(page_url):
    source, good = random.Random(14), get(page_url)
    picture = get(page_url, path=urlsplit(page_url).path + "picture.svg")
    for i in range(1000):
        with connected(page_url) as client:
            request = picture if i % 100 == 0 else good
            client.sendall(request[: source.choice([0, 1, len(request) // 2, len(request)])])
            if source.random() < 0.05:
                client.settimeout(0.02)
                try:
                    client.recv(10)
                except TimeoutError:
                    pass
            # Not closed but reset, as when a browser is killed.
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    assert goes_on(page_url)


@pytest.mark.parametrize("count", [50, 300])
def test_who_sends_slowly_or_nothing_keeps_nobody_waiting_for_long(page_url, count):
    address = urlsplit(page_url)
    idle = [socket.create_connection((address.hostname, address.port)) for _ in range(count)]
    try:
        for client in idle:
            with suppress(ConnectionError):
                client.sendall(b"GET / HT")
        started = time.monotonic()
        assert goes_on(page_url)
        assert time.monotonic() - started < 5.0
    finally:
        for client in idle:
            client.close()
