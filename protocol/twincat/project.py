"""The TwinCAT files of one machine, as a table from path to bytes; the same input gives the same bytes."""

from collections.abc import Mapping

from protocol.errors import LocalProtocolError
from protocol.twincat.dut import duts
from protocol.twincat.enums import enums
from protocol.twincat.gvl import gvls
from protocol.twincat.parameters import PlcParameters
from protocol.twincat.pou import Pou, parse_pou
from protocol.twincat.tc_xml import dut_xml, gvl_xml, pou_xml
from protocol.twincat.transitions import next_state_source


def project(parameters: PlcParameters, sources: Mapping[str, str]) -> dict[str, bytes]:
    """Every file of the PLC program: DUTs/, GVLs/, POUs/.

    Args:    sources: the hand-written blocks, file name to text.
    Raises: LocalProtocolError: a source that is not a POU, or not named like its file.
    """
    files = {f"DUTs/{dut.name}.TcDUT": dut_xml(dut.name, dut.text) for dut in (*duts(), *enums())}
    files |= {f"GVLs/{gvl.name}.TcGVL": gvl_xml(gvl.name, gvl.text) for gvl in gvls(parameters)}
    pous = [parse_pou(next_state_source()), *(_named(name, text) for name, text in sources.items())]
    files |= {f"POUs/{pou.name}.TcPOU": pou_xml(pou) for pou in pous}
    return {path: files[path].encode("utf-8") for path in sorted(files)}


def _named(file_name: str, text: str) -> Pou:
    pou = parse_pou(text)
    if file_name.removesuffix(".st") != pou.name:
        raise LocalProtocolError(f"ST source {file_name} holds {pou.name}; name the file {pou.name}.st")
    return pou
