"""The page's recordings: only plain names inside the folder, and what viewers elsewhere need."""

from types import SimpleNamespace

import httpx
import pytest
from fastapi import FastAPI

from server.api.panel_recordings import recordings_router


@pytest.fixture
async def client(tmp_path):
    folder = tmp_path / "runs"
    folder.mkdir()
    (folder / "look-1.mcap").write_bytes(b"picture")
    (tmp_path / "secret.mcap").write_bytes(b"not yours")
    (folder / "link.mcap").symlink_to(tmp_path / "secret.mcap")
    settings = SimpleNamespace(recording=SimpleNamespace(folder=str(folder)))
    app = FastAPI()
    app.include_router(recordings_router(SimpleNamespace(cell=SimpleNamespace(settings=settings))))
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://here") as made:
        yield made


async def test_what_lies_in_the_folder_is_listed_and_handed_out(client):
    (one,) = (await client.get("/v1/panel/recordings")).json()
    assert one["name"] == "look-1.mcap"
    assert (await client.get("/v1/panel/recordings/look-1.mcap/file")).content == b"picture"


@pytest.mark.parametrize("name", ["..%2Fsecret.mcap", "../secret.mcap", "nothing.mcap", "look-1.txt", "link.mcap"])
async def test_nothing_else_is(client, name):
    for what in ("file", "replay"):
        assert (await client.get(f"/v1/panel/recordings/{name}/{what}")).status_code == 404


async def test_the_layout_for_foxglove_is_downloaded(client):
    answer = await client.get("/v1/panel/recordings/viewers/foxglove-layout")
    assert "attachment" in answer.headers["content-disposition"]
    assert {"configById", "layout"} <= set(answer.json())
