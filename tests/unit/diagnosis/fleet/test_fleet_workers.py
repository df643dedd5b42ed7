"""A worker that dies takes one piece of work along, whatever else was under way."""

import os
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from contextlib import ExitStack
from multiprocessing import get_context
from typing import Any

import pytest

from diagnosis.fleet.workers import Task, Workers


def work(number: int) -> dict[str, Any]:
    if number < 0:
        os._exit(1)
    return {"number": number}


def told(workers: Workers, tasks: list[Task], at_once: int) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name, one in workers.run(work, tasks, at_once):
        assert name not in out
        out[name] = "died" if one.exception() is not None else one.result()["number"]
    return out


@pytest.mark.parametrize("at_once", [1, 64])
def test_only_the_culprits_fail(at_once: int) -> None:
    numbers = [-1, 1, 2, -3, 4, 5]
    tasks: list[Task] = [(str(number), (number,)) for number in numbers]
    with ExitStack() as pools:

        def pool() -> Executor:
            return pools.enter_context(ProcessPoolExecutor(2, mp_context=get_context("spawn")))

        out = told(Workers(pool(), pool), tasks, at_once)
    assert out == {str(number): number if number > 0 else "died" for number in numbers}


class Dead(Executor):
    """A pool that has broken already."""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        raise BrokenExecutor("a worker died")


@pytest.mark.parametrize("renewed", [None, Dead])
def test_without_any_worker_all_fail_and_nothing_hangs(renewed: type[Dead] | None) -> None:
    tasks: list[Task] = [(str(number), (number,)) for number in range(5)]
    assert told(Workers(Dead(), renewed), tasks, 2) == dict.fromkeys("01234", "died")
