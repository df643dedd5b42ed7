"""The whole REST side on a loopback port, with keys of every role and a stand-in machine: for tools that speak HTTP."""

import asyncio
import contextlib
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import uvicorn

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "api"))
from served import Bench, bench

from longreach.processes import free_port
from server.api.connection_limit import PatientProtocol


@contextlib.contextmanager
def served(folder: Path, keyed: bool = True) -> Iterator[tuple[str, Bench]]:
    """Its address and what it is made of; nothing of it is left afterwards."""
    made, port = bench(folder, keyed=keyed), free_port()

    @contextlib.asynccontextmanager
    async def lifespan(_app):
        async with made.running.tasks():
            yield

    made.app.router.lifespan_context = lifespan
    config = uvicorn.Config(made.app, port=port, log_level="warning", access_log=False, http=PatientProtocol)
    config.timeout_graceful_shutdown = 1
    server = uvicorn.Server(config)
    thread = threading.Thread(target=lambda: asyncio.run(server.serve()), daemon=True)
    thread.start()
    try:
        while not server.started:
            thread.join(0.05)
        yield f"http://127.0.0.1:{port}", made
    finally:
        server.should_exit = True
        thread.join(10.0)
        made.keeper.database.close()


def main() -> None:
    """Serve until Ctrl-C; prints the address and the keys: `python tests/system/rest_stand.py FOLDER`."""
    with served(Path(sys.argv[1])) as (url, made):
        print(url, flush=True)
        for role, key in made.keys.items():
            print(role, key, flush=True)
        with contextlib.suppress(KeyboardInterrupt):
            threading.Event().wait()


if __name__ == "__main__":
    main()
