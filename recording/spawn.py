"""Starting the child processes of the server and of the simulator."""

import contextlib
import signal
from collections.abc import Iterator

TERMINAL = (signal.SIGINT, signal.SIGHUP)


@contextlib.contextmanager
def out_of_the_terminals_reach() -> Iterator[None]:
    """What is started inside never gets the signals that a terminal sends to all at once: its parent gets them, and
    ends it in the right order. They are blocked before the child's first instruction, in this thread only.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
