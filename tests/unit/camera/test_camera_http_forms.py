"""Cameras and MJPEG servers as they are: passwords, redirects, chunks, bare line feeds, parts without a length."""

import base64
import hashlib
import re
import socketserver
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from camera_stand_in import jpeg_of, picture

from server.camera.errors import CameraError, StreamError
from server.camera.sources.http import HttpStereoSource, open_stream
from server.camera.sources.multipart import MultipartParser
from server.camera.sources.settings import HttpSource
from server.settings import ServerSettings
from server.settings_camera import with_stream
from server.settings_source import plain_source
from server.shown_address import without_password

WAIT_S = 10.0
BODY = jpeg_of(picture(50, 200))
PARTS = (b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%b\r\n" % (len(BODY), BODY)) * 3
OK = b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n"
Answer = Callable[[str], bytes]


@contextmanager
def server(answer: Answer) -> Iterator[int]:
    """A server that gives each request what `answer` makes of it, and then nothing more; its port."""
    ended = threading.Event()

    class Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            lines = []
            while line := self.rfile.readline().strip():
                lines.append(line.decode())
            sent = answer("\n".join(lines))
            self.wfile.write(sent)
            if sent.split()[1] == b"200":
                ended.wait(WAIT_S)

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler) as listening:
        listening.daemon_threads = True
        threading.Thread(target=listening.serve_forever, daemon=True).start()
        try:
            yield listening.server_address[1]
        finally:
            ended.set()
            listening.shutdown()


def first_grey(url: str) -> float:
    """Mean grey of the left eye of the first pair."""
    source = HttpStereoSource(HttpSource(url))
    try:
        frame = source.read(WAIT_S)
        assert frame is not None, source.state
        return float(frame.left.mean())
    finally:
        source.close()


def chunked(data: bytes) -> bytes:
    pieces = [data[at : at + 700] for at in range(0, len(data), 700)]
    return b"".join(b"%x\r\n%b\r\n" % (len(piece), piece) for piece in pieces)


FORMS = {
    "as ours": OK + b"\r\n" + PARTS,
    "http 1.0": OK.replace(b"1.1", b"1.0") + b"\r\n" + PARTS,
    "chunked": OK + b"Transfer-Encoding: chunked\r\n\r\n" + chunked(PARTS),
    "line feeds": OK.replace(b"\r", b"") + b"\n" + PARTS.replace(b"\r\n--", b"\n--").replace(b"\r\nCont", b"\nCont"),
    "line feeds alone": OK + b"\r\n" + (b"--frame\nContent-Length: %d\n\n%b\n" % (len(BODY), BODY)) * 2,
    "no length": OK + b"\r\n" + re.sub(rb"Content-Length: \d+\r\n", b"", PARTS),
    "no length, no next boundary": OK + b"\r\n--frame\r\nContent-Type: image/jpeg\r\n\r\n" + BODY,
    "no part header": OK + b"\r\n--frame\r\n\r\n" + BODY + b"\r\n--frame",
    "dashes in the boundary's name": OK.replace(b"=frame", b"=--frame") + b"\r\n" + PARTS,
    "boundary without dashes": OK.replace(b"=frame", b'="frame"') + b"\r\n" + PARTS.replace(b"--frame", b"frame"),
}


@pytest.mark.parametrize("form", FORMS)
def test_the_forms_of_common_servers_are_read(form: str) -> None:
    with server(lambda _: FORMS[form]) as port:
        assert first_grey(f"http://127.0.0.1:{port}/stream") == pytest.approx(50.0, abs=2.0)  # grey levels


@pytest.mark.parametrize("chunk", [1, 3, 100, 5000])
@pytest.mark.parametrize("line_end", [b"\n", b"\r\n"])
def test_parts_without_a_length_do_not_depend_on_how_bytes_arrive(chunk: int, line_end: bytes) -> None:
    stream = b"".join(b"--frame\n\n".replace(b"\n", line_end) + BODY + line_end for _ in range(3))
    parser = MultipartParser()
    parts = [part for at in range(0, len(stream), chunk) for part in parser.feed(stream[at : at + chunk], at)]
    assert [part.body for part in parts] == [BODY] * 3


def test_a_header_that_waits_for_its_picture_is_no_stamp() -> None:
    parser = MultipartParser()
    assert parser.feed(b"--x\r\n\r\n", 1_000) == []
    (part,) = parser.feed(BODY, 34_000)
    assert part.t_header_ns == 34_000


# --- passwords ------------------------------------------------------------------------------------------------------

URL = "http://admin:p%40ss%3Aword@127.0.0.1:{port}/stream?channel=1"
PASSWORD = "p@ss:word"


def basic(request: str) -> bytes:
    wanted = "Authorization: Basic " + base64.b64encode(f"admin:{PASSWORD}".encode()).decode()
    return FORMS["as ours"] if wanted in request.split("\n") else unauthorized('Basic realm="camera"')


def unauthorized(*challenges: str) -> bytes:
    lines = "".join(f"WWW-Authenticate: {challenge}\r\n" for challenge in challenges)
    return f"HTTP/1.1 401 Unauthorized\r\n{lines}Content-Length: 0\r\n\r\n".encode()


def digest(algorithm: str, hashed: Callable[[str], str]) -> Answer:
    def answer(request: str) -> bytes:
        fields = dict(re.findall(r'(\w+)="?([^",]*)"?', request.partition("Authorization: Digest ")[2]))
        if fields:
            secret, asked = hashed(f"admin:camera:{PASSWORD}"), hashed("GET:/stream?channel=1")
            parts = (secret, "n0nce", fields["nc"], fields["cnonce"], fields["qop"], asked)
            if fields["response"] == hashed(":".join(parts)):
                return FORMS["as ours"]
        challenge = f'Digest realm="camera", nonce="n0nce", qop="auth", algorithm={algorithm}'
        return unauthorized('Basic realm="camera"', challenge)

    return answer


ANSWERS: dict[str, Answer] = {
    "basic": basic,
    "digest": digest("MD5", lambda text: hashlib.md5(text.encode()).hexdigest()),
    "digest sha-256": digest("SHA-256", lambda text: hashlib.sha256(text.encode()).hexdigest()),
}


@pytest.mark.parametrize("kind", ANSWERS)
def test_user_and_password_are_sent_as_the_camera_asks(kind: str) -> None:
    with server(ANSWERS[kind]) as port:
        assert first_grey(URL.format(port=port)) == pytest.approx(50.0, abs=2.0)


@pytest.mark.parametrize(("user", "remedy"), [("admin:wrong@", "is wrong"), ("", "give user and password")])
@pytest.mark.parametrize("kind", ANSWERS)
def test_a_wrong_or_missing_password_is_named_and_never_shown(kind: str, user: str, remedy: str) -> None:
    with server(ANSWERS[kind]) as port, pytest.raises(StreamError, match=f"401.*{remedy}") as refused:
        open_stream(f"http://{user}127.0.0.1:{port}/stream?channel=1", WAIT_S, lambda _: None).__enter__()
    assert "wrong@" not in str(refused.value)


def test_redirects_are_followed_and_the_password_stays_with_its_host() -> None:
    seen: list[str] = []

    def other(request: str) -> bytes:
        seen.append(request)
        return FORMS["as ours"]

    with server(other) as far:

        def first(request: str) -> bytes:
            if "GET /live" in request:
                return f"HTTP/1.1 307 Moved\r\nLocation: http://127.0.0.1:{far}/far\r\n\r\n".encode()
            return b"HTTP/1.1 302 Found\r\nLocation: /live\r\nContent-Length: 0\r\n\r\n"

        with server(first) as port:
            assert first_grey(URL.format(port=port)) == pytest.approx(50.0, abs=2.0)
    assert [request.split("\n")[0] for request in seen] == ["GET /far HTTP/1.1"]
    assert "Authorization" not in seen[0]
    with server(lambda _: b"HTTP/1.1 302 Found\r\nLocation: /stream\r\n\r\n") as port:  # noqa: SIM117
        with pytest.raises(StreamError, match="more than 5 times"):
            open_stream(f"http://127.0.0.1:{port}/", WAIT_S, lambda _: None).__enter__()
    with server(lambda _: b"HTTP/1.1 302 Found\r\nLocation: https://a:b@x/\r\n\r\n") as port:  # noqa: SIM117
        with pytest.raises(StreamError, match=r"https://a:\*\*\*@x/, which is not http"):
            open_stream(f"http://127.0.0.1:{port}/", WAIT_S, lambda _: None).__enter__()


def test_a_password_in_an_address_is_shown_nowhere() -> None:
    url = URL.format(port=1)
    source = HttpStereoSource(HttpSource(url))
    assert "http://admin:***@127.0.0.1" in source.state
    source.close()
    rtsp = "rtsp://admin:p%40ss%3Aword@camera/1"
    for given, kind in ((url, "http"), (rtsp, "rtsp")):
        settings = ServerSettings.model_validate({"camera": {"kind": kind, "url": given}})
        for shown in (settings.model_dump_json(), str(settings.model_dump()), source.state):
            assert "p%40ss" not in shown
        assert getattr(plain_source(settings.camera), "url", "") == given
        again = ServerSettings.model_validate({"camera": with_stream(settings.camera, None)})
        assert getattr(again.camera, "url", "") == given


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("http://u:p@h/a", "http://u:***@h/a"),
        ("http://u:p@q@h/a", "http://u:***@h/a"),
        ("http://h/a?user=u&pwd=geheim&x=1", "http://h/a?user=u&pwd=***&x=1"),
        ("http://h/a?access_token=t", "http://h/a?access_token=***"),
        ("{'url': 'ftp://u:p@h'}", "{'url': 'ftp://u:***@h'}"),
        ("http://h:80/a?channel=1", "http://h:80/a?channel=1"),
        ("http://u:p/w@h/a", "http://u:***@h/a"),
        ("http://u:pa@ss/w@h/1", "http://u:***@h/1"),
        ("http://u:p?w#x@h/1", "http://u:***@h/1"),
        ("http://u:1?2@h/a", "http://u:***@h/a"),
        ("http://token@h/a", "http://***@h/a"),
        ("http://to/ken@h/a", "http://***@h/a"),
        ("rtsp://u:p w@h/1", "rtsp://u:***@h/1"),
        ("u:p@h/a", "u:***@h/a"),
        ("http:/u:p@h/a", "http:***@h/a"),
        ("http://h/a?p=1&pw=2&fps=5;psw=3", "http://h/a?p=***&pw=***&fps=5;psw=***"),
        ("http://h/a?mail=u@x", "http://h/a?mail=***"),
        ("/dev/v4l/by-path/pci-0000:00:14.0-usb-0:1", "/dev/v4l/by-path/pci-0000:00:14.0-usb-0:1"),
    ],
)
def test_what_an_address_shows(address: str, shown: str) -> None:
    assert without_password(address) == shown


@pytest.mark.parametrize(
    "address", ["http://u:geh/eim@h/a", "http://u:geh?eim@h/a", "u:geh/eim@h", "ftp://u:geh eim@h/1"]
)
def test_the_refusal_of_an_address_does_not_show_its_password(address: str) -> None:
    with pytest.raises(CameraError) as refused:
        HttpStereoSource(HttpSource(address))
    assert "geh" not in str(refused.value)
    assert "eim" not in str(refused.value)


def test_random_bytes_with_bare_line_feeds_give_parts_or_stream_error() -> None:
    rng, stream = np.random.default_rng(11), b"--frame\n\n\xff\xd8abc\xff\xd9\n" * 3
    for _ in range(500):
        damaged = bytearray(stream)
        for place in rng.integers(0, len(stream), 4):
            damaged[place] = int(rng.integers(0, 256))
        try:
            parts = MultipartParser().feed(bytes(damaged), 0)
        except StreamError:
            continue
        assert sum(len(part.body) for part in parts) <= len(stream)
