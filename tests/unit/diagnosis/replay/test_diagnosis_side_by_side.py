"""Pieces side by side: in order, errors come out, one thread where one is asked for, and children have their own."""

import multiprocessing
import threading

import pytest

from diagnosis.replay import side_by_side as module
from diagnosis.replay.side_by_side import side_by_side


@pytest.fixture(params=["1", "2"])
def threads(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", request.param)
    module._thread_pool.cache_clear()
    yield int(request.param)
    module._thread_pool.cache_clear()


def test_results_keep_their_order_and_errors_come_out(threads: int) -> None:
    seen: set[str] = set()

    def square(x: int) -> int:
        seen.add(threading.current_thread().name)
        return x * x

    assert side_by_side(square, range(50)) == [x * x for x in range(50)]
    assert (threading.current_thread().name in seen) is (threads == 1)
    with pytest.raises(ZeroDivisionError):
        side_by_side(lambda x: 1 // x, [1, 0, 2])


def _squares(_: int) -> list[int]:
    return side_by_side(lambda x: x * x, [1, 2, 3])


def test_a_forked_child_makes_its_own_threads(threads: int) -> None:
    assert side_by_side(abs, [-1, -2]) == [1, 2]
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert pool.apply_async(_squares, (threads,)).get(timeout=30.0) == [1, 4, 9]
