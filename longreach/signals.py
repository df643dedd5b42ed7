"""Handle SIGTERM and SIGHUP as Ctrl-C, so that each of them stops the machine."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

TERMINATION_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)
)  # Windows: no SIGHUP
_ended_by: list[int] = []


def end_as_by_ctrl_c() -> None:
    """From now on, in this process. What is ignored, as SIGHUP under nohup, stays so."""
    if threading.current_thread() is not threading.main_thread():
        return
    for number in TERMINATION_SIGNALS:
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _as_ctrl_c)


@contextlib.contextmanager
def ended_as_by_ctrl_c() -> Iterator[None]:
    """Inside it, in the main thread, as `end_as_by_ctrl_c`; a program's own handlers stay."""
    in_main = threading.current_thread() is threading.main_thread()
    ours = [number for number in TERMINATION_SIGNALS if in_main and signal.getsignal(number) is signal.SIG_DFL]
    end_as_by_ctrl_c()
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)


def _as_ctrl_c(number: int, frame: FrameType | None) -> None:
    """Handle this signal as Ctrl-C is handled at present: by Python, asyncio or the web server."""
    _ended_by.append(number)
    handler = signal.getsignal(signal.SIGINT)
    if not callable(handler):  # a shell starts its background jobs with Ctrl-C ignored
        raise KeyboardInterrupt
    handler(signal.SIGINT, frame)


def exit_code(code: object) -> int:
    """Of a command that ended with `code`: a failure after a signal is that signal's, as shells count."""
    code = code if isinstance(code, int) else int(code is not None)
    return 128 + _ended_by[0] if _ended_by and code else code


@contextlib.contextmanager
def not_interrupted() -> Iterator[None]:
    """What ends child processes is bounded in time, and goes on through a second Ctrl-C."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, *TERMINATION_SIGNALS)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
