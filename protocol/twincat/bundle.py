"""Everything that a PLC engineer gets, as a table from path to bytes; the same input gives the same bytes."""

import hashlib
from collections.abc import Mapping

from protocol import layout
from protocol.c_header import c_header
from protocol.limits import cfg_id
from protocol.twincat import documents, guides
from protocol.twincat.golden import golden_pcap
from protocol.twincat.golden_pages import golden_json, golden_page
from protocol.twincat.parameters import PlcParameters
from protocol.twincat.project import project
from protocol.wireshark import lua_dissector

MANIFEST = "MANIFEST.txt"


def bundle(parameters: PlcParameters, sources: Mapping[str, str]) -> dict[str, bytes]:
    """All files; `sources` are the hand-written blocks, file name to text.

    Raises: LocalProtocolError: a source that is not a POU.
    """
    texts = {
        "README.md": guides.start_page(parameters),
        "docs/commissioning.md": guides.commissioning_page(parameters),
        "docs/import.md": guides.import_page(),
        "docs/offsets.md": documents.offsets_page(),
        "docs/reject-codes.md": documents.rejects_page(),
        "docs/states.md": documents.states_page(),
        "docs/timeouts.md": documents.timeouts_page(),
        "eap/configuration-sheet.md": documents.eap_sheet(parameters),
        "vectors/conversation.md": golden_page(parameters),
        "vectors/conversation.json": golden_json(parameters),
        "wireshark/hmlink.lua": lua_dissector(),
        "c/hmlink.h": c_header(),
    }
    files = {path: text.encode("utf-8") for path, text in texts.items()}
    files["vectors/eap.pcap"] = golden_pcap(parameters, eap=True)
    files["vectors/raw.pcap"] = golden_pcap(parameters, eap=False)
    files |= {f"twincat/{path}": data for path, data in project(parameters, sources).items()}
    files = {path: files[path] for path in sorted(files)}
    return {**files, MANIFEST: _manifest(parameters, files)}


def _manifest(parameters: PlcParameters, files: Mapping[str, bytes]) -> bytes:
    """As sha256sum reads it; the first line is a comment to it."""
    head = (
        f"# HMLINK {documents.VERSION} for {parameters.machine}: layout_id {layout.LAYOUT_ID:#010x}, "
        f"cfg_id {cfg_id(parameters.table):#010x}\n"
    )
    return (head + "".join(f"{hashlib.sha256(data).hexdigest()}  {path}\n" for path, data in files.items())).encode()
