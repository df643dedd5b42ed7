"""A shared-memory ring of true tool poses: written in every cycle by the PLC process, read by the camera process.

One writer, any number of readers, no lock. Entry number n lives in slot n % N_RING_SLOTS under a guard: 2n + 1 while
it is being written, 2n + 2 when it is whole. A guard that differs before and after a copy indicates a torn or newer
entry.
"""

import struct
from multiprocessing import shared_memory
from typing import Self

import numpy as np

from machine.poses import pose
from machine.rotations import Array, rotation_from_rotvec, rotvec_from_rotation

N_RING_SLOTS = 8192  # 8 s at 1 kHz: a camera process that was delayed for so long restarts
_MARGIN = 64  # entries at the old end that are about to be overwritten
_RETRIES = 100
_HEAD = struct.Struct("<Qq")  # entries written so far; PLC clock minus the PC's clock [ns]
_COUNT = struct.Struct("<Q")
_ENTRY = struct.Struct("<q12d")  # PLC time [ns], upper three rows of T_base_tcp
_FIRST_SLOT = 64
_SLOT_SIZE = 128


class PoseFeedError(Exception):
    """The feed does not hold what was requested."""


class PoseFeed:
    """T_base_tcp (4, 4) by PLC time [ns]. Create it in the writing process, attach by name in the reading one.

    The PLC clock is the true time of the simulation: t_plc_ns = the PC's clock + `epoch_offset_ns`.
    """

    def __init__(self, memory: shared_memory.SharedMemory, owner: bool) -> None:
        self._memory = memory
        self._buffer = _buffer_of(memory)
        self._owner = owner
        self._count = 0  # the writer's own

    @classmethod
    def create(cls, epoch_offset_ns: int = 0) -> Self:
        """A new, empty feed."""
        memory = shared_memory.SharedMemory(create=True, size=_FIRST_SLOT + N_RING_SLOTS * _SLOT_SIZE)
        _HEAD.pack_into(_buffer_of(memory), 0, 0, epoch_offset_ns)
        return cls(memory, owner=True)

    @classmethod
    def attach(cls, name: str) -> Self:
        """The feed of that name, for reading."""
        return cls(shared_memory.SharedMemory(name=name), owner=False)

    @property
    def feed_name(self) -> str:
        """Name to attach by."""
        return self._memory.name

    @property
    def epoch_offset_ns(self) -> int:
        """PLC clock minus the PC's clock [ns]."""
        return _HEAD.unpack_from(self._buffer, 0)[1]

    def publish(self, t_plc_ns: int, T_base_tcp: Array) -> None:
        """Add one pose; times must increase."""
        number = self._count
        offset = _FIRST_SLOT + number % N_RING_SLOTS * _SLOT_SIZE
        _COUNT.pack_into(self._buffer, offset, 2 * number + 1)
        _ENTRY.pack_into(self._buffer, offset + 8, t_plc_ns, *T_base_tcp[:3].ravel().tolist())
        _COUNT.pack_into(self._buffer, offset, 2 * number + 2)
        self._count = number + 1
        _COUNT.pack_into(self._buffer, 0, number + 1)

    def latest_t_ns(self) -> int:
        """PLC time of the newest pose. Raises: PoseFeedError while the feed is empty."""
        for _ in range(_RETRIES):
            count = _COUNT.unpack_from(self._buffer, 0)[0]
            if count == 0:
                raise PoseFeedError("pose feed is empty; the PLC process has not started")
            entry = self._read(count - 1)
            if entry is not None:
                return entry[0]
        raise PoseFeedError("pose feed: newest entry stays torn; the writer died while writing")

    def pose_at(self, t_plc_ns: int) -> Array:
        """T_base_tcp (4, 4) at a time between the oldest and the newest pose, interpolated.

        Model:   position linear, rotation along the geodesic, between the two entries around the time.
        Raises:  PoseFeedError: the time is not held (too old, or still to come).
        """
        for _ in range(_RETRIES):
            found = self._entries_around_time(t_plc_ns)
            if found is not None:
                return _interpolate_pose(*found, t_plc_ns)
        raise PoseFeedError("pose feed: entries stay torn; the writer died while writing, or the reader is too slow")

    def close(self) -> None:
        """Detach; the creator also removes the memory."""
        self._buffer = memoryview(b"")
        self._memory.close()
        if self._owner:
            self._memory.unlink()

    def _entries_around_time(self, t_plc_ns: int) -> tuple[tuple[int, Array], tuple[int, Array]] | None:
        """The neighbours of a time; None when an entry was torn or overwritten under our hands."""
        count = _COUNT.unpack_from(self._buffer, 0)[0]
        low, high = max(0, count - N_RING_SLOTS + _MARGIN), count - 1
        if count < 2:
            raise PoseFeedError("pose feed is empty; the PLC process has not started")
        first, last = self._read(low), self._read(high)
        if first is None or last is None:
            return None
        if not first[0] <= t_plc_ns <= last[0]:
            raise PoseFeedError(f"pose feed: t_plc = {t_plc_ns} ns is outside what is held, {first[0]}..{last[0]} ns")
        while high - low > 1:
            middle = (low + high) // 2
            entry = self._read(middle)
            if entry is None:
                return None
            if entry[0] <= t_plc_ns:
                low, first = middle, entry
            else:
                high, last = middle, entry
        return first, last

    def _read(self, number: int) -> tuple[int, Array] | None:
        """One entry, or None if it is not whole or no longer that one."""
        offset = _FIRST_SLOT + number % N_RING_SLOTS * _SLOT_SIZE
        if _COUNT.unpack_from(self._buffer, offset)[0] != 2 * number + 2:
            return None
        t_ns, *values = _ENTRY.unpack_from(self._buffer, offset + 8)
        if _COUNT.unpack_from(self._buffer, offset)[0] != 2 * number + 2:
            return None
        return t_ns, np.array(values).reshape(3, 4)


def _buffer_of(memory: shared_memory.SharedMemory) -> memoryview:
    if memory.buf is None:
        raise PoseFeedError("pose feed: its memory is closed")
    return memory.buf


def _interpolate_pose(first: tuple[int, Array], second: tuple[int, Array], t_ns: int) -> Array:
    share = (t_ns - first[0]) / max(1, second[0] - first[0])
    A, B = first[1], second[1]
    turn = rotvec_from_rotation(B[:, :3] @ A[:, :3].T)
    return pose(rotation_from_rotvec(share * turn) @ A[:, :3], A[:, 3] + share * (B[:, 3] - A[:, 3]))
