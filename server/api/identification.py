"""How far an identification is, over REST: what is driven, what is left, and what to do next."""

from fastapi import APIRouter

from server.api.views import View
from server.jobs.identification import Identification


class IdentificationView(View):
    """The identification of this life of the server. `next_step`: empty where there is nothing to do."""

    parts_done: list[str]
    parts_left: list[str]
    recordings: list[str]
    diagnosis_id: str
    next_step: str


def identification_router(identification: Identification) -> APIRouter:
    """Route /v1/identification."""
    router = APIRouter(prefix="/v1/identification", tags=["machine"])

    @router.get("", response_model=IdentificationView)
    async def read_identification() -> IdentificationView:
        """Completed and remaining parts of the last identification."""
        session = identification.session
        return IdentificationView(
            parts_done=[] if session is None else session.done,
            parts_left=[] if session is None else list(session.left),
            recordings=[] if session is None else [path.name for path in session.recordings],
            diagnosis_id="" if session is None else session.diagnosis_id,
            next_step=identification.next_step,
        )

    return router
