"""Starting the child processes of the server and of the simulator."""

import contextlib
import signal
from collections.abc import Iterator
from multiprocessing import resource_tracker

TERMINAL_SIGNALS = (signal.SIGINT, signal.SIGHUP)
#: The environment of a process that computes in one thread.
SINGLE_THREAD_ENVIRONMENT = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


@contextlib.contextmanager
def out_of_the_terminals_reach(*more: signal.Signals) -> Iterator[None]:
    """What is started inside never gets the signals that a terminal sends to a whole group: its parent gets them, and
    ends it in the right order. They are blocked before the child's first instruction, in this thread only.

    `more`: SIGTERM, which systemd sends to a whole group, for a child that its parent ends in another way.
    """
    resource_tracker.ensure_running()  # its start, at the first child, would unblock them again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (*TERMINAL_SIGNALS, *more))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
