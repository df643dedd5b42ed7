"""The 3D scene in a process of its own: it may hang, crash or be killed, and takes nothing along."""

import contextlib
import logging
import multiprocessing
import os
import signal
import sys
import threading
from dataclasses import replace
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import cast

from machine.description import Machine
from recording.spawn import out_of_the_terminals_reach
from web.scene_view import SceneView

log = logging.getLogger(__name__)

START_S = 180.0  # on a busy small computer
END_S = 2.0
TOKEN_S = 0.2  # how soon the sender sees that it is to end


class SceneGoneError(Exception):
    """The scene's process has ended."""


class SceneProcess:
    """Starts it, hands it views, ends it. `start` and `close` block, `show` never does."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._process: BaseProcess | None = None
        self._pipe: Connection | None = None
        self._newest: SceneView | None = None
        self._changed = threading.Condition()
        self._sender: threading.Thread | None = None
        self._closing = self._broken = False
        self.port = 0

    @property
    def process_id(self) -> int | None:
        """Of the process, while it runs."""
        return self._process.pid if self._process is not None and self._process.is_alive() else None

    def start(self) -> None:
        """Raises: SceneGoneError: it did not come up."""
        context = multiprocessing.get_context("spawn")
        ours, theirs = cast("tuple[Connection, Connection]", context.Pipe())
        process = context.Process(target=run_scene, args=(theirs, self._machine), name="longreach-scene", daemon=True)
        with out_of_the_terminals_reach(signal.SIGTERM):
            process.start()
        theirs.close()
        self._process, self._pipe = process, ours
        try:
            if not ours.poll(START_S):
                raise EOFError
            self.port = int(ours.recv())
        except (EOFError, OSError) as error:
            self.close()
            raise SceneGoneError("the 3D view's process did not start") from error
        self._sender = threading.Thread(target=self._hand_over, args=(ours,), name="scene-sender", daemon=True)
        self._sender.start()

    def show(self, view: SceneView) -> None:
        """Leave the newest view for the sender and return immediately; one that it has not sent yet is left out.

        Raises: SceneGoneError: the process has ended.
        """
        if self._broken or self.process_id is None:
            raise SceneGoneError("the 3D view's process has ended")
        with self._changed:
            if self._newest is not None and view.picture_jpeg is None:  # pictures are rare: none is left out with it
                view = replace(view, picture_jpeg=self._newest.picture_jpeg)
            self._newest = view
            self._changed.notify()

    def _hand_over(self, pipe: Connection) -> None:
        """Thread: one view for each token. A process that is frozen after its token holds up this thread only."""
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._newest is not None or self._closing)
                if self._closing:
                    return
                if not pipe.poll(TOKEN_S):  # a token for each view it has drawn
                    continue
                pipe.recv()
                with self._changed:
                    view, self._newest = self._newest, None
                pipe.send(view)
        except (EOFError, OSError, TypeError):  # TypeError: the pipe was closed under a send
            self._broken = True

    def close(self) -> None:
        """End it, by force if it does not listen."""
        process, pipe = self._process, self._pipe
        self._process = self._pipe = None
        with self._changed:
            self._closing = True
            self._changed.notify()
        if self._sender is not None:
            self._sender.join(2.0 * TOKEN_S)  # while it listens, the other end would not see the pipe's end
        if pipe is not None:
            pipe.close()
        if process is not None:
            process.join(END_S)
            if process.is_alive():
                process.kill()
                process.join(1.0)


def run_scene(pipe: Connection, machine: Machine) -> None:
    """Entry point of the process: draws what comes, asks for the next, ends with the pipe."""
    with contextlib.suppress(OSError):
        os.nice(5)  # never before link and vision
    with contextlib.redirect_stdout(sys.stderr):
        from web.scene import Scene

        scene = Scene(machine)
    try:
        pipe.send(scene.port)
        pipe.send("next")
        while True:
            scene.update_scene(pipe.recv())
            pipe.send("next")
    except (EOFError, OSError):
        log.info("the server is gone; the 3D view ends")
    finally:
        scene.close()
