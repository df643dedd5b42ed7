"""The server's own errors: each text names subject, value, limit, unit and remedy."""


class ServerError(Exception):
    """Base of the server's errors. `code` is stable for machines, the text is for people."""

    code = "server_error"
    hint = ""

    def __init__(self, text: str = "", references: dict[str, str] | None = None) -> None:
        super().__init__(text)
        self.references = references or {}


class SettingsError(ServerError):
    """A settings file that cannot be used."""

    code = "settings"


class BusyError(ServerError):
    """Another job owns the machine."""

    code = "busy"
    hint = "wait for the end of that job (GET /v1/jobs/{job_id}/events) or cancel it; jobs are not queued"


class JobFailedError(ServerError):
    """A job that ended without reaching its goal; the reason says what to do."""

    code = "job_failed"

    def __init__(self, reason: str, code: str = "job_failed") -> None:
        super().__init__(reason)
        self.code = code


class PlanRefusedError(ServerError):
    """A previewed plan that may not be executed: unknown, expired, or the machine has moved since."""

    code = "plan_refused"
