"""Numbers at every edge of REST: no 5xx, nothing undocumented, and no job unless its number is in bounds.

Schemathesis makes values from the schema; what JSON text and headers can carry beside them comes from here: NaN,
1e999, -0, integers of hundreds of digits, numbers as text, depth without end.
"""

import asyncio
import json
import math
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "api"))
from served import bench

TOLD = {400, 403, 409, 422, 503}  # what a command may be refused with
DEFAULT = settings(max_examples=120, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))

EDGES = (
    *("NaN", "Infinity", "-Infinity", "1e999", "-1e999", "1e-999", "-0", "0", "-0.0", "1E+2", "null", "true", "false"),
    *("9.999999999999999", "10", "1000", "1000.0000000000001", "1001", "9007199254740993", '"300"', "[300]", "{}"),
    *("1" + "0" * 400, "-" + "9" * 5000, "0." + "0" * 400 + "1", "300." + "0" * 3000),
)
numbers = st.one_of(
    st.sampled_from(EDGES),
    st.floats(width=64)
    .map(repr)
    .map(lambda text: {"nan": "NaN", "inf": "Infinity", "-inf": "-Infinity"}.get(text, text)),
    st.floats(min_value=9.0, max_value=1001.0).map(repr),
    st.integers().map(str),
)


class Stand:
    """The application on a loop of its own, used from synchronous tests."""

    def __init__(self, folder: Path) -> None:
        self.loop = asyncio.new_event_loop()
        self.made = bench(folder)

    def close(self) -> None:
        self.made.keeper.database.close()
        self.loop.close()

    def ask(self, method: str, path: str, text: str = "", headers: dict[str, str] | None = None):
        return self.loop.run_until_complete(self._ask(method, path, text, headers or {}))

    async def _ask(self, method, path, text, headers):
        async with self.made.client() as client:
            sent = {"content": text, "headers": {"content-type": "application/json", **headers}}
            answer = await client.request(method, path, **sent)
            await self.made.settled()
        return answer

    def control(self):
        held = self.made.service.engine.leases.held
        if held is None or held.owner != "test":
            return self.loop.run_until_complete(self._control())
        return {"Longreach-Lease": held.lease_id, "Longreach-Fencing": str(held.fencing)}

    async def _control(self):
        return self.made.control()

    @property
    def jobs(self):
        return len(self.made.service.engine.jobs)


@pytest.fixture(scope="module")
def stand(tmp_path_factory):
    made = Stand(tmp_path_factory.mktemp("served"))
    yield made
    made.close()


def well_told(answer, expected):
    assert answer.status_code in expected, (answer.status_code, answer.text[:300])
    if answer.status_code >= 400:
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.json()["code"]


def number_of(text):
    """What a reader of JSON makes of it; None for no number."""
    try:
        value = json.loads(text)
    except ValueError:
        return None
    return value if isinstance(value, int | float) and not isinstance(value, bool) else None


def in_bounds(text, low, high):
    value = number_of(text)
    return value is not None and not (isinstance(value, float) and math.isnan(value)) and low <= value <= high


@DEFAULT
@given(text=numbers)
@example("10")
@example("1000")
@example("1001")
def test_a_job_begins_only_with_a_number_in_its_bounds(stand, text):
    made = stand.made
    ids = {job.job_id for job in made.service.engine.jobs}
    answer = stand.ask("POST", "/v1/jobs", f'{{"kind": "retract", "distance_mm": {text}}}', stand.control())
    begun = [job for job in made.service.engine.jobs if job.job_id not in ids]
    wanted = in_bounds(text, 10.0, 1000.0)
    well_told(answer, {202} if wanted else TOLD)
    assert len(begun) == int(wanted)


@DEFAULT
@given(text=numbers)
@example("1")
@example("120")
@example("121")
def test_a_lease_is_given_only_for_a_time_in_its_bounds(stand, text):
    stand.loop.run_until_complete(_free(stand.made))
    answer = stand.ask("POST", "/v1/lease", f'{{"owner": "edge", "ttl_s": {text}}}')
    well_told(answer, {201} if in_bounds(text, 1.0, 120.0) else TOLD)
    stand.loop.run_until_complete(_free(stand.made))


async def _free(made):
    desk = made.service.engine.leases
    if desk.held is not None:
        desk.release(desk.held.lease_id)


printable = st.text(st.characters(min_codepoint=0x21, max_codepoint=0x7E), max_size=80)
values = st.one_of(numbers.map(lambda text: text.strip('"')), printable, st.sampled_from(["1_0", "+5", "٣", "0x10"]))


def as_header(text):
    return text.encode("latin-1", "replace").decode("latin-1")[:4000]


@DEFAULT
@given(header=st.sampled_from(["Longreach-Fencing", "Longreach-Expires"]), text=values)
def test_numbers_in_headers_are_read_or_refused(stand, header, text):
    headers = stand.control() | {header: as_header(text)}
    fencing = headers["Longreach-Fencing"] == stand.control()["Longreach-Fencing"]
    before = stand.jobs
    answer = stand.ask("POST", "/v1/jobs", '{"kind": "park"}', headers)
    well_told(answer, {202} | TOLD)
    if header == "Longreach-Fencing" and not fencing and stand.jobs > before:
        assert int(text) == int(stand.control()["Longreach-Fencing"])  # another way to write the same number


PAGES = ["/v1/audit", "/v1/runs", "/v1/calibrations", "/v1/looks"]


@DEFAULT
@given(path=st.sampled_from(PAGES), name=st.sampled_from(["limit", "before"]), text=values)
def test_numbers_in_queries_are_read_or_refused(stand, path, name, text):
    answer = stand.loop.run_until_complete(_get(stand.made, path, {name: text[:3000]}))
    well_told(answer, {200, 422})
    if answer.status_code == 200:
        assert isinstance(answer.json(), list)


async def _get(made, path, params):
    async with made.client() as client:
        return await client.get(path, params=params)


@DEFAULT
@given(text=values)
def test_a_story_resumes_from_any_number(stand, text):
    if not stand.jobs:
        stand.ask("POST", "/v1/jobs", '{"kind": "park"}', stand.control())
    job = stand.made.service.engine.jobs[-1]
    answer = stand.ask("GET", f"/v1/jobs/{job.job_id}/events", headers={"Last-Event-ID": as_header(text)})
    well_told(answer, {200, 422})
    assert answer.status_code != 200 or "event: end" in answer.text


@pytest.mark.parametrize(
    "text", ["[" * 60_000, '{"kind":' * 7_000, '{"kind": "look"}' + " " * 60_000, '"' + "\\u0000" * 9000 + '"']
)
def test_depth_and_length_are_refused_and_begin_nothing_else(stand, text):
    answer = stand.ask("POST", "/v1/jobs", text, stand.control())
    well_told(answer, {202} if text.startswith('{"kind": "look"}') else {400, 422})
