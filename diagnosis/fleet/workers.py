"""Work over an executor whose workers may die: a death takes one piece of work along, not the others.

A pool of processes breaks as a whole when one of them dies (out of memory, a crash in compiled code), and nothing says
which piece of work it was.
"""

from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from typing import Any

Work = Callable[..., dict[str, Any]]
Answer = Future[dict[str, Any]]
Task = tuple[str, tuple[Any, ...]]  # name, arguments
Finished = tuple[str, Answer]


class Workers:
    """An executor, and how to get a new one in place of a broken one."""

    def __init__(self, executor: Executor, renewed: Callable[[], Executor] | None = None) -> None:
        self._executor = executor
        self._renewed = renewed

    def _renew_executor(self) -> bool:
        """Whether there is an executor again after a death."""
        if self._renewed is None:
            return False
        self._executor = self._renewed()
        return True

    def run(self, work: Work, tasks: Sequence[Task], at_once: int) -> Iterator[Finished]:
        """Every task's name with its finished future, as they come; at most `at_once` are handed out.

        After a death all that had not finished runs again, one at a time and in its order, until one dies alone: that
        one has failed, and the others go on side by side.
        """
        left, suspects = deque(tasks), deque[Task]()
        while left or suspects:
            if not suspects:
                suspects.extend((yield from self._side_by_side(work, left, at_once)))
                continue
            name, arguments = suspects.popleft()
            alone = self._handed_out(work, arguments)
            wait([alone])
            if _has_worker_died(alone) and self._renew_executor():
                left.extendleft(reversed(suspects))
                suspects.clear()
            yield name, alone

    def _side_by_side(self, work: Work, left: deque[Task], at_once: int) -> Generator[Finished, None, list[Task]]:
        """Hands out until nothing is left, or until a death; what that took along and has to run again."""
        running: dict[Answer, Task] = {}
        dead: list[tuple[Task, Answer]] = []
        while running or (left and not dead):
            while left and len(running) < at_once and not dead:
                task = left.popleft()
                running[self._handed_out(work, task[1])] = task
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for finished in [future for future in running if future in done]:
                task = running.pop(finished)
                if _has_worker_died(finished):
                    dead.append((task, finished))
                else:
                    yield task[0], finished
        if not dead or self._renew_executor():
            return [task for task, _ in dead]
        for (name, _), failed in dead:
            yield name, failed
        return []

    def _handed_out(self, work: Work, arguments: tuple[Any, ...]) -> Answer:
        """A future in any case: of an executor that has broken meanwhile, one that has failed."""
        try:
            return self._executor.submit(work, *arguments)
        except BrokenExecutor as error:
            failed: Answer = Future()
            failed.set_exception(error)
            return failed


def _has_worker_died(answer: Answer) -> bool:
    return isinstance(answer.exception(), BrokenExecutor)
