"""Every field of the settings file with its bounds and default, from the models that read it."""

from collections.abc import Iterable, Iterator, Sequence
from types import NoneType
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from server.settings import ServerSettings

# Tables in Markdown.


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; cells on one line, bars escaped."""
    lines = [_markdown_row(headings), _markdown_row(["---"] * len(headings)), *(_markdown_row(cells) for cells in rows)]
    return "\n".join(lines)


def _markdown_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(" ".join(cell.split()).replace("|", "\\|") for cell in cells) + " |"


def code(text: str) -> str:
    """As code; empty stays empty."""
    return f"`{text}`" if text else ""


_BOUNDS = {"ge": "at least", "gt": "more than", "le": "at most", "lt": "less than", "pattern": "like"}


def settings() -> str:
    """One table for each section; the camera's depend on its kind."""
    parts = [table(_HEADINGS, list(_plain_field_rows(ServerSettings)))]
    for name, field in ServerSettings.model_fields.items():
        models = models_of(field.annotation)
        for model in models:
            kind = f', kind = "{_kind_name(model)}"' if len(models) > 1 else ""
            parts.append(
                f"### [{name}]{kind}\n\n{_first_line(model)}\n\n{table(_HEADINGS, list(_plain_field_rows(model)))}"
            )
    return "\n\n".join(parts)


_HEADINGS = ("field", "type", "default", "bounds")


def models_of(annotation: Any) -> list[type[BaseModel]]:
    """The section models in a type."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in models_of(part)]


def _kind_name(model: type[BaseModel]) -> str:
    return str(get_args(model.model_fields["kind"].annotation)[0])


def _first_line(model: type[BaseModel]) -> str:
    return " ".join((model.__doc__ or "").split("\n\n")[0].split())


def _plain_field_rows(model: type[BaseModel]) -> Iterator[tuple[str, str, str, str]]:
    for name, field in model.model_fields.items():
        if not models_of(field.annotation) and name != "kind":
            default = "required" if field.default is PydanticUndefined else _value_text(field.default)
            yield code(name), type_text(field.annotation), default, bounds_text(field)


def _value_text(value: Any) -> str:
    return "" if value is None else code(str(value).lower() if isinstance(value, bool) else str(value))


def type_text(annotation: Any) -> str:
    """A type in the words of a settings file."""
    if annotation in _WORDS:
        return _WORDS[annotation]
    arguments = [part for part in get_args(annotation) if part not in (NoneType, Ellipsis)]
    if get_origin(annotation) is Literal:
        return " or ".join(code(str(part)) for part in arguments)
    if get_origin(annotation) in (list, tuple):
        return f"list of {type_text(arguments[0])}"
    if hasattr(annotation, "__metadata__"):
        return type_text(arguments[0])
    return " or ".join(dict.fromkeys(type_text(part) for part in arguments))


_WORDS: dict[Any, str] = {str: "text", int: "whole number", float: "number", bool: "true or false"}


def bounds_text(field: FieldInfo) -> str:
    """A field's bounds in words; empty without."""
    parts = [
        f"{word} {getattr(bound, name)}"
        for bound in field.metadata
        for name, word in _BOUNDS.items()
        if getattr(bound, name, None) is not None
    ]
    return ", ".join(parts)
