"""`longreach sim`: the simulated machine, PLC and stereo camera."""

from pathlib import Path
from socket import AF_INET, SOCK_DGRAM
from typing import Annotated

import typer
from rich.console import Console

from machine.description import parse_machine_toml
from machine.effects.entries import entries_to_toml
from machine.file_tables import with_tables, without_lists
from server.errors import SettingsError
from server.settings import read_machine_text
from server.shell_settings import read_key


def sim(
    preset: Annotated[
        str | None,
        typer.Option(
            help="ideal, realistic, paper or nominal; default: nominal for a file with effects, else realistic"
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="seed of the simulated machine")] = 1,
    machine: Annotated[str, typer.Option(help="machine file, or the name of a shipped one")] = "hiab033",
    plc_host: Annotated[str, typer.Option(help="address the PLC listens on")] = "127.0.0.1",
    plc_port: Annotated[int, typer.Option(help="UDP port the PLC listens on")] = 50110,
    framing: Annotated[str, typer.Option(help="raw or eap")] = "raw",
    camera_host: Annotated[str, typer.Option(help="address the camera serves on")] = "127.0.0.1",
    camera_port: Annotated[int, typer.Option(help="HTTP port of the camera")] = 8090,
    camera_rate_hz: Annotated[float, typer.Option(help="stereo pairs a second")] = 15.0,
    camera_faults: Annotated[bool, typer.Option("--camera-faults", help="obey POST /fault at the camera")] = False,
    camera_time_code: Annotated[
        bool, typer.Option("--camera-time-code", help="paint the exposure's time into the left picture")
    ] = False,
    structure_frac: Annotated[
        float | None,
        typer.Option(help="share of the picture that the crane itself covers, 0 to 0.4; else the preset's"),
    ] = None,
    structure_contrast_frac: Annotated[
        float | None, typer.Option(help="texture of what the crane shows of itself, 0 plain to 1; else the preset's")
    ] = None,
    bare_rock: Annotated[bool, typer.Option("--bare-rock", help="show the wall without the object's markers")] = False,
    holes: Annotated[int, typer.Option(help="boreholes and painted rings on the wall, 0 to 12")] = 0,
    enable: Annotated[str, typer.Option(help="auto, or panel: SIGUSR1 presses the local enable")] = "auto",
    dry_run: Annotated[bool, typer.Option("--dry-run", help="play everything, but leave the valves neutral")] = False,
    auth_key_file: Annotated[str | None, typer.Option(help="hexadecimal key: only signed commands are taken")] = None,
    truth_log: Annotated[Path | None, typer.Option(help="folder for the truth, which the server never sees")] = None,
) -> None:
    """Start the simulated machine in real time, until Ctrl-C."""
    from longreach.processes import Address, require_bindable
    from sim_plc.presets import PresetError, checked_preset
    from sim_plc.process import (  # here, so that the server's process never loads the simulator
        SimSettings,
        SimSettingsError,
        run_sim,
    )

    try:
        text, left_out = _keep_simulated_effects(read_machine_text(machine))
        preset = checked_preset(preset or ("realistic" if left_out is None else "nominal"))
        require_bindable(
            (
                Address(plc_host, plc_port, "--plc-host", "--plc-port", SOCK_DGRAM, AF_INET),
                Address(camera_host, camera_port, "--camera-host", "--camera-port"),
            )
        )
        Console(stderr=True).print(
            f"simulated machine '{preset}', seed {seed}: PLC on udp {plc_host}:{plc_port}, "
            f"camera on http://{camera_host}:{camera_port}/stream"
        )
        for name in left_out or ():
            Console(stderr=True).print(f"[yellow]not simulated:[/] {name} of the machine file: this plant has none")
        run_sim(
            SimSettings(
                machine_text=text,
                preset=preset,
                seed=seed,
                plc_host=plc_host,
                plc_port=plc_port,
                framing=framing,
                camera_host=camera_host,
                camera_port=camera_port,
                camera_rate_hz=camera_rate_hz,
                camera_faults=camera_faults,
                camera_time_code=camera_time_code,
                structure_frac=structure_frac,
                structure_contrast_frac=structure_contrast_frac,
                bare_rock=bare_rock,
                enable=enable,
                round_marks=holes,
                dry_run=dry_run,
                key=read_key(auth_key_file),
                truth_log=truth_log,
            )
        )
    except (SimSettingsError, PresetError) as error:
        raise SettingsError(str(error)) from error


def _keep_simulated_effects(text: str) -> tuple[str, tuple[str, ...] | None]:
    """A machine file's text with the effects that the plant can have; what is left out, None of a file without any."""
    from sim_plc.diagnosed import not_simulated

    machine = parse_machine_toml(text)
    if not machine.effects:
        return text, None
    left_out = not_simulated(machine)
    kept = tuple(effect for effect in machine.effects if effect.name not in left_out)
    return with_tables(without_lists(text, ("effect",)), entries_to_toml(kept)), left_out
