"""`longreach relay`: a network that misbehaves, between the server and a PLC."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from server.errors import SettingsError

if TYPE_CHECKING:  # at run time only where it is used: the server's process never loads the simulator
    from sim_plc.relay.faults import Faults, Windows
    from sim_plc.relay.relay_process import RelayFigures

Share = Annotated[float, typer.Option(min=0.0, max=100.0, help="share of the datagrams, in %")]
Milliseconds = Annotated[float, typer.Option(min=0.0, help="in ms")]
After = Annotated[float | None, typer.Option(min=0.0, help="seconds after the first datagram; default: never")]
For = Annotated[float | None, typer.Option(min=0.0, help="seconds; default: until the end")]
_FOR_GOOD_S = 1e9


def relay(
    plc_host: Annotated[str, typer.Option(help="address of the PLC")] = "127.0.0.1",
    plc_port: Annotated[int, typer.Option(help="UDP port of the PLC")] = 50110,
    listen_host: Annotated[str, typer.Option(help="address to listen on, for the PC")] = "127.0.0.1",
    listen_port: Annotated[int, typer.Option(help="UDP port to listen on, for the PC")] = 50120,
    seed: Annotated[int, typer.Option(help="seed of the faults")] = 1,
    direction: Annotated[str, typer.Option(help="both, to-plc or to-pc: for all but cut and freeze")] = "both",
    loss_pct: Share = 0.0,
    burst_pct: Annotated[
        float, typer.Option(min=0.0, max=100.0, help="datagrams that begin a run of losses, in %")
    ] = 0.0,
    burst_length: Annotated[int, typer.Option(min=1, help="datagrams lost in a run")] = 10,
    duplicate_pct: Share = 0.0,
    reorder_pct: Share = 0.0,
    reorder_ms: Annotated[float, typer.Option(min=0.0, help="how long those are held back, in ms")] = 30.0,
    delay_ms: Milliseconds = 0.0,
    jitter_ms: Annotated[float, typer.Option(min=0.0, help="up to this much more, in ms")] = 0.0,
    corrupt_pct: Annotated[float, typer.Option(min=0.0, max=100.0, help="one to eight bits flipped, in %")] = 0.0,
    truncate_pct: Share = 0.0,
    replay_pct: Annotated[
        float, typer.Option(min=0.0, max=100.0, help="share followed by a repeated old datagram, in %")
    ] = 0.0,
    cut_after_s: After = None,
    cut_for_s: For = None,
    cut_direction: Annotated[str, typer.Option(help="both, to-plc or to-pc")] = "both",
    freeze_after_s: After = None,
    freeze_for_s: For = None,
    freeze_direction: Annotated[str, typer.Option(help="both, to-plc or to-pc")] = "to-pc",
    for_s: Annotated[float | None, typer.Option(min=0.0, help="stop after this many seconds")] = None,
) -> None:
    """Pass datagrams between PC and PLC, and drop, duplicate, delay or corrupt some; Ctrl-C prints the counts."""
    from sim_plc.relay.faults import Faults, FaultSettingsError
    from sim_plc.relay.relay_process import run_relay
    from sim_plc.relay.settings import RelaySettings

    console = Console(stderr=True)
    cut, freeze = _fault_windows(cut_after_s, cut_for_s), _fault_windows(freeze_after_s, freeze_for_s)
    try:
        shares = Faults(
            loss_frac=loss_pct / 100.0,
            burst_frac=burst_pct / 100.0,
            burst_length=burst_length,
            duplicate_frac=duplicate_pct / 100.0,
            reorder_frac=reorder_pct / 100.0,
            reorder_ms=reorder_ms,
            delay_ms=delay_ms,
            jitter_ms=jitter_ms,
            corrupt_frac=corrupt_pct / 100.0,
            truncate_frac=truncate_pct / 100.0,
            replay_frac=replay_pct / 100.0,
        )
        to_plc, to_pc = _faults_by_direction(shares, direction, cut, cut_direction, freeze, freeze_direction)
        settings = RelaySettings(plc_host, plc_port, listen_host, listen_port, seed, to_plc, to_pc)
        figures = run_relay(
            settings,
            lambda at: console.print(f"relay: PC side udp {at[0]}:{at[1]}, PLC udp {plc_host}:{plc_port}, seed {seed}"),
            for_s,
        )
    except FaultSettingsError as error:
        raise SettingsError(str(error)) from error
    console.print(table_of(figures))


def table_of(figures: RelayFigures) -> Table:
    """The figures of both directions, one class a row."""
    table = Table(
        title=f"relayed for {figures.n_pcs} PC address{'' if figures.n_pcs == 1 else 'es'}", title_justify="left"
    )
    for heading in ("datagrams", "to the PLC", "to the PC"):
        table.add_column(heading, justify="left" if heading == "datagrams" else "right")
    for field in fields(figures.to_plc):
        table.add_row(field.name, str(getattr(figures.to_plc, field.name)), str(getattr(figures.to_pc, field.name)))
    return table


def _fault_windows(after_s: float | None, for_s: float | None) -> Windows:
    if after_s is None:
        return ()
    return ((after_s, after_s + (_FOR_GOOD_S if for_s is None else for_s)),)


def _faults_by_direction(
    shares: Faults, direction: str, cut: Windows, cut_direction: str, freeze: Windows, freeze_direction: str
) -> tuple[Faults, Faults]:
    """Each kind of fault on its own way."""
    from sim_plc.relay.faults import Faults
    from sim_plc.relay.settings import by_direction

    to_plc, to_pc = (
        replace(share, cut_windows_s=cuts.cut_windows_s, freeze_windows_s=freezes.freeze_windows_s)
        for share, cuts, freezes in zip(
            by_direction(shares, direction),
            by_direction(Faults(cut_windows_s=cut), cut_direction),
            by_direction(Faults(freeze_windows_s=freeze), freeze_direction),
            strict=True,
        )
    )
    return to_plc, to_pc
