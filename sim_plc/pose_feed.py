"""A shared-memory ring of true tool poses: written every millisecond by the PLC process, read by the camera process.

One writer, any readers, no lock: the writer bumps a slot's counter to odd, writes, bumps it to even; a reader that sees
an odd or changed counter reads again.
"""

from multiprocessing import shared_memory
from typing import Self

import numpy as np

from machine.poses import pose
from machine.rotations import Array, rotation_from_rotvec, rotvec_from_rotation

SLOTS = 8192  # 8 s at 1 kHz
RETRIES = 100
SLOT = np.dtype([("guard", "<u8"), ("t_ns", "<i8"), ("T", "<f8", (12,))])


class PoseFeedError(Exception):
    """The feed does not hold the asked time."""


class PoseFeed:
    """T_base_tcp by PLC time [ns]. Create it in the writing process, attach by name in the reading one."""

    def __init__(self, memory: shared_memory.SharedMemory, owner: bool) -> None:
        self._memory = memory
        self._owner = owner
        self._head = np.ndarray((1,), dtype="<u8", buffer=memory.buf)
        self._slots = np.ndarray((SLOTS,), dtype=SLOT, buffer=memory.buf, offset=64)

    @classmethod
    def create(cls) -> Self:
        """A new, empty feed."""
        return cls(shared_memory.SharedMemory(create=True, size=64 + SLOTS * SLOT.itemsize), owner=True)

    @classmethod
    def attach(cls, name: str) -> Self:
        """The feed of that name."""
        return cls(shared_memory.SharedMemory(name=name), owner=False)

    @property
    def name(self) -> str:
        """Name to attach by."""
        return self._memory.name

    def publish(self, t_plc_ns: int, T_base_tcp: Array) -> None:
        """Add one pose; times must increase."""
        count = int(self._head[0])
        slot = self._slots[count % SLOTS : count % SLOTS + 1]
        slot["guard"] += 1
        slot["t_ns"] = t_plc_ns
        slot["T"] = T_base_tcp[:3].reshape(1, 12)
        slot["guard"] += 1
        self._head[0] = count + 1

    def latest_t_ns(self) -> int:
        """PLC time of the newest pose.

        Raises: PoseFeedError while the feed is empty.
        """
        count = int(self._head[0])
        if count == 0:
            raise PoseFeedError("pose feed is empty; the PLC process has not started")
        return self._read(count - 1)[0]

    def pose_at(self, t_plc_ns: int) -> Array:
        """T_base_tcp (4, 4) at a time between the oldest and the newest pose, interpolated.

        Raises: PoseFeedError when the time is not held.
        """
        count = int(self._head[0])
        low, high = max(0, count - SLOTS + 16), count - 1
        if count < 2 or not self._read(low)[0] <= t_plc_ns <= self._read(high)[0]:
            raise PoseFeedError(f"time {t_plc_ns} ns is not in the feed")
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if self._read(middle)[0] <= t_plc_ns else (low, middle)
        return _between(self._read(low), self._read(high), t_plc_ns)

    def close(self) -> None:
        """Detach; the creator also removes the memory."""
        del self._head, self._slots
        self._memory.close()
        if self._owner:
            self._memory.unlink()

    def _read(self, number: int) -> tuple[int, Array]:
        index = number % SLOTS
        for _ in range(RETRIES):
            before = int(self._slots["guard"][index])
            t_ns, values = int(self._slots["t_ns"][index]), self._slots["T"][index].copy()
            if before % 2 == 0 and int(self._slots["guard"][index]) == before:
                return t_ns, values
        raise PoseFeedError("pose feed slot stays torn; the writer died while writing")


def _between(first: tuple[int, Array], second: tuple[int, Array], t_ns: int) -> Array:
    share = (t_ns - first[0]) / max(1, second[0] - first[0])
    A, B = first[1].reshape(3, 4), second[1].reshape(3, 4)
    turn = rotvec_from_rotation(B[:, :3] @ A[:, :3].T)
    return pose(rotation_from_rotvec(share * turn) @ A[:, :3], A[:, 3] + share * (B[:, 3] - A[:, 3]))
