"""Newest frame for all waiting clients; frames that a client missed are counted."""

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Frame:
    """One side-by-side JPEG with its stamp."""

    jpeg: bytes
    t_exposure_ns: int  # camera clock, mid-exposure of the middle row
    sequence: int


class Subscriber:
    """One client's place for the newest frame."""

    def __init__(self) -> None:
        self.skipped = 0
        self._frame: Frame | None = None
        self._arrived = asyncio.Event()

    def put_frame(self, frame: Frame) -> None:
        """Put a frame; one that was not taken yet is replaced and counted as skipped."""
        self.skipped += self._frame is not None
        self._frame = frame
        self._arrived.set()

    def close(self) -> None:
        """Wake the client with the information that nothing follows."""
        self._frame = None
        self._arrived.set()

    async def next_frame(self) -> Frame | None:
        """The newest frame not seen yet; None when the camera shuts down."""
        await self._arrived.wait()
        self._arrived.clear()
        frame, self._frame = self._frame, None
        return frame


class FrameHub:
    """Hands frames to any number of subscribers. To be used inside one event loop."""

    def __init__(self) -> None:
        self.newest: Frame | None = None
        self._subscribers: set[Subscriber] = set()
        self._skipped_before = 0
        self._closed = False

    @property
    def n_clients(self) -> int:
        """How many listen."""
        return len(self._subscribers)

    @property
    def skipped_count(self) -> int:
        """Frames that clients were too slow for, over all clients so far."""
        return self._skipped_before + sum(subscriber.skipped for subscriber in self._subscribers)

    def publish(self, frame: Frame) -> None:
        """Make this frame the newest and offer it to everybody."""
        self.newest = frame
        for subscriber in self._subscribers:
            subscriber.put_frame(frame)

    def close(self) -> None:
        """End all subscriptions."""
        self._closed = True
        for subscriber in self._subscribers:
            subscriber.close()

    @contextmanager
    def subscribe(self) -> Iterator[Subscriber]:
        """A subscription for as long as the block runs."""
        subscriber = Subscriber()
        if self._closed:
            subscriber.close()
        self._subscribers.add(subscriber)
        try:
            yield subscriber
        finally:
            self._subscribers.discard(subscriber)
            self._skipped_before += subscriber.skipped
