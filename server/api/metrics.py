"""/metrics in Prometheus' text format: read from the cell when scraped, nothing is counted twice."""

import asyncio
from collections.abc import Callable, Iterator
from typing import Any

from fastapi import APIRouter
from fastapi.responses import Response
from prometheus_client import CollectorRegistry, Counter, Metric, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.exposition import CONTENT_TYPE_LATEST
from prometheus_client.registry import Collector

from recording.clock import mono_ns
from server.api.oversight import fault_views
from server.api.panel_alarm_catalogue import CATALOGUE
from server.jobs.engine import Job, JobEvent
from server.jobs.service import JobService

TEXT: dict[int | str, dict[str, Any]] = {
    200: {"description": "Prometheus text format", "content": {"text/plain": {"schema": {"type": "string"}}}}
}


def metrics_router(service: JobService, readers: Callable[[], int]) -> APIRouter:
    """Route /metrics."""
    router = APIRouter(tags=["metrics"])
    registry = CollectorRegistry()
    registry.register(CellCollector(service, readers))
    ProcessCollector(registry=registry)
    ended = Counter("longreach_jobs_ended", "jobs by kind and end", ("kind", "state"), registry=registry)

    def count(job: Job, event: JobEvent) -> None:
        if event.name == "ended":
            ended.labels(job.kind, job.state.value).inc()

    service.engine.on_event(count)
    pairs = Counter("longreach_camera_pairs", "stereo pairs processed since the start", registry=registry)
    service.cell.vision.on_report(lambda _: pairs.inc())

    @router.get("/metrics", response_model=None, response_class=Response, responses=TEXT)
    async def read_metrics() -> Response:
        """Metrics in the Prometheus text format; if keys are in use, a viewer's key is needed."""
        return Response(generate_latest(registry), headers={"Content-Type": CONTENT_TYPE_LATEST})

    return router


class CellCollector(Collector):
    """The cell's figures at the moment of the scrape."""

    def __init__(self, service: JobService, readers: Callable[[], int]) -> None:
        self._service, self._readers = service, readers

    def collect(self) -> Iterator[Metric]:
        """One family per figure."""
        for name, text, value in [
            *_link_figures(self._service),
            *_camera_figures(self._service),
            *_service_figures(self._service),
        ]:
            yield GaugeMetricFamily(f"longreach_{name}", text, value)
        yield GaugeMetricFamily("longreach_event_readers", "readers of /v1/events", self._readers())
        for name, text, value in _link_counters(self._service):
            yield CounterMetricFamily(f"longreach_{name}", text, value)
        yield _alarm_metric(self._service)
        yield _fault_metric(self._service)


Figures = list[tuple[str, str, float]]


def _link_figures(service: JobService) -> Figures:
    health, latest = service.cell.link.health, service.cell.link.latest
    age_s = (mono_ns() - latest.t_mono_ns) * 1e-9 if latest is not None else float("nan")
    return [
        ("plc_state_age_seconds", "age of the newest PLC state", age_s),
        ("plc_round_trip_seconds", "link round trip", health.round_trip_ms * 1e-3),
        ("plc_lateness_p99_seconds", "99th percentile of the sender's lateness", health.lateness_p99_us * 1e-6),
    ]


def _link_counters(service: JobService) -> Figures:
    """What only grows; Prometheus takes a smaller value for a restart."""
    health, latest = service.cell.link.health, service.cell.link.latest
    return [
        ("plc_states_received", "PLC states received", health.received),
        ("plc_states_lost", "PLC states lost", health.lost),
        ("plc_states_dropped", "PLC states that the server did not fetch in time", health.samples_dropped),
        ("plc_underruns", "knot buffer underruns", latest.underruns if latest is not None else 0),
    ]


def _alarm_metric(service: JobService) -> Metric:
    """Every code of the catalogue, so that a rule can be written before an alarm was ever on."""
    family = GaugeMetricFamily("longreach_alarm", "1 while the alarm's cause is there", labels=("code", "priority"))
    active = service.alarm_codes()
    for kind in CATALOGUE.values():
        family.add_metric((kind.code, kind.level), float(kind.code in active))
    return family


def _fault_metric(service: JobService) -> Metric:
    family = GaugeMetricFamily("longreach_fault", "1 while GET /v1/faults lists it", labels=("fault_id", "level"))
    for fault in fault_views(service):
        family.add_metric((fault.fault_id, fault.level), 1.0)
    return family


def _camera_figures(service: JobService) -> Figures:
    report = service.cell.vision.latest
    if report is None:
        return []
    age_s = (mono_ns() - report.t_receive_mono_ns) * 1e-9
    return [
        ("camera_pairs_per_second", "stereo pairs processed", report.fps),
        ("camera_age_seconds", "age of the newest pair", age_s),
        ("camera_process_seconds", "processing time of one pair", report.process_ms * 1e-3),
    ]


def _service_figures(service: JobService) -> Figures:
    job = service.engine.current
    keeper, free = service.keeper, service.disk.free_bytes
    return [
        ("job_running", "1 while a job runs", float(job is not None and not job.has_ended)),
        ("control_held", "1 while a client has control", float(service.engine.leases.held is not None)),
        ("fencing", "the highest fencing number given", service.engine.leases.book.fencing),
        ("store_ok", "1 while the database can be written", float(keeper is not None and not keeper.why_not_storing)),
        ("faults", "faults now", len(fault_views(service))),
        ("disk_free_bytes", "free disk space where recordings are written", float("nan") if free is None else free),
        ("asyncio_tasks", "tasks of the event loop", len(asyncio.all_tasks())),
        ("store_bytes", "size of the database with its log", _database_size_bytes(service)),
    ]


def _database_size_bytes(service: JobService) -> float:
    """Bytes of the database file and of its write-ahead log."""
    path = service.keeper.database.path if service.keeper is not None else None
    files = [] if path is None else [path, path.with_name(path.name + "-wal")]
    return float(sum(file.stat().st_size for file in files if file.exists()))
