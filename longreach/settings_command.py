"""`longreach settings new`: a settings file to start from, with every field, its default and its bounds."""

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from longreach.machine_command import write_new
from longreach.setting_fields import bounds_text, models_of, type_text
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
