"""Frames for clients, pacing, faults and the HTTP face, without a network."""

import asyncio
from typing import Any

import httpx
import numpy as np
import pytest

from sim_plc.camera.faults import FaultKind, FaultSwitch
from sim_plc.camera.frames import Frame, FrameHub
from sim_plc.camera.http_app import ExposureGrid, RateGovernor, TrueClock, camera_app, multipart_part, multipart_stream


def frame(sequence: int) -> Frame:
    return Frame(jpeg=b"\xff\xd8" + bytes([sequence]) * 10, t_exposure_ns=1000 * sequence, sequence=sequence)


async def test_a_slow_client_gets_the_newest_frame_and_the_rest_is_counted() -> None:
    hub = FrameHub()
    with hub.subscribe() as slow, hub.subscribe() as quick:
        for sequence in (1, 2, 3):
            hub.publish(frame(sequence))
            assert await quick.next_frame() == frame(sequence)
        assert await slow.next_frame() == frame(3)
        assert (slow.skipped, quick.skipped, hub.skipped_count, hub.n_clients) == (2, 0, 2, 2)
    assert (hub.skipped_count, hub.n_clients) == (2, 0)


async def test_closing_the_hub_ends_the_streams() -> None:
    hub = FrameHub()
    parts: list[bytes] = []

    async def client() -> None:
        parts.extend([part async for part in multipart_stream(hub)])

    task = asyncio.create_task(client())
    await asyncio.sleep(0)
    hub.publish(frame(1))
    await asyncio.sleep(0)
    hub.close()
    await asyncio.wait_for(task, 1.0)
    assert parts == [multipart_part(frame(1)), b"--longreach-frame--\r\n"]


def test_a_part_carries_its_stamps() -> None:
    head, body = multipart_part(frame(7)).split(b"\r\n\r\n", 1)
    assert head.split(b"\r\n") == [
        b"--longreach-frame",
        b"Content-Type: image/jpeg",
        b"Content-Length: 12",
        b"X-Exposure-Ns: 7000",
        b"X-Sequence: 7",
    ]
    assert body == frame(7).jpeg + b"\r\n"


def client_of(hub: FrameHub, faults: FaultSwitch | None, status: str = "ok") -> httpx.AsyncClient:
    def health() -> dict[str, Any]:
        return {"status": status, "fps": 15.0}

    transport = httpx.ASGITransport(app=camera_app(hub, health, faults))
    return httpx.AsyncClient(transport=transport, base_url="http://camera")


async def test_snapshot_and_health() -> None:
    hub = FrameHub()
    async with client_of(hub, None, "starting") as client:
        assert (await client.get("/snapshot.jpg")).status_code == 503
        assert (await client.get("/healthz")).status_code == 503
    hub.publish(frame(4))
    async with client_of(hub, None) as client:
        picture = await client.get("/snapshot.jpg")
        assert (picture.content, picture.headers["X-Sequence"]) == (frame(4).jpeg, "4")
        assert (await client.get("/healthz")).json() == {"status": "ok", "fps": 15.0}


async def test_faults_only_where_enabled_and_only_known_ones() -> None:
    async with client_of(FrameHub(), None) as client:
        assert (await client.post("/fault", json={"kind": "black"})).status_code == 403
    switch = FaultSwitch()
    async with client_of(FrameHub(), switch) as client:
        assert (await client.post("/fault", json={"kind": "left_black"})).json() == {"kind": "left_black"}
        assert switch.kind is FaultKind.LEFT_BLACK
        for body in (b"", b"{}", b'{"kind": "melted"}', b'{"kind": "black", "more": 1}', b"\xff"):
            assert (await client.post("/fault", content=body)).status_code == 422
        assert switch.kind is FaultKind.LEFT_BLACK


def test_what_the_faults_do() -> None:
    switch = FaultSwitch()
    first, second = (np.full((2, 2), grey, np.uint8) for grey in (50, 90))
    assert switch.apply(first, first)[0] is first
    switch.kind = FaultKind.FREEZE
    assert switch.apply(second, second)[1] is first
    switch.kind = FaultKind.LEFT_BLACK
    left, right = switch.apply(second, second)
    assert not left.any()
    assert right is second
    switch.kind = FaultKind.BLACK
    assert not any(image.any() for image in switch.apply(second, second))
    switch.kind = FaultKind.NONE
    assert switch.apply(second, second)[0] is second


def test_exposures_stay_on_their_grid_and_missed_ones_are_counted() -> None:
    grid = ExposureGrid(1_000_000_000, 10.0)
    assert grid.next_exposure(900_000_000) == 1_000_000_000
    assert grid.next_exposure(1_150_000_000) == 1_100_000_000  # late by less than a period: still taken
    assert grid.n_skipped == 0
    assert grid.next_exposure(1_530_000_000) == 1_500_000_000
    assert grid.n_skipped == 3
    grid.rate_hz = 5.0
    assert [grid.next_exposure(0), grid.next_exposure(0)] == [1_600_000_000, 1_800_000_000]


def test_rate_falls_when_work_is_long_and_rises_again() -> None:
    governor = RateGovernor(15.0)
    for _ in range(40):
        governor.record_busy_time(0.030)
    assert (governor.rate_hz, governor.reduced) == (15.0, False)
    changes = [governor.record_busy_time(0.100) for _ in range(15)]
    assert sum(changes) == 1
    assert governor.reduced
    assert governor.rate_hz == pytest.approx(8.5)
    for _ in range(40):
        governor.record_busy_time(0.030)
    assert not governor.reduced


def test_true_clock_takes_the_least_delayed_reading() -> None:
    clock = TrueClock()
    with pytest.raises(RuntimeError, match="saw"):
        clock.mono_ns(0)
    clock.note_pose_time(7_000, 1_000)
    clock.note_pose_time(7_400, 1_500)  # read 100 ns late
    assert clock.mono_ns(8_000) == 2_000
