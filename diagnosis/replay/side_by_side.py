"""The same for several pieces in parallel, a thread each: the compiled kernel runs without the interpreter's lock.

NUMBA_NUM_THREADS=1 keeps it to one, for parallel workers and for a diagnosis next to a running machine.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

Piece = TypeVar("Piece")
Result = TypeVar("Result")


def side_by_side(of: Callable[[Piece], Result], pieces: Sequence[Piece]) -> list[Result]:
    """`of` each piece, in their order; what one raises is raised."""
    pool = _thread_pool()
    return [of(piece) for piece in pieces] if pool is None or len(pieces) < 2 else list(pool.map(of, pieces))


@cache
def _thread_pool() -> ThreadPoolExecutor | None:
    given = os.environ.get("NUMBA_NUM_THREADS")
    threads = _usable_cores() if given is None else int(given)
    return ThreadPoolExecutor(threads, thread_name_prefix="replay") if threads > 1 else None


def _usable_cores() -> int:
    """Cores that this process may use; all of them where the system (macOS, Windows) does not say."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


if hasattr(os, "register_at_fork"):  # a child inherits the pool, but none of its threads; Windows does not fork
    os.register_at_fork(after_in_child=_thread_pool.cache_clear)
