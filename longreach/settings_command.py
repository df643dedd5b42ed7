"""`longreach settings new`: a settings file to start from, with every field, its default and its bounds."""

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin

import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from longreach.machine_command import write_new
from server.settings import ServerSettings

app = typer.Typer(no_args_is_help=True)


@app.callback()
def settings() -> None:
    """Keep `new` a subcommand."""


@app.command()
def new(file: Annotated[Path, typer.Argument(help="the settings file to write")] = Path("settings.toml")) -> None:
    """Write a settings file with every field and its default, commented out."""
    write_new(file, settings_template())


def settings_template() -> str:
    """TOML text that says nothing but the defaults: every field is a comment."""
    lines = ["# Settings of `longreach serve --settings FILE`. Commented lines show the defaults.", ""]
    lines += _field_lines(ServerSettings)
    for name, field in ServerSettings.model_fields.items():
        models = models_of(field.annotation)
        for model in models:
            kind = model.model_fields.get("kind") if len(models) > 1 else None
            lines += ["", f"# {' '.join((model.__doc__ or '').split())}"]
            lines += [f"# [{name}]"] + ([] if kind is None else [f'# kind = "{type_text(kind.annotation).strip("`")}"'])
            lines += _field_lines(model)
    text = "\n".join(lines) + "\n"
    tomllib.loads(text)
    return text


def _field_lines(model: type[BaseModel]) -> Iterator[str]:
    for name, field in model.model_fields.items():
        if models_of(field.annotation) or name == "kind":
            continue
        bounds = bounds_text(field)
        about = f"{type_text(field.annotation)}{', ' + bounds if bounds else ''}".replace("`", "")
        default = field.get_default(call_default_factory=True, validated_data={})
        if default is PydanticUndefined:
            yield f"# {name} =  # required: {about}"
        else:
            yield f"# {name} = {_toml_value(default)}  # {about}"


def _toml_value(value: Any) -> str:
    """A default in TOML; nothing where there is none."""
    if value is None:
        return ""
    if isinstance(value, BaseModel):
        return "{}"
    return json.dumps(list(value) if isinstance(value, tuple | frozenset) else value, ensure_ascii=False, default=str)


_BOUNDS = {"ge": "at least", "gt": "more than", "le": "at most", "lt": "less than", "pattern": "like"}


def models_of(annotation: Any) -> list[type[BaseModel]]:
    """The section models in a type."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in models_of(part)]


def type_text(annotation: Any) -> str:
    """A type in the words of a settings file."""
    if annotation in _WORDS:
        return _WORDS[annotation]
    arguments = [part for part in get_args(annotation) if part not in (NoneType, Ellipsis)]
    if get_origin(annotation) is Literal:
        return " or ".join(f"`{part}`" for part in arguments)
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
