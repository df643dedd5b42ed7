"""A process that has imported one stage of a case and does each piece of work in a child of its own.

Importing takes two seconds of a case's thirty. A child knows what its stage imports and what its own case gives it:
what one case leaves behind no other one sees, and no stage's process ever holds another stage's modules.
"""

import importlib
import json
import os
import runpy
import signal
import subprocess
import sys
import traceback
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from recording.spawn import SINGLE_THREAD_ENVIRONMENT


def with_path(root: Path) -> dict[str, str]:
    """This environment, for a child that finds the modules of `root`, and does not search its working folder."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (str(root), os.environ.get("PYTHONPATH", ""))))}


class Warm:
    """`module` is run as `python -m` would; `beforehand` is imported before the first time."""

    def __init__(self, module: str, beforehand: str, root: Path) -> None:
        self._module = module
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "benchmarks.diagnosis.gap.warm", beforehand],
            cwd=root,
            env={**with_path(root), **SINGLE_THREAD_ENVIRONMENT},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            process_group=0,  # Ctrl-C is for the one who waits
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exc: object) -> None:
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._process.wait()

    def run(self, arguments: list[str], log: Path, longest_s: float) -> int | None:
        """Its exit code, None where it was stopped for its time or crashed; its words go to `log`."""
        stdin, stdout = self._process.stdin, self._process.stdout
        asked = {"module": self._module, "arguments": arguments, "log": str(log), "longest_s": longest_s}
        if stdin is None or stdout is None:
            return None
        stdin.write(json.dumps(asked) + "\n")
        stdin.flush()
        line = stdout.readline()
        return json.loads(line) if line else None


def _child(asked: dict[str, Any]) -> int:
    """In the child: its words to the log, the module as `python -m`."""
    file = os.open(asked["log"], os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    os.dup2(file, 1)
    os.dup2(file, 2)
    signal.setitimer(signal.ITIMER_REAL, asked["longest_s"])  # SIGALRM ends it
    sys.argv = [asked["module"], *asked["arguments"]]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # the module is imported already: that is the point
            runpy.run_module(asked["module"], run_name="__main__", alter_sys=True)
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    return 0


def _ended(pid: int) -> int | None:
    status = os.waitpid(pid, 0)[1]
    return os.WEXITSTATUS(status) if os.WIFEXITED(status) else None


def main() -> None:
    """Serve one line after another until the other end closes."""
    with suppress(OSError):
        os.nice(19)
    importlib.import_module(sys.argv[1])
    for line in sys.stdin:
        pid = os.fork()
        if pid == 0:
            code = 1
            try:
                code = _child(json.loads(line))
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(code)
        print(json.dumps(_ended(pid)), flush=True)


if __name__ == "__main__":
    main()
