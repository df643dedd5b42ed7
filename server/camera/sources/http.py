"""Stereo pairs from a camera server: multipart JPEG over HTTP, stamped by X-Exposure-Ns and X-Sequence.

A thread reads the stream and keeps the newest complete picture undecoded, so that being late costs no decoding.
"""

import base64
import contextlib
import http.client
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from urllib.parse import SplitResult, unquote, urljoin, urlsplit

from recording.clock import mono_ns
from server.camera.contracts import StereoFrame
from server.camera.errors import CameraError, StreamError
from server.camera.sources.live import STALL_WARNING_TEXT, LiveSource
from server.camera.sources.multipart import MultipartParser, MultipartPart
from server.camera.sources.settings import HttpSource
from server.camera.sources.side_by_side import decode_side_by_side
from server.shown_address import without_password

REDIRECTS_MAX = 5
REDIRECT_STATUS_CODES = frozenset({301, 302, 303, 307, 308})

TakeSocket = Callable[[socket.socket], None]


def require_address(url: str) -> None:
    """Raises: CameraError: not an address of the form http://[user:password@]host[:port]/path."""
    if _parse_http_url(url) is None:
        raise CameraError(f"camera url '{without_password(url)}' is not http://[user:password@]host[:port]/path")


@contextlib.contextmanager
def open_stream(url: str, timeout_s: float, take_socket: TakeSocket) -> Iterator[http.client.HTTPResponse]:
    """The response with status 200, its body still to be read. `take_socket` is given each connection's socket.

    User and password go to the host of their own address only; a redirect to another one takes none along.

    Raises: StreamError: another status, a redirect that cannot be followed. OSError, http.client.HTTPException.
    """
    authorization, n_moved = "", 0
    while True:
        address = _parse_http_url(url)
        if address is None:
            raise StreamError(f"redirected to {without_password(url)}, which is not http://host[:port]/path")
        connection = http.client.HTTPConnection(address.hostname or "", address.port or 80, timeout=timeout_s)
        with (
            contextlib.closing(connection),
            contextlib.closing(_send_get_request(connection, address, authorization, take_socket)) as got,
        ):
            if got.status == http.client.OK:
                yield got
                return
            if got.status in REDIRECT_STATUS_CODES and (place := got.headers.get("Location")):
                url, authorization, n_moved = _redirected_url(url, address, place), "", n_moved + 1
            elif got.status == http.client.UNAUTHORIZED and address.password is not None and not authorization:
                authorization = _authorization_header(address, got)
            else:
                raise StreamError(f"HTTP status {got.status} {got.reason}{_authentication_remedy(got.status, address)}")
        if n_moved > REDIRECTS_MAX:
            raise StreamError(f"redirected more than {REDIRECTS_MAX} times; give the stream's own address")


def _parse_http_url(url: str) -> SplitResult | None:
    try:
        address = urlsplit(url)
        fits = address.scheme == "http" and address.hostname and (address.port is None or address.port > 0)
    except ValueError:
        return None
    return address if fits else None


def _send_get_request(
    connection: http.client.HTTPConnection, address: SplitResult, authorization: str, take_socket: TakeSocket
) -> http.client.HTTPResponse:
    headers = {"Connection": "close"} | ({"Authorization": authorization} if authorization else {})
    connection.request("GET", _request_target(address), headers=headers)
    take_socket(connection.sock)  # the response takes it over
    return connection.getresponse()


def _request_target(address: SplitResult) -> str:
    return (address.path or "/") + (f"?{address.query}" if address.query else "")


def _redirected_url(url: str, before: SplitResult, place: str) -> str:
    """The new address; at the same host and port the user stays."""
    moved = urljoin(url, place)
    address = _parse_http_url(moved)
    if address is None or address.username is not None or before.username is None:
        return moved
    if (address.hostname, address.port or 80) != (before.hostname, before.port or 80):
        return moved
    return address._replace(netloc=f"{before.netloc.rpartition('@')[0]}@{address.netloc}").geturl()


def _authorization_header(address: SplitResult, refused: http.client.HTTPResponse) -> str:
    """What the header Authorization is to say; Digest where the camera offers it. Raises: StreamError: neither."""
    user, password = unquote(address.username or ""), unquote(address.password or "")
    challenges = refused.headers.get_all("WWW-Authenticate") or []
    kinds = [challenge.partition(" ")[0].lower() for challenge in challenges]
    if "digest" in kinds:
        import httpx  # a quarter of a second, needed here only

        asked = httpx.Request("GET", f"http://{address.hostname}:{address.port or 80}{_request_target(address)}")
        flow = httpx.DigestAuth(user, password).sync_auth_flow(asked)
        next(flow)
        headers = [("WWW-Authenticate", challenge) for challenge in challenges]
        try:
            return flow.send(httpx.Response(401, headers=headers, request=asked)).headers["Authorization"]
        except (httpx.HTTPError, KeyError, NotImplementedError) as error:
            raise StreamError(f"the camera's request for a password cannot be read ({error})") from error
    if "basic" in kinds:
        return "Basic " + base64.b64encode(f"{user}:{password}".encode()).decode()
    raise StreamError(f"the camera asks for a password in a way that is not known: {', '.join(kinds) or 'none'}")


def _authentication_remedy(status: int, address: SplitResult) -> str:
    if status != http.client.UNAUTHORIZED:
        return ""
    if address.password is None:
        return "; give user and password in the address: http://user:password@host/path"
    return "; user or password is wrong: put letters such as @ : / in them as %40 %3A %2F"


SILENCE_TIMEOUT_S = 2.0  # a camera that says nothing for this long is taken as lost
CHUNK_BYTES = 1 << 18


@dataclass(frozen=True, slots=True)
class _Received:
    part: MultipartPart
    pair_number: int  # of all that arrived, for a camera that does not count
    connection_number: int


class HttpStereoSource(LiveSource[_Received]):
    """Reads one camera stream for as long as it lives."""

    BACK_OFF_S = (0.2, 3.0)
    CLOSE_S = SILENCE_TIMEOUT_S + 1.0
    ENDED = "the camera ended the stream"
    EXPECTED = (OSError, http.client.HTTPException, StreamError)

    def __init__(self, settings: HttpSource) -> None:
        require_address(settings.url)
        super().__init__(f"camera {without_password(settings.url)}", "connecting")
        self._url = settings.url
        self._counted = 0
        self._bad_pictures = 0
        self._socket: socket.socket | None = None
        self._thread.start()

    def read(self, timeout_s: float) -> StereoFrame | None:
        """The newest pair; a picture that cannot be decoded is passed over and reported in `state`."""
        received = self._newest.take_newest(timeout_s)
        if received is None:
            return None
        part = received.part
        try:
            left, right = decode_side_by_side(part.body)
        except StreamError as error:
            self._bad_pictures += 1
            self._state = f"{self._subject}: {error} ({self._bad_pictures} so far)"
            return None
        return StereoFrame(
            left=left,
            right=right,
            t_exposure_ns=part.t_header_ns if part.t_exposure_ns is None else part.t_exposure_ns,
            t_receive_mono_ns=part.t_header_ns,
            sequence=received.pair_number if part.sequence is None else part.sequence,
            connection_number=received.connection_number,
        )

    def close(self) -> None:
        """End the reading thread, in the midst of its waiting if need be."""
        self._stop.set()
        with contextlib.suppress(OSError):  # gone already
            if self._socket is not None:
                self._socket.shutdown(socket.SHUT_RDWR)
        super().close()

    def _connected(self) -> bool:
        """As its base has it; the host's name is resolved again each time."""
        with open_stream(self._url, SILENCE_TIMEOUT_S, self._take_socket) as response:
            self._connection += 1
            return self._read_parts(response)

    def _take_socket(self, opened: socket.socket) -> None:
        """The one that is read from now on, so that `close` can end a wait in it."""
        self._socket = opened

    def _read_parts(self, response: http.client.HTTPResponse) -> bool:
        parser = MultipartParser((response.headers.get_boundary() or "").encode(errors="replace"))
        any_part = held_up = False
        while not self._stop.is_set():
            data = response.read1(CHUNK_BYTES)
            if not data:
                return any_part
            held_up |= self._heartbeat.was_held_up()
            for part in parser.feed(data, mono_ns()):
                if held_up and part.t_exposure_ns is None:  # it would be stamped as of now; asking again drops the rest
                    raise StreamError(STALL_WARNING_TEXT)
                held_up = False
                any_part = True
                self._state = ""
                self._counted += 1
                self._newest.put(_Received(part, self._counted, self._connection))
        return any_part
