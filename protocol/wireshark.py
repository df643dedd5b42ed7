"""A Wireshark dissector in Lua for the payload, from the layout table: raw on two UDP ports, and behind TwinCAT NV."""

from enum import IntEnum, IntFlag

from protocol import codes, layout
from protocol.layout import Block, Field
from protocol.twincat.parameters import RAW_PC_PORT, RAW_PLC_PORT

_LUA_TYPES = {
    "USINT": "uint8",
    "UINT": "uint16",
    "UDINT": "uint32",
    "ULINT": "uint64",
    "REAL": "float",
    "LREAL": "double",
}
_VALUES: dict[str, type[IntEnum]] = {
    "msg_type": codes.MessageType,
    "mode": codes.Mode,
    "mode_active": codes.Mode,
    "plc_state": codes.PlcState,
    "link_state": codes.LinkState,
    "interp": codes.Interp,
    "reject_code": codes.RejectCode,
}
_FLAGS: dict[str, type[IntFlag]] = {
    "flags": codes.HeaderFlag,
    "cmd_flags": codes.CommandFlag,
    "fault_bits": codes.FaultBit,
    "warn_bits": codes.WarnBit,
    "axis_status": codes.AxisBit,
}
_HEX = {"magic", "layout_id", "session", "arm_nonce", "nonce", "cfg_id", "crc", "axis_mask", *_FLAGS}
_WHOLE = {"auth_tag"}  # bytes, shown as one


def lua_dissector() -> str:
    """The text of hmlink.lua."""
    blocks = (
        layout.HEADER_LAYOUT,
        layout.COMMAND_BODY_LAYOUT,
        layout.KNOT_LAYOUT,
        layout.COMMAND_TAIL_LAYOUT,
        layout.STATE_BODY_LAYOUT,
    )
    fields = {_field_key(block, field): field for block in reversed(blocks) for field in reversed(block.fields)}
    proto_fields = [_proto_field(key, field) for key, field in reversed(fields.items())]
    places = {
        "@NAMES@": "\n".join(
            f"local {_name_table(kind)} = {_lua_enum_table(kind)}" for kind in dict.fromkeys(_VALUES.values())
        ),
        "@FIELDS@": "\n".join((*proto_fields, *(_flag_fields(name, fields[name]) for name in _FLAGS))),
        "@TABLES@": "\n".join(_lua_field_table(block) for block in blocks),
        "@SIZES@": _lua_constants(),
        "@VERSION@": f"{layout.VERSION_MAJOR}.{layout.VERSION_MINOR}",
    }
    text = _TEMPLATE
    for place, value in places.items():
        text = text.replace(place, value)
    return text


def _lua_constants() -> str:
    numbers = (
        ("CMD_MAGIC", f"{layout.COMMAND_MAGIC:#x}"),
        ("STATE_MAGIC", f"{layout.STATE_MAGIC:#x}"),
        ("LAYOUT_ID", f"{layout.LAYOUT_ID:#x}"),
        ("VERSION_MAJOR", layout.VERSION_MAJOR),
        ("HEADER_SIZE", layout.HEADER_SIZE),
        ("CMD_SIZE", layout.COMMAND_SIZE),
        ("STATE_SIZE", layout.STATE_SIZE),
        ("KNOTS_OFFSET", layout.KNOTS_OFFSET),
        ("KNOT_SIZE", layout.KNOT_SIZE),
        ("KNOTS", layout.KNOTS_PER_COMMAND),
        ("PLC_PORT", RAW_PLC_PORT),
        ("PC_PORT", RAW_PC_PORT),
        *(
            (f"OFS_{f.name.upper()}", f.offset)
            for f in (*layout.HEADER_LAYOUT.fields, *layout.COMMAND_BODY_LAYOUT.fields)
        ),
        *((f"STATE_{f.name.upper()}", f.offset) for f in layout.STATE_BODY_LAYOUT.fields if f.name in _IN_STATE),
    )
    return "\n".join(f"local {name} = {value}" for name, value in numbers)


_IN_STATE = {"ack_seq", "plc_state", "reject_code", "reject_seq", "reject_offset"}


def _field_key(block: Block, field: Field) -> str:
    return f"knot.{field.name}" if block is layout.KNOT_LAYOUT else field.name


def _name_table(kind: type[IntEnum]) -> str:
    return f"names_{kind.__name__}"


def _lua_enum_table(kind: type[IntEnum]) -> str:
    return "{ " + ", ".join(f'[{member.value}] = "{member.name}"' for member in kind) + " }"


def _proto_field(key: str, field: Field) -> str:
    kind = "bytes" if field.name in _WHOLE else _LUA_TYPES[field.iec_type]
    extra = ""
    if field.name in _VALUES:
        extra = f", base.DEC, {_name_table(_VALUES[field.name])}"
    elif field.name in _HEX:
        extra = ", base.HEX"
    return f'f["{key}"] = ProtoField.{kind}("hmlink.{key}", "{field.name}"{extra})'


def _flag_fields(name: str, field: Field) -> str:
    """One boolean a bit, such as hmlink.fault_bits.estop; every bit with a name lies in the first 4 bytes."""
    width = min(4, field.size // field.array_length)
    rows = [
        f'  ProtoField.bool("hmlink.{name}.{str(bit.name).lower()}", "{bit.name}", {8 * width}, nil, {int(bit):#x}),'
        for bit in _FLAGS[name]
    ]
    return f'flags["{name}"] = {{ width = {width},\n' + "\n".join(rows) + "\n}"


def _lua_field_table(block: Block) -> str:
    rows = []
    for field in block.fields:
        count = 1 if field.name in _WHOLE else field.array_length
        rows.append(f'  {{ "{_field_key(block, field)}", {field.offset}, {field.size // count}, {count} }},')
    return f"local {block.name.replace(' ', '_')}_fields = {{\n" + "\n".join(rows) + "\n}"


_TEMPLATE = """\
-- HMLINK @VERSION@: payload of the PLC link. Generated from the layout table: do not edit.
-- Raw framing: two UDP ports, set in the preferences of HMLINK. EAP framing: below Wireshark's own TwinCAT NV.
-- Use: copy into the personal Lua plugin folder (Help > About > Folders), or  tshark -X lua_script:hmlink.lua
-- Filters: hmlink.seq == 27, hmlink.mode == 3, hmlink.fault_bits.lag == 1, hmlink.crc_good == 0

local hmlink = Proto("hmlink", "HMLINK @VERSION@")
local f, flags = {}, {}

@SIZES@

@NAMES@

@FIELDS@
f["crc_good"] = ProtoField.bool("hmlink.crc_good", "crc good")
f["reject_field"] = ProtoField.string("hmlink.reject_field", "refused field")
f["knot"] = ProtoField.uint32("hmlink.knot", "knot")
do
  local list = {}
  for _, field in pairs(f) do list[#list + 1] = field end
  for _, group in pairs(flags) do
    for _, field in ipairs(group) do list[#list + 1] = field end
  end
  hmlink.fields = list
end

local group, severity = expert.group, expert.severity
local bad_crc = ProtoExpert.new("hmlink.bad_crc", "CRC-32 is wrong", group.CHECKSUM, severity.ERROR)
local bad_size = ProtoExpert.new("hmlink.bad_size", "not the size of this message", group.PROTOCOL, severity.ERROR)
local other_layout = ProtoExpert.new("hmlink.other_layout",
  "another layout or major version: the fields shown may be wrong", group.PROTOCOL, severity.WARN)
hmlink.experts = { bad_crc, bad_size, other_layout }

-- key, offset, size of one element, number of elements
@TABLES@

-- Wireshark's own library "bit": every version has it, whatever Lua it is built with. Its results may be negative.
local band, bxor, rshift = bit.band, bit.bxor, bit.rshift

local crc_table = {}
for i = 0, 255 do
  local c = i
  for _ = 1, 8 do
    if band(c, 1) == 1 then c = bxor(rshift(c, 1), 0xEDB88320) else c = rshift(c, 1) end
  end
  crc_table[i] = c
end

local function crc32(bytes)
  local c = 0xFFFFFFFF
  for i = 0, bytes:len() - 1 do
    c = bxor(rshift(c, 8), crc_table[band(bxor(c, bytes:get_index(i)), 0xFF)])
  end
  return bxor(c, 0xFFFFFFFF) % 4294967296
end

local function add_flags(item, range, group)
  for _, field in ipairs(group) do item:add_le(field, range(0, group.width)) end
end

local function add_element(tree, key, range, index)
  local item
  if key == "auth_tag" then item = tree:add(f[key], range) else item = tree:add_le(f[key], range) end
  if index then item.text = string.gsub(item.text, "^[%w_]+", "%0[" .. index .. "]", 1) end
  if flags[key] then add_flags(item, range, flags[key]) end
end

local function add_fields(tree, buffer, fields, base_offset)
  for _, row in ipairs(fields) do
    local key, offset, size, count = row[1], base_offset + row[2], row[3], row[4]
    for i = 0, count - 1 do
      add_element(tree, key, buffer(offset + size * i, size), count > 1 and i or nil)
    end
  end
end

local function covers(row, offset)
  return offset >= row[2] and offset < row[2] + row[3] * row[4]
end

-- name of the command's field that covers a byte
local function field_at(offset)
  if offset >= KNOTS_OFFSET and offset < KNOTS_OFFSET + KNOTS * KNOT_SIZE then
    local k = math.floor((offset - KNOTS_OFFSET) / KNOT_SIZE)
    local within = (offset - KNOTS_OFFSET) % KNOT_SIZE
    for _, row in ipairs(knot_fields) do
      if covers(row, within) then
        local name = string.format("knot[%d].%s", k, row[1]:sub(6))
        if row[4] == 1 then return name end
        return string.format("%s[%d]", name, math.floor((within - row[2]) / row[3]))
      end
    end
  end
  for _, fields in ipairs({ header_fields, command_fields, command_tail_fields }) do
    for _, row in ipairs(fields) do
      if covers(row, offset) then return row[1] end
    end
  end
  return "none"
end

local function add_crc(tree, buffer, size)
  local good = crc32(buffer(0, size - 4):bytes()) == buffer(size - 4, 4):le_uint()
  tree:add(f["crc_good"], buffer(size - 4, 4), good)
  if not good then tree:add_proto_expert_info(bad_crc) end
end

local function add_knot(tree, buffer, k, index)
  local at = KNOTS_OFFSET + k * KNOT_SIZE
  local knot = tree:add(f["knot"], buffer(at, KNOT_SIZE), index)
  knot:append_text(" at " .. tostring(buffer(at, 8):le_uint64()) .. " ns")
  add_fields(knot, buffer, knot_fields, at)
end

-- each returns what the packet list says of the message
local function add_command(tree, buffer)
  add_fields(tree, buffer, command_fields, 0)
  local first, count = buffer(OFS_KNOT_FIRST, 4):le_uint(), math.min(buffer(OFS_KNOT_COUNT, 1):uint(), KNOTS)
  for k = 0, count - 1 do add_knot(tree, buffer, k, (first + k) % 4294967296) end
  add_fields(tree, buffer, command_tail_fields, 0)
  add_crc(tree, buffer, CMD_SIZE)
  local text = " " .. (names_Mode[buffer(OFS_MODE, 2):le_uint()] or "mode?")
  if count > 0 then
    local trajectory = buffer(OFS_TRAJ_ID, 4):le_uint()
    text = string.format("%s traj %.0f knots %.0f..%.0f", text, trajectory, first, first + count - 1)
  end
  return text
end

local function add_state(tree, buffer)
  add_fields(tree, buffer, state_fields, 0)
  local offset = buffer(STATE_REJECT_OFFSET, 4):le_uint()
  if offset > 0 then tree:add(f["reject_field"], buffer(STATE_REJECT_OFFSET, 4), field_at(offset)) end
  add_crc(tree, buffer, STATE_SIZE)
  local name = names_PlcState[buffer(STATE_PLC_STATE, 1):uint()] or "state?"
  local text = string.format(" %s ack %.0f", name, buffer(STATE_ACK_SEQ, 4):le_uint())
  local code = buffer(STATE_REJECT_CODE, 2):le_uint()
  if code > 0 then
    local refused = buffer(STATE_REJECT_SEQ, 4):le_uint()
    text = string.format("%s refused %.0f: %s", text, refused, names_RejectCode[code] or code)
    if offset > 0 then text = text .. " at " .. field_at(offset) end
  end
  return text
end

local function add_body(tree, buffer, is_command)
  if buffer:len() ~= (is_command and CMD_SIZE or STATE_SIZE) then
    tree:add_proto_expert_info(bad_size)
    return " of " .. buffer:len() .. " bytes"
  end
  if buffer(OFS_LAYOUT_ID, 4):le_uint() ~= LAYOUT_ID or buffer(OFS_VER_MAJOR, 1):uint() ~= VERSION_MAJOR then
    tree:add_proto_expert_info(other_layout)
  end
  if is_command then return add_command(tree, buffer) end
  return add_state(tree, buffer)
end

-- whether the buffer is one of ours; its tree is added
local function dissect(buffer, pinfo, root)
  if buffer:len() < HEADER_SIZE then return false end
  local magic = buffer(OFS_MAGIC, 4):le_uint()
  if magic ~= CMD_MAGIC and magic ~= STATE_MAGIC then return false end
  local tree = root:add(hmlink, buffer())
  add_fields(tree, buffer, header_fields, 0)
  local kind = names_MessageType[buffer(OFS_MSG_TYPE, 1):uint()] or "message?"
  local text = add_body(tree, buffer, magic == CMD_MAGIC)
  pinfo.cols.info:set(string.format("HMLINK %s seq %.0f%s", kind, buffer(OFS_SEQ, 4):le_uint(), text))
  return true
end

-- raw framing; anything else on these ports is left to others
function hmlink.dissector(buffer, pinfo, root)
  if not dissect(buffer, pinfo, root) then return 0 end
  pinfo.cols.protocol = "HMLINK"
  return buffer:len()
end

hmlink.prefs.port_plc = Pref.uint("UDP port of the PLC", PLC_PORT, "raw framing; 0: none")
hmlink.prefs.port_pc = Pref.uint("UDP port of the PC", PC_PORT, "raw framing; 0: none")
local ports = {}
local function register()
  local udp = DissectorTable.get("udp.port")
  for _, port in ipairs(ports) do udp:remove(port, hmlink) end
  ports = {}
  for _, port in ipairs({ hmlink.prefs.port_plc, hmlink.prefs.port_pc }) do
    if port > 0 then
      udp:add(port, hmlink)
      ports[#ports + 1] = port
    end
  end
end
function hmlink.prefs_changed() register() end
register()

-- EAP framing: Wireshark's own dissector has run; the data of its variables are ours
local known, nv_data = pcall(Field.new, "tc_nv.data")
if known then
  local behind = Proto("hmlink_eap", "HMLINK in TwinCAT NV")
  function behind.dissector(_, pinfo, root)
    for _, info in ipairs({ nv_data() }) do
      if info.len > 0 then dissect(info.range:tvb(), pinfo, root) end
    end
  end
  register_postdissector(behind)
end
"""
