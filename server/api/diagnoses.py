"""Gap diagnoses over REST: start one on a recording, follow it, fetch its answer as JSON or as a page."""

import asyncio
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter
from fastapi import Path as InPath
from fastapi.responses import FileResponse, JSONResponse, Response
from pydantic import Field

from server.api.problems import problem_response
from server.api.runs import RUN_ID_PATTERN, path_inside, run_path
from server.api.views import Problem, Strict, View
from server.jobs.diagnosing import Diagnoses, Diagnosis

REPORT_CSP = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; sandbox"  # a document, not a page of ours
DIAGNOSED_RUNS_MAX = 10
Id = Annotated[str, InPath(pattern=r"^[0-9a-f]{12}$")]
UNKNOWN: dict[int | str, dict[str, Any]] = {404: {"model": Problem}}
UNFINISHED_RESPONSES = UNKNOWN | {409: {"model": Problem, "description": "it has no result (yet)"}}


class RunDiagnosis(Strict):
    """Of a recorded run."""

    run_id: Annotated[str, Field(pattern=RUN_ID_PATTERN, description="as listed by GET /v1/runs")]


class PathDiagnosis(Strict):
    """Of what lies at a path inside the recordings folder, such as a folder of CSV files."""

    path: Annotated[str, Field(min_length=1, max_length=255)]


class RunsDiagnosis(Strict):
    """Of several recorded runs of one machine together; later runs resolve what the first could not."""

    run_ids: Annotated[
        list[Annotated[str, Field(pattern=RUN_ID_PATTERN)]], Field(min_length=2, max_length=DIAGNOSED_RUNS_MAX)
    ]


class DiagnosisView(View):
    """One diagnosis."""

    diagnosis_id: str
    recording: str
    recordings: list[str] = Field(description="all that are diagnosed together, the first one included")
    job_id: str = Field(description="of the identification that the last recording is of; empty without one")
    state: Literal["waiting", "running", "done", "failed", "stopped"]
    reason: str
    last_line: str
    elapsed_s: float


def diagnoses_router(folder: Path, diagnoses: Diagnoses) -> APIRouter:
    """Routes under /v1/diagnoses."""
    router = APIRouter(prefix="/v1/diagnoses", tags=["diagnoses"])
    refused: dict[int | str, dict[str, Any]] = {404: {"model": Problem}, 409: {"model": Problem}}

    @router.post("", status_code=202, response_model=DiagnosisView, responses=refused)
    async def start_diagnosis(body: RunDiagnosis | PathDiagnosis | RunsDiagnosis) -> JSONResponse:
        """Start `longreach diagnose` in a process of its own at low priority; 409 while another one runs."""
        found, missing = await asyncio.to_thread(_requested_recordings, folder, body)
        if missing:
            detail = f"no recording {', '.join(repr(name[:64]) for name in missing)} in the folder"
            return problem_response(404, "Unknown recording", detail, "unknown_run", "see GET /v1/runs")
        one = diagnoses.start(*found)
        headers = {"Location": f"../v1/diagnoses/{one.diagnosis_id}"}
        return JSONResponse(_diagnosis_view(one).model_dump(), status_code=202, headers=headers)

    @router.get("", response_model=list[DiagnosisView])
    async def list_diagnoses() -> list[DiagnosisView]:
        """The diagnoses since the server started, newest first."""
        return [_diagnosis_view(diagnosis) for diagnosis in reversed(diagnoses.all)]

    @router.get("/{diagnosis_id}", response_model=DiagnosisView, responses=UNKNOWN)
    async def read_diagnosis(diagnosis_id: Id) -> DiagnosisView | JSONResponse:
        """State and progress of a diagnosis."""
        one = diagnoses.find_diagnosis(diagnosis_id)
        return _diagnosis_view(one) if one else _unknown_diagnosis_response(diagnosis_id)

    @router.delete("/{diagnosis_id}", status_code=204, response_class=Response, responses=UNKNOWN)
    async def stop_diagnosis(diagnosis_id: Id) -> Response:
        """Cancel a diagnosis."""
        one = diagnoses.find_diagnosis(diagnosis_id)
        if one is None:
            return _unknown_diagnosis_response(diagnosis_id)
        await diagnoses.stop(one)
        return Response(status_code=204)

    @router.get("/{diagnosis_id}/result", response_model=None, responses=UNFINISHED_RESPONSES)
    async def diagnosis_result(diagnosis_id: Id) -> JSONResponse:
        """The full result as JSON; docs/diagnosis-answer.md describes it field by field."""
        one = diagnoses.find_diagnosis(diagnosis_id)
        if one is None or one.state != "done":
            return _not_finished_response(one) if one else _unknown_diagnosis_response(diagnosis_id)
        return JSONResponse(await asyncio.to_thread(diagnoses.result, one))

    @router.get(
        "/{diagnosis_id}/report",
        response_model=None,
        response_class=FileResponse,
        responses=UNFINISHED_RESPONSES | {200: {"description": "a page", "content": {"text/html": {}}}},
    )
    async def diagnosis_report(diagnosis_id: Id) -> FileResponse | JSONResponse:
        """The report as a self-contained HTML page."""
        one = diagnoses.find_diagnosis(diagnosis_id)
        if one is None or one.state != "done":
            return _not_finished_response(one) if one else _unknown_diagnosis_response(diagnosis_id)
        headers = {"Content-Security-Policy": REPORT_CSP}
        return FileResponse(diagnoses.page(one), media_type="text/html", headers=headers)

    return router


def _requested_recordings(
    folder: Path, body: RunDiagnosis | PathDiagnosis | RunsDiagnosis
) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """The recordings to diagnose, and the requested names that are not recordings (such as the server's database)."""
    if isinstance(body, PathDiagnosis):
        found = path_inside(folder, body.path)
        if found is not None and (found.suffix == ".mcap" or (found / "run.toml").is_file()):
            return (found,), ()
        return (), (body.path,)
    wanted = [body.run_id] if isinstance(body, RunDiagnosis) else body.run_ids
    paths = {run_id: run_path(folder, run_id) for run_id in wanted}
    missing = tuple(run_id for run_id, path in paths.items() if path is None)
    return tuple(path for run_id in wanted if (path := paths[run_id]) is not None), missing


def _diagnosis_view(one: Diagnosis) -> DiagnosisView:
    return DiagnosisView.model_validate(
        {
            "diagnosis_id": one.diagnosis_id,
            "recording": one.recording,
            "recordings": [path.name for path in one.recordings],
            "job_id": one.job_id,
            "state": one.state,
            "reason": one.reason,
            "last_line": one.last_line,
            "elapsed_s": round(one.elapsed_s, 1),
        }
    )


def _unknown_diagnosis_response(diagnosis_id: str) -> JSONResponse:
    return problem_response(
        404, "Unknown diagnosis", f"no diagnosis {diagnosis_id}", "unknown_diagnosis", "POST /v1/diagnoses"
    )


def _not_finished_response(one: Diagnosis) -> JSONResponse:
    detail = f"diagnosis is {one.state}{': ' + one.reason if one.reason else ''}"
    return problem_response(409, "No answer", detail, "no_answer", "wait until its state is done")
