"""Subcommands that are imported when they are called: the list of them needs none, and a process only its own."""

from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar

import typer
import typer.main
from typer.core import TyperCommand, TyperGroup

from server.errors import SettingsError

CHECKOUT_ONLY_PACKAGE = "benchmarks"  # a package that is not in the wheel


@dataclass(frozen=True, slots=True)
class Lazy:
    """One subcommand. `import_path` is `module:attribute` of a function or of a `Typer`."""

    name: str
    import_path: str
    help_text: str

    @property
    def of_checkout(self) -> bool:
        """Whether it comes with the source checkout only."""
        return self.import_path.startswith(f"{CHECKOUT_ONLY_PACKAGE}.")

    def load(self) -> Any:
        """The command itself, as typer makes it."""
        module, _, attribute = self.import_path.partition(":")
        try:
            found, app = getattr(import_module(module), attribute), typer.Typer()
        except ModuleNotFoundError as error:
            raise _missing_library_error(self.name, error) from error
        if isinstance(found, typer.Typer):
            app.add_typer(found, name=self.name, help=self.help_text)
        else:
            app.command(self.name)(found)
        return typer.main.get_group(app).commands[self.name]


SERVER_LIBRARIES = ("cv2", "fastapi", "httpx", "httptools", "prometheus_client", "uvicorn", "viser", "websockets")


def _missing_library_error(command: str, error: ModuleNotFoundError) -> Exception:
    """What to install for a command; the error itself where a module of our own is missing."""
    library = (error.name or "").split(".")[0]
    if library == CHECKOUT_ONLY_PACKAGE:
        return SettingsError(
            f"`{command}` is part of the source checkout and not of the installed package; clone the repository, "
            "`pip install -e '.[server]'` in it, and call it again"
        )
    if library not in SERVER_LIBRARIES:
        return error
    return typer.BadParameter(f"`{command}` needs {library}, which is not installed: pip install 'longreach[server]'")


class LazyCommand(TyperCommand):
    """Stands for a subcommand in the list, and becomes it when its arguments are to be read."""

    def __init__(self, lazy: Lazy) -> None:
        super().__init__(lazy.name, help=lazy.help_text)
        self.lazy = lazy

    def load(self) -> Any:
        """The command that this one stands for."""
        return self.lazy.load()

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """That of the command itself, so that all that follows is its own."""
        return self.load().make_context(info_name, args, parent=parent, **extra)


def loaded_command(command: Any) -> Any:
    """A command with its parameters or commands: itself, or what it stands for."""
    return command.load() if isinstance(command, LazyCommand) else command


class LazyGroup(TyperGroup):
    """A command group with the commands of its table, in addition to those it is given."""

    lazy_commands: ClassVar[tuple[Lazy, ...]] = ()

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = {**{lazy.name: LazyCommand(lazy) for lazy in self.lazy_commands}, **self.commands}
