"""What can be wrong with Structured Text: its words, its types, or what it does when it runs."""


class StError(Exception):
    """Base of all errors of the Structured Text runner."""


class StSyntaxError(StError):
    """The text is not of the dialect; names source, line and what was met."""


class StTypeError(StError):
    """A compiler would refuse this: names POU, line and subject."""


class StRuntimeError(StError):
    """A PLC could stop or go astray here: names POU and line."""
