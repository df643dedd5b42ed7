"""`longreach serve` with odometry on from the start, as it is during a calibration: the whole of the vision load."""

import asyncio

import server.app
from longreach.cli import main
from server.camera.client import VisionClient


class BusyVision(VisionClient):
    """The server's own vision client; nothing but the moment in which odometry begins is different."""

    async def start(self) -> None:
        """Start the vision process, and odometry as soon as it can."""
        await super().start()
        self._beginning = asyncio.create_task(self.start_odometry(), name="odometry")


if __name__ == "__main__":
    setattr(server.app, "VisionClient", BusyVision)  # noqa: B010  # what `build_cell` will look up
    main()
