
-- Fields. docs/wireshark.md describes them.

local bcap = Proto("bcap", "DENSO b-CAP")
local rac = Proto("rac", "DENSO RAC")

local function names_of(table_of)
    local names = {}
    for number, row in pairs(table_of) do
        names[number] = row.name
    end
    return names
end

local type_names = {}
for number, row in pairs(TYPES) do
    type_names[number] = "VT_" .. row.name
    type_names[number + ARRAY] = "VT_ARRAY|VT_" .. row.name
end

local f = {
    length = ProtoField.uint32("bcap.length", "Length"),
    serial = ProtoField.uint16("bcap.serial", "Serial number"),
    reserved = ProtoField.uint16("bcap.reserved", "Reserved (serial number of the first attempt)"),
    fn = ProtoField.uint32("bcap.function", "Function", base.DEC, names_of(FUNCTIONS)),
    hresult = ProtoField.uint32("bcap.hresult", "HRESULT", base.HEX, names_of(RESULTS)),
    meaning = ProtoField.string("bcap.hresult.meaning", "Meaning"),
    hint = ProtoField.string("bcap.hresult.hint", "To do"),
    count = ProtoField.uint16("bcap.arguments", "Number of arguments"),
    argument = ProtoField.string("bcap.argument", "Argument"),
    argument_length = ProtoField.uint32("bcap.argument.length", "Length of the argument"),
    call = ProtoField.string("bcap.call", "Called function"),
    command = ProtoField.string("bcap.command", "Command"),
    handle = ProtoField.int32("bcap.handle", "Handle"),
    object = ProtoField.string("bcap.object", "Object"),
    value = ProtoField.string("bcap.value", "Value"),
    vartype = ProtoField.uint16("bcap.value.type", "Type", base.DEC, type_names),
    elements = ProtoField.uint32("bcap.value.count", "Count"),
    int = ProtoField.int64("bcap.value.int", "Integer"),
    uint = ProtoField.uint64("bcap.value.uint", "Unsigned integer"),
    float = ProtoField.double("bcap.value.float", "Float"),
    date = ProtoField.double("bcap.value.date", "Date (days since 1899-12-30)"),
    bool = ProtoField.bool("bcap.value.bool", "Boolean"),
    string = ProtoField.string("bcap.value.string", "String"),
    error = ProtoField.uint32("bcap.value.error", "HRESULT", base.HEX, names_of(RESULTS)),
    request = ProtoField.bool("bcap.request", "Request"),
    response = ProtoField.bool("bcap.response", "Response"),
    executing = ProtoField.bool("bcap.executing", "Still running (S_EXECUTING)"),
    retry = ProtoField.bool("bcap.retry", "Retry"),
    attempt = ProtoField.uint32("bcap.attempt", "Attempt"),
    first_in = ProtoField.framenum("bcap.first_in", "First attempt in", base.NONE, frametype.RETRANS_PREV),
    request_in = ProtoField.framenum("bcap.request_in", "Request in", base.NONE, frametype.REQUEST),
    response_in = ProtoField.framenum("bcap.response_in", "Response in", base.NONE, frametype.RESPONSE),
    time = ProtoField.relative_time("bcap.time", "Time since the first attempt"),
    slave_mode = ProtoField.uint16("bcap.slave.mode", "Slave Mode", base.HEX),
    slave_send = ProtoField.uint16("bcap.slave.send_format", "Send format", base.HEX),
    slave_receive = ProtoField.uint16("bcap.slave.receive_format", "Receive format", base.HEX),
    skipped = ProtoField.bytes("bcap.skipped", "Bytes outside of a frame"),
    eot = ProtoField.uint8("bcap.eot", "EOT", base.HEX),
}

local r = {
    request = ProtoField.string("rac.request", "Request"),
    response = ProtoField.string("rac.response", "Response"),
    verb = ProtoField.string("rac.verb", "Verb"),
    variable = ProtoField.string("rac.variable", "Variable"),
    hresult = ProtoField.uint32("rac.hresult", "HRESULT", base.HEX, names_of(RESULTS)),
    meaning = ProtoField.string("rac.hresult.meaning", "Meaning"),
    hint = ProtoField.string("rac.hresult.hint", "To do"),
    vartype = ProtoField.uint16("rac.value.type", "Type", base.DEC, type_names),
    value = ProtoField.string("rac.value", "Value"),
    element = ProtoField.string("rac.value.element", "Element"),
    request_in = ProtoField.framenum("rac.request_in", "Request in", base.NONE, frametype.REQUEST),
    response_in = ProtoField.framenum("rac.response_in", "Response in", base.NONE, frametype.RESPONSE),
    time = ProtoField.relative_time("rac.time", "Time since the request"),
}

local e = {
    malformed = ProtoExpert.new("bcap.malformed", "Malformed frame", expert.group.MALFORMED, expert.severity.ERROR),
    cut = ProtoExpert.new("bcap.cut", "The capture has only a part of this frame", expert.group.UNDECODED,
        expert.severity.NOTE),
    refused = ProtoExpert.new("bcap.refused", "The call failed", expert.group.RESPONSE_CODE, expert.severity.WARN),
    full = ProtoExpert.new("bcap.success", "A success other than S_OK", expert.group.RESPONSE_CODE,
        expert.severity.CHAT),
    executing = ProtoExpert.new("bcap.still_executing", "The call is still running", expert.group.RESPONSE_CODE,
        expert.severity.CHAT),
    retry = ProtoExpert.new("bcap.retried", "Another attempt of an earlier request", expert.group.SEQUENCE,
        expert.severity.NOTE),
    unlinked = ProtoExpert.new("bcap.unlinked", "A response without a request in this capture", expert.group.SEQUENCE,
        expert.severity.NOTE),
    again = ProtoExpert.new("bcap.again", "Another response to a request", expert.group.SEQUENCE,
        expert.severity.NOTE),
    unknown = ProtoExpert.new("bcap.unknown_function", "No function has this number", expert.group.PROTOCOL,
        expert.severity.WARN),
    arguments = ProtoExpert.new("bcap.argument_count", "The number of arguments differs from the function's",
        expert.group.PROTOCOL, expert.severity.WARN),
}

local re = {
    malformed = ProtoExpert.new("rac.malformed", "Malformed line", expert.group.MALFORMED, expert.severity.ERROR),
    refused = ProtoExpert.new("rac.refused", "The request failed", expert.group.RESPONSE_CODE, expert.severity.WARN),
    unlinked = ProtoExpert.new("rac.unlinked", "A response without a request in this capture", expert.group.SEQUENCE,
        expert.severity.NOTE),
}

local function list(table_of)
    local found = {}
    for _, item in pairs(table_of) do
        found[#found + 1] = item
    end
    return found
end

bcap.fields, rac.fields = list(f), list(r)
bcap.experts, rac.experts = list(e), list(re)

local tcp_stream = Field.new("tcp.stream")
local udp_stream = Field.new("udp.stream")

-- Limits of what is shown. Every loop is also bounded by the bytes of its frame.
local MOST_ELEMENTS = 256 -- elements of an array
local MOST_ITEMS = 4096 -- items of a frame's tree
local MOST_VALUES = 20000 -- values of a frame that are examined
local LONGEST_TEXT = 160 -- bytes of a value in a line
local LONGEST_LABEL = 230 -- bytes of a line of the tree; Wireshark cuts at 239, also inside a character

-- Conversations, and what the first pass found for each frame. Later passes only look up.
local conversations, found = {}, {}

function bcap.init()
    conversations, found = {}, {}
end

local function conversation(pinfo, protocol)
    local stream, transport = udp_stream(), "udp"
    if pinfo.port_type ~= 3 then
        stream, transport = tcp_stream(), "tcp"
    end
    local key = protocol .. transport .. (stream and tostring(stream.value) or "")
    if not conversations[key] then
        conversations[key] = { lossy = transport == "udp", calls = {}, firsts = {}, objects = {}, slave = {}, queue = {} }
    end
    return conversations[key]
end

local function address(host, port)
    return tostring(host) .. " " .. tostring(port)
end

-- Whether a packet goes to the server. Without a known port the first frame of the conversation decides.
local function to_server(conv, pinfo, port, looks_like_request)
    if pinfo.dst_port == port and pinfo.src_port ~= port then
        return true
    elseif pinfo.src_port == port and pinfo.dst_port ~= port then
        return false
    end
    local from, to = address(pinfo.src, pinfo.src_port), address(pinfo.dst, pinfo.dst_port)
    if not conv.client then
        conv.client = looks_like_request and from or to
    end
    return conv.client == from
end

-- Texts

-- Escapes quotes and what acts on a terminal: control characters, also those of Latin-1, and the block of UTF-8 with
-- the bidirectional controls.
local function escaped(text)
    local function hex(c)
        return c == '"' and '\\"' or c == "\\" and "\\\\" or (c:gsub(".", function(byte)
            return string.format("\\x%02x", byte:byte())
        end))
    end
    return (text:gsub("[\0-\31\127\"\\]", hex):gsub("\194[\128-\159]", hex):gsub("\226[\128\129][\128-\191]", hex))
end

local function is_utf8(text)
    local rest = text:gsub("[\194-\223][\128-\191]", " "):gsub("[\224-\239][\128-\191][\128-\191]", " ")
    return not rest:gsub("[\240-\244][\128-\191][\128-\191][\128-\191]", " "):find("[\128-\255]")
end

-- Text of a line, whose encoding nothing tells: bytes that are not UTF-8 are escaped.
local function line_text(bytes)
    return is_utf8(bytes) and bytes or (bytes:gsub("[\128-\255]", function(byte)
        return string.format("\\x%02x", byte:byte())
    end))
end

-- Cuts a text at a character, not inside its UTF-8.
local function cut(text, longest)
    local at = longest or LONGEST_TEXT
    if #text <= at then
        return text
    end
    while at > 1 and text:byte(at + 1) >= 0x80 and text:byte(at + 1) < 0xc0 do
        at = at - 1
    end
    return text:sub(1, at) .. "..."
end

local function label(text)
    return cut(text, LONGEST_LABEL)
end

local function result_row(code)
    if code >= 0xc1000000 and code < 0xc6000000 then
        -- an error of the controller with the reserved bit
        code = code - 0x40000000
    end
    local row = RESULTS[code]
    if row then
        return row.name, row.meaning, row.hint
    end
    for _, range in ipairs(RANGES) do
        local digit = code % 16
        local axis = not range.axis or (digit >= 1 and digit <= 8)
        if range.first <= code and code <= range.last and axis then
            return nil, range.meaning, range.hint
        end
    end
end

local function result_text(code)
    local name = result_row(code)
    return name or string.format("0x%08x", code)
end

local function number_text(value, digits)
    local text = string.format("%." .. digits .. "g", value)
    if digits == 15 and tonumber(text) ~= value then
        text = string.format("%.17g", value)
    end
    return text
end

-- The day and time of an OLE date. Its fraction counts forwards also before 1899-12-30.
local function date_text(days)
    if not (days > -657435 and days < 2958466) then
        return number_text(days, 15)
    end
    local day = days < 0 and math.ceil(days) or math.floor(days)
    -- rounded, but not to the next day
    local second = math.min(math.floor(math.abs(days - day) * 86400 + 0.5), 86399)
    -- days since 0000-03-01, in eras of 400 years
    local z = day - 25569 + 719468
    local era = math.floor(z / 146097)
    local of_era = z - era * 146097
    local year = math.floor((of_era - math.floor(of_era / 1460) + math.floor(of_era / 36524)
        - math.floor(of_era / 146096)) / 365)
    local of_year = of_era - (365 * year + math.floor(year / 4) - math.floor(year / 100))
    local month = math.floor((5 * of_year + 2) / 153)
    local dom = of_year - math.floor((153 * month + 2) / 5) + 1
    month = month < 10 and month + 3 or month - 9
    year = year + era * 400 + (month <= 2 and 1 or 0)
    return string.format("%04.0f/%02.0f/%02.0f %02.0f:%02.0f:%02.0f", year, month, dom, math.floor(second / 3600),
        math.floor(second / 60) % 60, second % 60)
end

-- Values: `parse` turns bytes into nodes, `add_node` shows a node as a tree.
--
-- A node has `at` and `next` (its bytes), `text`, `value` (a number or a string, if it is one), `field` (of a scalar),
-- `data` (where its data begin), and of an array `items`, the first MOST_ELEMENTS elements. A node with `bad` is not
-- complete: it says what is wrong. An array with `cut` has more elements than are examined, and ends where its argument does.

local unexamined -- how many more values of the frame are examined

local readers = {
    I2 = function(range) return "int", range:le_int() end,
    I4 = function(range) return "int", range:le_int() end,
    I8 = function(range) return "int", range:le_int64() end,
    CY = function(range) return "int", range:le_int64() end,
    UI1 = function(range) return "uint", range:le_uint() end,
    UI2 = function(range) return "uint", range:le_uint() end,
    UI4 = function(range) return "uint", range:le_uint() end,
    UI8 = function(range) return "uint", range:le_uint64() end,
    R4 = function(range) return "float", range:le_float() end,
    R8 = function(range) return "float", range:le_float() end,
    DATE = function(range) return "date", range:le_float() end,
    BOOL = function(range) return "bool", range:le_int() ~= 0 end,
    ERROR = function(range) return "error", range:le_uint() end,
}

local function reading(name, value)
    if name == "R4" then
        return number_text(value, 7)
    elseif name == "R8" then
        return number_text(value, 15)
    elseif name == "DATE" then
        return date_text(value)
    elseif name == "ERROR" then
        return result_text(value)
    end
    return tostring(value)
end

local parse -- defined below: a VARIANT contains others

local function bad(at, stop, message)
    return { at = at, next = stop, text = "?", bad = message }
end

local function parse_string(tvb, at, stop)
    if stop - at < 4 then
        return bad(at, stop, "the length of a string is cut off")
    end
    local bytes = tvb(at, 4):le_uint()
    if bytes > stop - at - 4 then
        return bad(at, stop, string.format("a string of %.0f bytes, but only %d bytes are left", bytes, stop - at - 4))
    end
    local shown = math.min(bytes - bytes % 2, 4096)
    local text = shown > 0 and tvb(at + 4, shown):le_ustring() or ""
    return { at = at, next = at + 4 + bytes, data = at + 4, field = "string", value = text,
        text = '"' .. cut(escaped(text)) .. '"' }
end

-- One element: the data of a value without its type and count.
local function parse_element(tvb, at, stop, kind, depth)
    if kind.name == "BSTR" then
        return parse_string(tvb, at, stop)
    elseif kind.name == "VARIANT" then
        return parse(tvb, at, stop, depth + 1)
    elseif kind.bytes == 0 then
        return { at = at, next = at, data = at, text = kind.name }
    elseif stop - at < kind.bytes then
        return bad(at, stop, "the data of a " .. kind.name .. " are cut off")
    end
    local field, value = readers[kind.name](tvb(at, kind.bytes))
    return { at = at, next = at + kind.bytes, data = at, field = field, value = value, text = reading(kind.name, value) }
end

-- The elements of an array. Elements of fixed length beyond the first ones are skipped at once.
local function parse_array(tvb, node, stop, kind, depth)
    local least = kind.name == "BSTR" and 4 or kind.name == "VARIANT" and 6 or kind.bytes
    if (least == 0 and node.count > MOST_EMPTY) or node.count * least > stop - node.data then
        node.bad = string.format("an array of %.0f %s does not fit the %d bytes that are left", node.count, kind.name,
            stop - node.data)
        node.next = stop
        return
    end
    local at, texts = node.data, {}
    for i = 1, node.count do
        if i > MOST_ELEMENTS and kind.bytes then
            at = node.data + node.count * kind.bytes
            break
        elseif unexamined == 0 then
            at, node.cut = stop, true
            break
        end
        unexamined = unexamined - 1
        local item = parse_element(tvb, at, stop, kind, depth)
        at = item.next
        if i <= MOST_ELEMENTS then
            node.items[i] = item
        end
        if i <= 20 then
            texts[i] = item.text
        end
        if item.bad or item.cut then
            node.bad, node.cut = item.bad, item.cut
            break
        end
    end
    if node.count > 20 then
        texts[#texts + 1] = string.format("... %.0f in all", node.count)
    end
    node.next = at
    node.text = kind.name .. "[" .. table.concat(texts, ", ") .. "]"
end

parse = function(tvb, at, stop, depth)
    if stop - at < 6 then
        return bad(at, stop, "type and count of a value are cut off")
    elseif depth > DEEPEST then
        return bad(at, stop, "VARIANTs are nested too deeply")
    end
    local vartype, count = tvb(at, 2):le_uint(), tvb(at + 2, 4):le_uint()
    local is_array = math.floor(vartype / ARRAY) % 2 == 1
    local kind = TYPES[is_array and vartype - ARRAY or vartype]
    if not kind then
        return bad(at, stop, string.format("no value has the type %d", vartype))
    end
    local node = { at = at, data = at + 6, next = at + 6, vartype = vartype, count = count, kind = kind.name,
        items = {}, text = kind.name .. "[]" }
    if is_array then
        node.is_array = true
        parse_array(tvb, node, stop, kind, depth)
        return node
    end
    local data = parse_element(tvb, at + 6, stop, kind, depth)
    node.next, node.field, node.value, node.bad, node.data = data.next, data.field, data.value, data.bad, data.data
    node.cut = data.cut
    if kind.name == "BSTR" or kind.bytes == 0 then
        node.text = data.text
    elseif kind.name == "VARIANT" then
        node.items[1], node.text = data, "VARIANT(" .. data.text .. ")"
    else
        node.text = kind.name .. "(" .. data.text .. ")"
    end
    return node
end

-- Adds the item of a scalar's data, with the field of its type.
local function add_scalar(ctx, tree, node, name, unit)
    if not node.field or node.next <= node.data then
        return
    end
    ctx.items = ctx.items - 1
    local range = ctx.tvb(node.data, node.next - node.data)
    local item
    if node.field == "int" or node.field == "uint" then
        -- Wireshark reads these itself: as numbers of Lua they would lose bits
        item = tree:add_le(f[node.field], range)
    else
        item = tree:add(f[node.field], range, node.value)
    end
    if name then
        item:set_text(name .. ": " .. reading(node.kind or ctx.kind, node.value) .. (unit and " " .. unit or ""))
    elseif node.kind == "DATE" or node.kind == "CY" then
        item:append_text(node.kind == "DATE" and " (" .. node.text .. ")" or " ten-thousandths")
    end
end

local add_node

local function add_elements(ctx, tree, node, labels)
    local kind = node.kind
    for i, item in ipairs(node.items) do
        if ctx.items <= 0 then
            break
        end
        local part = labels and labels[i]
        if item.vartype then
            add_node(ctx, tree, item, part and part.name or string.format("[%d]", i - 1), part and part.labels)
        elseif item.bad then
            break
        elseif item.field == "string" then
            ctx.items = ctx.items - 1
            tree:add(f.string, ctx.tvb(item.at, item.next - item.at), item.value)
                :set_text(label(string.format("[%d]: %s", i - 1, item.text)))
        else
            ctx.kind = kind
            add_scalar(ctx, tree, item, part and part.name or string.format("[%d]", i - 1), part and part.unit)
        end
    end
    if node.count > #node.items and node.is_array and not node.bad then
        local rest = node.cut and string.format(", of which not all are examined: the frame has more than %d values", MOST_VALUES)
        tree:add(ctx.tvb(node.at, 6), string.format("... %.0f elements in all%s", node.count, rest or ""))
    end
end

-- Adds a value: its type, its count and its data.
add_node = function(ctx, tree, node, name, labels)
    if ctx.items <= 0 or node.next <= node.at then
        return
    end
    ctx.items = ctx.items - 3
    local item = tree:add(f.value, ctx.tvb(node.at, node.next - node.at), node.text)
    item:set_text(label(name .. ": " .. cut(node.text)))
    if node.vartype then
        item:add_le(f.vartype, ctx.tvb(node.at, 2))
        item:add_le(f.elements, ctx.tvb(node.at + 2, 4))
        if node.is_array or node.kind == "VARIANT" then
            add_elements(ctx, item, node, labels)
        else
            add_scalar(ctx, item, node)
        end
    end
    return item
end

-- Poses

-- The labels of a pose, from the letters of its parts: "P", "PJ".
local function pose_labels(letters)
    local labels = {}
    for letter in letters:gmatch("%a") do
        for _, number in ipairs(POSES[letter] or {}) do
            labels[#labels + 1] = number
        end
    end
    return labels
end

-- The labels of a variable's value, from its name: P1, J[2], @CURRENT_POSITION.
local function variable_labels(name)
    local plain = name:match("([^/]*)$"):upper()
    local letters = SYSTEM_POSES[plain]
    if not letters then
        local kind = plain:match("^(%a+)%[?%d+%]?$")
        letters = kind and POSES[kind] and kind
    end
    return letters and pose_labels(letters)
end

-- The labels of a pose in Slave Mode. If the call that chose its type is not in the capture, its length tells it.
local function slave_pose_labels(letters, node)
    local pose = node.kind == "VARIANT" and node.items[1] or node
    for _, guess in ipairs(letters and {} or SLAVE.poses) do
        if #pose_labels(guess) == pose.count then
            letters = guess
        end
    end
    return letters and pose_labels(letters)
end

local function has(format, bit)
    return math.floor(format / bit) % 2 == 1
end

-- The parameter of slvMove, element by element.
local function sent_labels(slave, node)
    local mode = SLAVE.modes[slave.mode]
    local labels = { { name = "Pose", labels = slave_pose_labels(mode and mode.pose, node) } }
    local function add(name)
        labels[#labels + 1] = { name = name }
    end
    if has(slave.send, SLAVE.MINI) then
        add("MiniIO")
    elseif has(slave.send, SLAVE.USER) then
        add("User IO, first port")
        add("User IO, number of ports")
        add("User IO")
    end
    if has(slave.receive, SLAVE.USER) then
        add("User IO to receive, first port")
        add("User IO to receive, number of ports")
    end
    if has(slave.send, SLAVE.HAND) then
        add("HandIO")
    end
    return labels
end

-- The reply to slvMove, element by element.
local function received_labels(slave, node)
    local pose = { name = "Pose", labels = slave_pose_labels(SLAVE.poses[slave.receive % 16], node) }
    local labels = {}
    if has(slave.receive, SLAVE.TIME) then
        labels[#labels + 1] = { name = "Time stamp in " .. slave.unit }
    end
    labels[#labels + 1] = pose
    for _, part in ipairs({ { SLAVE.MINI, "MiniIO" }, { SLAVE.USER, "User IO" }, { SLAVE.HAND, "HandIO" },
        { SLAVE.CURRENT, "Motor current" } }) do
        if has(slave.receive, part[1]) then
            labels[#labels + 1] = { name = part[2] }
        end
    end
    return labels
end

-- A pose alone is an array of numbers; with other elements it is the first one of an array of VARIANT.
local function slave_labels(node, labels)
    if node.kind == "VARIANT" then
        return labels
    end
    for _, part in ipairs(labels) do
        if part.name == "Pose" then
            return part.labels
        end
    end
end

-- The destination of Robot_Move: an array of a pose, its type and the pass.
local function destination_labels(node)
    local kind = node.kind == "VARIANT" and node.is_array and node.items[2]
    local letters = kind and DESTINATIONS[kind.value]
    return letters and { { name = "Pose", labels = pose_labels(letters) }, { name = "Type of the pose" }, { name = "Pass" } }
end

-- Frames

-- The header at `at`, if the bytes there can begin a frame; otherwise nil and what is wrong.
local function length_of(raw, at)
    if raw:byte(at + 1) ~= SOH then
        return nil, "a frame begins with SOH (0x01)"
    elseif #raw < at + 5 then
        return 0
    end
    local a, b, c, d = raw:byte(at + 2, at + 5)
    local length = a + b * 256 + c * 65536 + d * 16777216
    if length < SHORTEST or length > LONGEST then
        return nil, string.format("the length %.0f is not between %d and %d", length, SHORTEST, LONGEST)
    end
    return length
end

local function parse_arguments(tvb, frame)
    local at, stop = HEADER, frame.length - 1
    for i = 1, frame.count do
        if stop - at < 4 then
            frame.bad = string.format("argument %d of %d is missing", i, frame.count)
            return
        end
        local bytes = tvb(at, 4):le_uint()
        if bytes > stop - at - 4 then
            frame.bad = string.format("argument %d has %.0f bytes, but only %d bytes are left", i, bytes, stop - at - 4)
            return
        end
        local node = bytes > 0 and parse(tvb, at + 4, at + 4 + bytes, 0) or bad(at + 4, at + 4, "an argument of 0 bytes")
        if not node.bad and node.next < at + 4 + bytes then
            node.bad = string.format("argument %d has %d bytes after its value", i, at + 4 + bytes - node.next)
        end
        frame.bad = frame.bad or node.bad
        -- only the first arguments are kept: no function has more
        if i <= MOST_ARGUMENTS then
            frame.arguments[i] = { at = at, bytes = bytes, node = node }
        end
        at = at + 4 + bytes
    end
    if at < stop and not frame.bad then
        frame.bad = string.format("%d unused bytes before EOT", stop - at)
    end
end

local function parse_frame(tvb)
    unexamined = MOST_VALUES
    local frame = { length = tvb:len(), serial = SERIAL(tvb):le_uint(), reserved = RESERVED(tvb):le_uint(),
        code = CODE(tvb):le_uint(), count = COUNT(tvb):le_uint(), arguments = {} }
    if tvb(frame.length - 1, 1):uint() ~= EOT then
        frame.bad = "the last byte is not EOT (0x04)"
    else
        parse_arguments(tvb, frame)
    end
    return frame
end

local function value_of(frame, i)
    local argument = frame.arguments[i]
    return argument and argument.node.value
end

-- Objects and calls: what the first pass records

-- The name of a handle: that of the object and of its owners, such as robot/@SERVO_ON.
local function object_name(conv, signature, frame, i)
    local kind = signature and signature.arguments[i] and signature.arguments[i].handle
    local handle = kind and value_of(frame, i)
    local object = type(handle) == "number" and conv.objects[handle]
    return object and object.name
end

-- The name of the object that a call opens.
local function opened_name(conv, signature, frame)
    local owner = object_name(conv, signature, frame, 1)
    local name
    for i, argument in ipairs(signature.arguments) do
        if argument.kind == "Text" and argument.name == "name" then
            name = value_of(frame, i)
        end
    end
    local kind = signature.opens:lower()
    if type(name) ~= "string" or name == "" then
        name = kind
    elseif signature.opens ~= "Variable" then
        name = kind .. ":" .. name
    end
    if owner and not owner:match("^controller") then
        name = owner .. "/" .. name
    end
    return cut(escaped(name))
end

local function slave_of(conv, handle)
    if not conv.slave[handle] then
        conv.slave[handle] = { mode = 0, send = 0, receive = 0, unit = "ms", seen = {} }
    end
    return conv.slave[handle]
end

-- Changes the formats of Slave Mode after a successful call.
local function follow_slave(conv, call)
    local slave, value = slave_of(conv, call.handle), call.parameter
    if call.command == "slvchangemode" and value then
        slave.mode, slave.seen.mode = value, true
    elseif call.command == "slvsendformat" and value then
        slave.send, slave.seen.send = value, true
    elseif call.command == "slvrecvformat" and value then
        slave.receive, slave.unit, slave.seen.receive = value, call.unit == 1 and "us" or "ms", true
    end
end

local function integer(value)
    return type(value) == "number" and value >= 0 and value <= 65535 and value or nil
end

local function new_call(conv, frame, pinfo)
    local signature = FUNCTIONS[frame.code]
    local call = { code = frame.code, serial = frame.serial, first = pinfo.number, began = pinfo.rel_ts, attempts = 1,
        signature = signature }
    if not signature then
        return call
    end
    call.handle = value_of(frame, 1)
    call.object = object_name(conv, signature, frame, 1)
    if signature.opens then
        call.opens = opened_name(conv, signature, frame)
    end
    if signature.name:match("_Execute$") and type(value_of(frame, 2)) == "string" then
        call.shown_command = cut(escaped(value_of(frame, 2)))
        call.command = value_of(frame, 2):lower()
        local parameter = frame.arguments[3] and frame.arguments[3].node
        local items = parameter and parameter.items or {}
        call.parameter = integer(parameter and (parameter.value or items[1] and items[1].value))
        call.unit = items[2] and items[2].value
    end
    return call
end

local function record_request(conv, frame, pinfo)
    local earlier = conv.lossy and conv.firsts[frame.reserved ~= 0 and frame.reserved or frame.serial]
    -- a lost reply is requested again, also after the capture has it
    local is_retry = frame.reserved ~= 0 and frame.reserved ~= frame.serial
    if earlier and earlier.code == frame.code and (is_retry or not earlier.closed) then
        earlier.attempts = earlier.attempts + 1
        conv.calls[frame.serial] = earlier
        return { call = earlier, attempt = earlier.attempts }
    end
    if conv.lossy and frame.code == START then
        conv.objects, conv.slave = {}, {}
    end
    local call = new_call(conv, frame, pinfo)
    conv.calls[frame.serial] = call
    conv.firsts[frame.reserved ~= 0 and frame.reserved or frame.serial] = call
    local names = {}
    for i in ipairs(frame.arguments) do
        names[i] = object_name(conv, call.signature, frame, i)
    end
    if call.command == "slvmove" and call.handle then
        local slave = slave_of(conv, call.handle)
        call.slave = { mode = slave.mode, send = slave.send, receive = slave.receive, unit = slave.unit,
            seen = { mode = slave.seen.mode, send = slave.seen.send, receive = slave.seen.receive } }
    end
    call.names = names
    return { call = call, attempt = 1 }
end

-- What a successful reply changes: an object opened or released, a format of Slave Mode.
local function follow_reply(conv, call, frame)
    local signature, handle = call.signature, value_of(frame, 1)
    if signature and signature.opens and type(handle) == "number" then
        conv.objects[handle] = { name = call.opens }
        call.opened = handle
    elseif signature and signature.releases and type(call.handle) == "number" then
        conv.objects[call.handle] = nil
    end
    if call.command and type(call.handle) == "number" then
        follow_slave(conv, call)
    end
end

local function record_response(conv, frame, pinfo)
    local call = conv.calls[frame.serial]
    if not call then
        return {}
    end
    local record = { call = call, since = pinfo.rel_ts - call.began, again = call.closed }
    if frame.code == EXECUTING then
        record.executing = true
    elseif not call.closed then
        call.closed, call.reply = true, pinfo.number
        if frame.code < 0x80000000 then
            follow_reply(conv, call, frame)
        end
    end
    return record
end

-- Trees

local function seconds(time)
    local whole = math.floor(time)
    return NSTime.new(whole, math.floor((time - whole) * 1e9 + 0.5))
end

local function generated(tree, field, value)
    local item = tree:add(field, value)
    item:set_generated()
    return item
end

local function argument_labels(record, i, node)
    local call = record.call
    if not call or not call.signature then
        return nil
    elseif call.slave and i == 3 then
        return slave_labels(node, sent_labels(call.slave, node))
    elseif call.code == MOVE and i == 3 then
        return destination_labels(node)
    elseif call.signature.value_at == i and call.object then
        return variable_labels(call.object)
    end
end

local function reply_labels(record, node)
    local call = record.call
    if not call or not call.signature then
        return nil
    elseif call.slave then
        return slave_labels(node, received_labels(call.slave, node))
    elseif call.command and COMMAND_POSES[call.command] then
        return pose_labels(COMMAND_POSES[call.command])
    elseif call.signature.reads_value and call.object then
        return variable_labels(call.object)
    end
end

local function add_arguments(ctx, tree, frame, record, is_request)
    local signature = is_request and record.call and record.call.signature
    for i, argument in ipairs(frame.arguments) do
        local node = argument.node
        local expected = signature and signature.arguments[i]
        local name = expected and expected.name or is_request and string.format("argument %d", i) or "value"
        local object = is_request and record.call and record.call.names and record.call.names[i]
        local text = name .. ": " .. cut(node.text) .. (object and " (" .. object .. ")" or "")
        local item = tree:add(f.argument, ctx.tvb(argument.at, argument.bytes + 4), node.text)
        item:set_text(label(text))
        item:add_le(f.argument_length, ctx.tvb(argument.at, 4))
        local labels
        if is_request then
            labels = argument_labels(record, i, node)
        elseif i == 1 then
            labels = reply_labels(record, node)
        end
        add_node(ctx, item, node, "Value", labels)
        if is_request and expected and expected.handle and type(node.value) == "number" and node.field == "int" then
            item:add_le(f.handle, ctx.tvb(node.data, 4)):set_generated()
            if object then
                generated(item, f.object, object)
            end
        end
    end
end

local function add_result(tree, tvb, frame)
    local item = tree:add_le(f.hresult, CODE(tvb))
    local name, meaning, hint = result_row(frame.code)
    if meaning then
        generated(item, f.meaning, meaning)
    end
    if hint and frame.code >= 0x80000000 then
        generated(item, f.hint, hint)
    end
    if frame.code >= 0x80000000 then
        item:add_proto_expert_info(e.refused, "The call failed: " .. result_text(frame.code)
            .. (meaning and ": " .. meaning or ""))
    elseif frame.code == EXECUTING then
        item:add_proto_expert_info(e.executing)
    elseif frame.code ~= 0 then
        item:add_proto_expert_info(e.full, (name or string.format("0x%08x", frame.code)) .. ": " .. (meaning or "success"))
    end
end

local function add_request_links(tree, frame, record)
    local call = record.call
    if record.attempt > 1 then
        generated(tree, f.retry, true):add_proto_expert_info(e.retry)
        generated(tree, f.attempt, record.attempt)
        generated(tree, f.first_in, call.first)
    end
    if call.shown_command then
        generated(tree, f.command, call.shown_command)
    end
    if call.slave then
        for _, part in ipairs({ "mode", "send", "receive" }) do
            if call.slave.seen[part] then
                generated(tree, f["slave_" .. part], call.slave[part])
            end
        end
    end
    if call.reply then
        generated(tree, f.response_in, call.reply)
    end
    local signature = call.signature
    if not signature then
        tree:add_proto_expert_info(e.unknown, string.format("No function has the number %.0f", frame.code))
    elseif frame.count ~= #signature.arguments and frame.code ~= START then
        tree:add_proto_expert_info(e.arguments,
            string.format("%s has %d arguments, not %d", signature.name, #signature.arguments, frame.count))
    end
end

local function add_response_links(tree, record)
    local call = record.call
    if not call then
        tree:add_proto_expert_info(e.unlinked)
        return
    end
    generated(tree, f.call, call.signature and call.signature.name or string.format("function %.0f", call.code))
    if call.shown_command then
        generated(tree, f.command, call.shown_command)
    end
    if call.object then
        generated(tree, f.object, call.object)
    end
    if call.opened then
        generated(tree, f.object, call.opens)
    end
    generated(tree, f.request_in, call.first)
    generated(tree, f.time, seconds(record.since))
    if call.attempts > 1 then
        generated(tree, f.attempt, call.attempts)
    end
    if record.executing then
        generated(tree, f.executing, true)
    elseif record.again then
        tree:add_proto_expert_info(e.again)
    end
end

-- Lines of the packet list

local function call_text(call)
    local name = call.signature and call.signature.name or string.format("function %.0f", call.code)
    return name .. (call.shown_command and " " .. call.shown_command or "")
end

local function request_text(frame, record)
    local call = record.call
    local arguments = {}
    for i, argument in ipairs(frame.arguments) do
        local object = call.names and call.names[i]
        if not (call.shown_command and i == 2) then
            arguments[#arguments + 1] = object or argument.node.text
        end
    end
    local retry = record.attempt > 1 and string.format(" [attempt %d]", record.attempt) or ""
    return string.format("-> #%d%s %s(%s)", frame.serial, retry, call_text(call), cut(table.concat(arguments, ", ")))
end

local function response_text(frame, record)
    local call = record.call and " " .. call_text(record.call) or ""
    local value = frame.arguments[1] and ": " .. cut(frame.arguments[1].node.text) or ""
    local opened = record.call and record.call.opened and frame.code == 0 and " = " .. record.call.opens or ""
    return string.format("<- #%d %s%s%s%s", frame.serial, result_text(frame.code), call, value, opened)
end

local function add_info(pinfo, ctx, text)
    if ctx.lines == 0 then
        pinfo.cols.info:set(text)
    elseif ctx.lines < 20 then
        pinfo.cols.info:append(" | " .. text)
    end
    ctx.lines = ctx.lines + 1
end

local function add_header(tree, tvb, frame, is_request)
    tree:add_le(f.length, LENGTH(tvb))
    tree:add_le(f.serial, SERIAL(tvb))
    tree:add_le(f.reserved, RESERVED(tvb))
    if is_request then
        tree:add_le(f.fn, CODE(tvb))
        generated(tree, f.request, true)
    else
        add_result(tree, tvb, frame)
        generated(tree, f.response, true)
    end
    tree:add_le(f.count, COUNT(tvb))
end

-- Shows one complete frame. The first pass also records what later frames need.
local function show_frame(tvb, pinfo, tree, conv, packet)
    local frame = parse_frame(tvb)
    local is_request = to_server(conv, pinfo, PORT, FUNCTIONS[frame.code] ~= nil)
    local key = string.format("%d:%d:%d", pinfo.number, tvb:offset(), frame.length)
    if not found[key] and not pinfo.visited then
        found[key] = is_request and record_request(conv, frame, pinfo) or record_response(conv, frame, pinfo)
    end
    local record = found[key] or (is_request and { call = new_call(conv, frame, pinfo), attempt = 1 } or {})
    local text = is_request and request_text(frame, record) or response_text(frame, record)
    add_info(pinfo, packet, text)

    local item = tree:add(bcap, tvb(), label("DENSO b-CAP, " .. text))
    local ctx = { tvb = tvb, items = MOST_ITEMS }
    add_header(item, tvb, frame, is_request)
    add_arguments(ctx, item, frame, record, is_request)
    item:add(f.eot, tvb(frame.length - 1, 1))
    if is_request then
        add_request_links(item, frame, record)
    else
        add_response_links(item, record)
    end
    if frame.bad then
        item:add_proto_expert_info(e.malformed, "Malformed frame: " .. frame.bad)
        pinfo.cols.info:append(" [malformed: " .. frame.bad .. "]")
    end
end

-- Shows bytes that belong to no frame.
local function show_skipped(tvb, pinfo, tree, packet, message)
    local item = tree:add(bcap, tvb(), "DENSO b-CAP, not a frame")
    item:add(f.skipped, tvb())
    item:add_proto_expert_info(e.malformed, "Malformed frame: " .. message)
    add_info(pinfo, packet, "[malformed: " .. message .. "]")
end

local function show_cut(tvb, pinfo, tree, packet)
    tree:add(bcap, tvb(), "DENSO b-CAP, a part of a frame"):add_proto_expert_info(e.cut)
    add_info(pinfo, packet, "[a part of a frame]")
end

-- Whether bytes can be a header, or the start of one: values contain many that only have SOH and a length.
local function is_plausible(raw, at)
    local length = length_of(raw, at)
    if not length or #raw < at + 15 then
        return length ~= nil
    end
    local a, b, c, d, low, high = raw:byte(at + 10, at + 15)
    local code, count = a + b * 256 + c * 65536 + d * 16777216, low + high * 256
    local is_known = FUNCTIONS[code] or result_row(code)
    return is_known and count <= MOST_ARGUMENTS and count * 10 <= length - SHORTEST and length < 1048576
end

-- The position of the next byte that can begin a frame, or the end of the bytes.
local function next_start(raw, at)
    local start = raw:find(string.char(SOH), at + 1, true)
    while start and not is_plausible(raw, start - 1) do
        start = raw:find(string.char(SOH), start + 1, true)
    end
    return start and start - 1 or #raw
end

-- Frames of a stream: several in a segment, or one over several segments.
local function dissect_stream(tvb, pinfo, tree, conv)
    local raw, at, packet = tvb:raw(0, tvb:len()), 0, { lines = 0 }
    local is_whole = tvb:reported_len() == tvb:len()
    while at < #raw do
        local length, message = length_of(raw, at)
        if not length then
            local start = next_start(raw, at + 1)
            show_skipped(tvb(at, start - at):tvb(), pinfo, tree, packet, message)
            at = start
        elseif length == 0 or length > #raw - at then
            if is_whole and pinfo.can_desegment > 0 then
                pinfo.desegment_offset = at
                pinfo.desegment_len = length == 0 and DESEGMENT_ONE_MORE_SEGMENT or length - (#raw - at)
            else
                show_cut(tvb(at):tvb(), pinfo, tree, packet)
            end
            return
        else
            show_frame(tvb(at, length):tvb(), pinfo, tree, conv, packet)
            at = at + length
        end
    end
end

-- A datagram is one frame.
local function dissect_datagram(tvb, pinfo, tree, conv)
    local raw, packet = tvb:raw(0, tvb:len()), { lines = 0 }
    local length, message = length_of(raw, 0)
    if length == 0 then
        length, message = nil, "the header is cut off"
    elseif length and length > tvb:reported_len() then
        length, message = nil, string.format("the length %.0f is over the datagram's %d bytes", length, tvb:reported_len())
    end
    if not length then
        show_skipped(tvb(), pinfo, tree, packet, message)
    elseif length > #raw then
        show_cut(tvb(), pinfo, tree, packet)
    else
        show_frame(tvb(0, length):tvb(), pinfo, tree, conv, packet)
        if length < #raw then
            show_skipped(tvb(length):tvb(), pinfo, tree, packet, "bytes after the frame")
        end
    end
end

function bcap.dissector(tvb, pinfo, tree)
    if tvb:len() == 0 then
        return 0
    end
    pinfo.cols.protocol:set("b-CAP")
    local conv = conversation(pinfo, "bcap")
    if conv.lossy then
        dissect_datagram(tvb, pinfo, tree, conv)
    else
        dissect_stream(tvb, pinfo, tree, conv)
    end
    return tvb:len()
end

-- RAC: lines that end with CR

local function parse_result(word)
    local number = word:match("^[-+]?%d+$") and tonumber(word) or word:match("^0[xX]%x+$") and tonumber(word)
    if not number or number < -2147483648 or number > 4294967295 then
        return nil
    end
    return number < 0 and number + 4294967296 or number
end

-- Adds a value "TYPE,DATA". The numbers of a pose have their names and units.
local function add_text_value(tree, range, text, letters)
    local vartype, data = text:match("^%s*(%d+)%s*,(.*)$")
    local number = vartype and tonumber(vartype)
    if not number or number > 65535 then
        tree:add(r.value, range, text)
        return
    end
    tree:add(r.vartype, range, number)
    tree:add(r.value, range, data)
    local i, labels = 0, letters and POSES[letters]
    if labels and number >= ARRAY then
        for part in data:gmatch("[^,]+") do
            i = i + 1
            local known = labels[i] or {}
            tree:add(r.element, range, part):set_text(label((known.name or string.format("[%d]", i - 1)) .. ": "
                .. escaped(part) .. (known.unit and " " .. known.unit or "")))
        end
    end
end

local function show_request_line(item, range, line, record)
    item:add(r.request, range, line)
    local verb, part, index, kind, value = line:match("^%s*(%a+):([^:]*):%s*(%d+)%s*:%s*(%a+)%s*:(.*)$")
    if not verb then
        item:add_proto_expert_info(re.malformed, "Malformed line: a request is VERB:RC8:INDEX:KIND:")
        return
    end
    record.variable, record.kind = kind:upper() .. index, kind:upper()
    item:add(r.verb, range, verb:upper())
    item:add(r.variable, range, record.variable)
    if not RAC_KINDS[record.kind] or (part ~= "" and part:upper() ~= "RC8") then
        item:add_proto_expert_info(re.malformed, "Malformed line: unknown part or kind of variable")
    end
    if value:match("%S") then
        add_text_value(item, range, value, record.kind)
    end
    if record.reply then
        generated(item, r.response_in, record.reply)
    end
end

local function show_response_line(item, range, line, record)
    item:add(r.response, range, line)
    local word, rest = line:match("^%s*([^,%s]+)%s*(.*)$")
    local code = word and parse_result(word)
    if not code then
        item:add_proto_expert_info(re.malformed, "Malformed line: a response begins with a result code")
        return
    end
    local result = item:add(r.hresult, range, code)
    local _, meaning, hint = result_row(code)
    if meaning then
        generated(result, r.meaning, meaning)
    end
    if code >= 0x80000000 then
        if hint then
            generated(result, r.hint, hint)
        end
        result:add_proto_expert_info(re.refused, "The request failed: " .. result_text(code)
            .. (meaning and ": " .. meaning or ""))
    end
    local request = record.request
    if rest:sub(1, 1) == "," then
        add_text_value(item, range, rest:sub(2), request and request.kind)
    end
    if request then
        if request.variable then
            generated(item, r.variable, request.variable)
        end
        generated(item, r.request_in, request.frame)
        generated(item, r.time, seconds(record.since))
    else
        item:add_proto_expert_info(re.unlinked)
    end
end

local function record_line(conv, pinfo, is_request)
    if is_request then
        local record = { frame = pinfo.number, began = pinfo.rel_ts }
        conv.queue[#conv.queue + 1] = record
        return record
    end
    conv.answered = (conv.answered or 0) + 1
    local request = conv.queue[conv.answered]
    if not request then
        conv.answered = conv.answered - 1
        return {}
    end
    request.reply = pinfo.number
    return { request = request, since = pinfo.rel_ts - request.began }
end

local function show_line(tvb, pinfo, tree, conv, packet, line)
    local is_request = to_server(conv, pinfo, RAC_PORT, line:match("^%s*[GgPp][EeUu][Tt]:") ~= nil)
    local key = string.format("rac:%d:%d:%d", pinfo.number, tvb:offset(), tvb:len())
    if not found[key] and not pinfo.visited then
        found[key] = record_line(conv, pinfo, is_request)
    end
    local record = found[key] or {}
    local text = cut(escaped(line))
    add_info(pinfo, packet, (is_request and "-> " or "<- ") .. text)
    local item = tree:add(rac, tvb(), label("DENSO RAC, " .. (is_request and "request " or "response ") .. text))
    if is_request then
        show_request_line(item, tvb(), line, record)
    else
        show_response_line(item, tvb(), line, record)
    end
end

function rac.dissector(tvb, pinfo, tree)
    if tvb:len() == 0 then
        return 0
    end
    pinfo.cols.protocol:set("RAC")
    local conv = conversation(pinfo, "rac")
    local raw, at, packet = tvb:raw(0, tvb:len()), 0, { lines = 0 }
    while at < #raw do
        -- LF at the start of a line belongs to the end of the line before
        while raw:byte(at + 1) == 10 do
            at = at + 1
        end
        if at == #raw then
            break
        end
        local last = raw:find("\r", at + 1, true)
        if not last and #raw - at <= LONGEST_LINE and pinfo.can_desegment > 0 and tvb:reported_len() == #raw then
            pinfo.desegment_offset, pinfo.desegment_len = at, DESEGMENT_ONE_MORE_SEGMENT
            return #raw
        end
        local stop = last or #raw
        local line = line_text(raw:sub(at + 1, last and last - 1 or #raw))
        if not last or last - at > LONGEST_LINE then
            tree:add(rac, tvb(at, stop - at), "DENSO RAC, not a line")
                :add_proto_expert_info(re.malformed, string.format("Malformed line: no CR within %d bytes", LONGEST_LINE))
        else
            show_line(tvb(at, stop - at):tvb(), pinfo, tree, conv, packet, line)
        end
        at = stop
    end
    return tvb:len()
end

-- Ports and heuristics

DissectorTable.get("tcp.port"):add(PORT, bcap)
DissectorTable.get("udp.port"):add(PORT, bcap)
DissectorTable.get("tcp.port"):add(RAC_PORT, rac)

-- Whether bytes look like a frame: a plausible header, and EOT where the frame ends.
local function looks_like_frame(tvb, is_datagram)
    local bytes = tvb:len()
    if bytes < SHORTEST then
        return false
    end
    local raw = tvb:raw(0, bytes)
    local length = length_of(raw, 0)
    if not length or (is_datagram and length ~= bytes) then
        return false
    elseif length <= bytes and raw:byte(length) ~= EOT then
        return false
    end
    return is_plausible(raw, 0)
end

bcap:register_heuristic("tcp", function(tvb, pinfo, tree)
    if not looks_like_frame(tvb, false) then
        return false
    end
    pinfo.conversation = bcap
    bcap.dissector(tvb, pinfo, tree)
    return true
end)

bcap:register_heuristic("udp", function(tvb, pinfo, tree)
    if not looks_like_frame(tvb, true) then
        return false
    end
    pinfo.conversation = bcap
    bcap.dissector(tvb, pinfo, tree)
    return true
end)

rac:register_heuristic("tcp", function(tvb, pinfo, tree)
    local start = tvb:raw(0, math.min(tvb:len(), 16))
    if not start:match("^%s*[Gg][Ee][Tt]:[Rr][Cc]8:") and not start:match("^%s*[Pp][Uu][Tt]:[Rr][Cc]8:") then
        return false
    end
    pinfo.conversation = rac
    rac.dissector(tvb, pinfo, tree)
    return true
end)
