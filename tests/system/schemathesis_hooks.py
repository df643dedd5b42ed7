"""Loaded by schemathesis: what it makes and no HTTP client sends, or no server may refuse, is mended or left out."""

import schemathesis

UNKNOWN_HEADER = "x-schemathesis-unknown-property"


@schemathesis.hook
def before_call(_context, case, **_kwargs):
    """A link that it infers puts a number from an answer into a header as a number; a client writes it as text."""
    for name, value in list((case.headers or {}).items()):
        if isinstance(value, int | float):
            case.headers[name] = str(value)


@schemathesis.hook
def filter_case(_context, case):
    """A header that the schema does not name is no mistake: proxies add theirs."""
    return UNKNOWN_HEADER not in (case.headers or {})
