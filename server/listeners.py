"""Who is called when something happens. One that raises keeps nothing from the others, and is a fault."""

import logging
import time
from collections.abc import Callable
from typing import Generic, ParamSpec

log = logging.getLogger(__name__)
P = ParamSpec("P")
FAILURE_REPORT_DURATION_S = 10.0  # as of a supervised task: without another failure it is reported no more


class Listeners(Generic[P]):
    """Of one kind of event, called in the order in which they came."""

    def __init__(self, of: str) -> None:
        self._of, self._listeners = of, list[Callable[P, object]]()
        self._problem, self._failed_s = "", 0.0

    def add(self, listener: Callable[P, object]) -> Callable[[], None]:
        """Call it from now on; the answer ends that."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def call(self, *args: P.args, **kwargs: P.kwargs) -> str:
        """Call all of them; which failed and how, empty when none did."""
        problem = ""
        for listener in tuple(self._listeners):
            try:
                listener(*args, **kwargs)
            except Exception as error:  # the outermost call of a part: what it drops is reported
                problem = f"{getattr(listener, '__qualname__', 'a listener')} failed to handle {self._of}: {error!r}"
                if problem != self._problem:
                    log.exception(problem)
                self._problem, self._failed_s = problem, time.monotonic()
        return problem

    @property
    def recent_failure(self) -> str:
        """What failed within the last FAILURE_REPORT_DURATION_S; empty when all is well."""
        return self._problem if time.monotonic() - self._failed_s < FAILURE_REPORT_DURATION_S else ""
