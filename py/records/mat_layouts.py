"""Which signals a MAT file holds: the layouts of Simulink, ControlDesk and people, each found by its fields.

A signal is named from the struct that holds its time: ``run.time`` and ``run.pump.pressure`` give ``pump.pressure``.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from .clocks import called_time
from .headings import split_header
from .mat_tree import Struct, Unread
from .rasters import Axis, Signal

_TIME_UNITS = {"days": "d", "hours": "h", "minutes": "min", "seconds": "s"}
_TIME_UNITS |= {"milliseconds": "ms", "microseconds": "us", "nanoseconds": "ns"}
_PORT = re.compile(r"(out|in)\d*|value|signal", re.IGNORECASE)  # names nothing; its block does


def signals_of(tree: Struct) -> list[Signal]:
    """The signals of all variables of a file, each with its time where the file tells it."""
    found = _in_struct(tree, "", "", None)
    if any(s.axis for s in found):
        return found
    return [one for s in found for one in _with_time_inside(s)]


def _in_node(node, name: str, path: str, axis: Axis | None) -> list[Signal]:
    """The signals of a node that is called ``name`` in the struct of its time, ``path`` in the file."""
    if isinstance(node, Unread):
        return [Signal(name, None, np.empty(0), axis, path, node.why)]
    if isinstance(node, str):
        return []
    if isinstance(node, list):
        return _in_list(node, name, path, axis)
    if not isinstance(node, Struct):
        return _array(node, name, path, axis)
    for layout in (_simulink_structure, _capture, _dataset, _element, _lone_channel):
        found = layout(node, name, path, axis)
        if found is not None:
            return found
    return _in_struct(node, name, path, axis)


def _in_struct(struct: Struct, name: str, path: str, axis: Axis | None) -> list[Signal]:
    """The fields of a struct; a time among them is that of all fields, and names count from here."""
    struct = _with_named_columns(struct)
    units = struct.get("units") if isinstance(struct.get("units"), Struct) else {}
    own = _own_time(struct)
    if own is not None:
        axis, name = _axis(own, struct[own], _first_text(units.get(own))), ""
    found = []
    for field, node in struct.items():
        if field == own or node is units:
            continue
        below = [f"{start}.{field}" if start else field for start in (name, path)]
        signals = _in_node(node, *below, axis)
        unit = _first_text(units.get(field)) or None
        found += [replace(s, unit=s.unit or unit) for s in signals]
    return found


def _with_named_columns(struct: Struct) -> Struct:
    """The struct with the columns of its matrix as fields, where a list of texts names them all (``colheaders``)."""
    matrices = {f: n for f, n in struct.items() if _is_filled(n) and n.ndim == 2 and min(n.shape) > 1}
    if len(matrices) != 1:
        return struct
    [(field, matrix)] = matrices.items()
    lists = {f: n for f, n in struct.items() if _is_texts(n) and len(n) in matrix.shape}
    of_units = next((f for f in lists if f.lower().startswith(("unit", "einheit"))), None)
    of_names = [f for f in lists if f != of_units]
    if len(of_names) != 1 or len({n.strip() for n in lists[of_names[0]]}) < len(lists[of_names[0]]):
        return struct
    count = len(lists[of_names[0]])
    columns = matrix.T if matrix.shape[1] == count else matrix
    headers = [split_header(name) for name in lists[of_names[0]]]
    given = lists.get(of_units) or [""] * count
    units = Struct(
        {name: u or g.strip("[] ") for (name, u), g in zip(headers, given, strict=True) if u or g.strip("[] ")}
    )
    rest = {f: n for f, n in struct.items() if f not in (field, of_units, of_names[0])}
    named = dict(zip((name for name, _ in headers), columns, strict=True))
    return Struct({**rest, **named} | ({"units": units} if units else {}), struct.kind)


def _own_time(struct: Struct) -> str | None:
    """The field that holds time: ``time``, or one that is called so in other words, and grows."""
    vectors = {field: values for field, node in struct.items() if _is_vector(values := _values_of(node))}
    named = next((field for field in vectors if field.lower() == "time"), None)
    return named or next((f for f, v in vectors.items() if called_time(f) and _grows(v.ravel())), None)


def _axis(field: str, node, unit: str | None) -> Axis:
    values = _values_of(node).ravel()
    if field == "tout":
        return Axis(values)
    return Axis(values, (unit or (_unit_of(node) if isinstance(node, Struct) else None)) or None, field)


def _values_of(node):
    """The array of a node that is one, or that holds one as its value beside a unit."""
    fields = {f.lower(): n for f, n in node.items()} if isinstance(node, Struct) else {}
    return _data_of(fields) if {"unit", "units"} & set(fields) else node


def _is_vector(node) -> bool:
    return _is_filled(node) and node.dtype.kind in "fiumM" and 1 < node.size == max(node.shape)


def _grows(values: np.ndarray) -> bool:
    return bool((values[1:] > values[:-1]).all())


def _array(values: np.ndarray, name: str, path: str, axis: Axis | None) -> list[Signal]:
    """An array over time; a single value is a setting, no signal."""
    samples = len(axis.values) if axis else None
    if values.size == 0 or (values.size == 1 and samples != 1):
        return []
    return [Signal(name, None, values, axis, path)]


def _in_list(nodes: list, name: str, path: str, axis: Axis | None) -> list[Signal]:
    """A cell or an array of structs; a column of texts is a signal without numbers."""
    if _is_texts(nodes):
        is_column = len(nodes) > 1 and (axis is None or len(nodes) == len(axis.values))
        return [Signal(name, None, np.array(nodes, object), axis, path)] if is_column else []
    each = [(n, f"{name}[{k}]", f"{path}[{k}]") for k, n in enumerate(nodes)]
    return [s for node, *names in each for s in _in_node(node, *names, axis)]


def _simulink_structure(node: Struct, name: str, path: str, axis: Axis | None) -> list[Signal] | None:
    """Simulink's "Structure" and "Structure With Time": time, signals(k).values, .label, .blockName."""
    signals = node.get("signals")
    signals = [signals] if isinstance(signals, Struct) else signals
    if not isinstance(signals, list) or not all(isinstance(s, Struct) and "values" in s for s in signals):
        return None
    if "time" not in node:
        return None
    if _is_vector(node["time"]):
        axis = Axis(node["time"].ravel())
    several = len(signals) > 1
    given = [f"{name}_{k + 1}" if several else name for k in range(len(signals))]
    return [one for s, g in zip(signals, given, strict=True) for one in _channel(s, g, f"{path}.{g}", axis)]


def _capture(node: Struct, name: str, path: str, axis: Axis | None) -> list[Signal] | None:
    """A capture of dSPACE ControlDesk: X(i).Data is time, Y(k).Data a signal over X(Y(k).XIndex)."""
    times, signals = ([n] if isinstance(n, Struct) else n for n in (node.get("X"), node.get("Y")))
    if not (isinstance(times, list) and isinstance(signals, list) and times):
        return None
    if not all(isinstance(s, Struct) and "Data" in s for s in (*times, *signals)):
        return None
    axes = [Axis(_vector(x["Data"]), _text_of(x, "unit") or "s") for x in times]
    found = []
    for k, signal in enumerate(signals):
        index = int(next(iter(_vector(signal.get("XIndex"))), 1))
        own = axes[index - 1] if 0 < index <= len(axes) else axes[0]
        named = Struct({**signal, "Name": _name_in_capture(signal)})
        found += _channel(named, f"{name}_{k + 1}", f"{path}.Y({k + 1})", own)
    return found


def _dataset(node: Struct, name: str, path: str, axis: Axis | None) -> list[Signal] | None:
    """A Dataset of Simulink (logsout, yout): its elements are named, itself it names nothing."""
    storage = node.get("Storage_", node)
    elements = storage.get("Elements") if isinstance(storage, Struct) else None
    elements = [elements] if isinstance(elements, Struct) else elements
    if not isinstance(elements, list):
        return None
    each = [(e, f"{name}[{k}]", f"{path}[{k}]") for k, e in enumerate(elements)]
    return [s for element, *names in each for s in _in_node(element, *names, axis)]


def _element(node: Struct, name: str, path: str, axis: Axis | None) -> list[Signal] | None:
    """An element of a Dataset: its Values are a timeseries, or a bus, a struct of them."""
    if not isinstance(node.get("Values"), Struct | list) or not {"Name", "BlockPath"} & set(node):
        return None
    name = _own_name(node) or name
    found = _in_node(node["Values"], name, f"{path}.{name}", axis)
    return [replace(found[0], name=name)] if len(found) == 1 else found


def _lone_channel(node: Struct, name: str, path: str, axis: Axis | None) -> list[Signal] | None:
    """One signal with what is known of it, such as a timeseries, and no other array of that length beside it."""
    fields = {field.lower(): node[field] for field in node}
    data = _data_of(fields)
    if data is None or not (_MARKS & set(fields) or _time_of(fields, axis) is not axis):
        return None
    beside = {f for f, n in fields.items() if _is_vector(n) and n is not data and n.size == max(data.shape)}
    if not beside <= _KNOWN:
        return None
    is_field = "." in path and not path.endswith("]")  # of a struct, which is how people name it
    return _channel(node, name, path, axis, named=is_field)


def _channel(node: Struct, name: str, path: str, axis: Axis | None, named: bool = False) -> list[Signal]:
    """The signal of a struct with its data, and maybe name, unit and time; one per label where it has several.

    ``named``: ``name`` is its name, whatever it calls itself.
    """
    fields = {field.lower(): node[field] for field in node}
    data, axis, label = _data_of(fields), _time_of(fields, axis), fields.get("label")
    if data is None:
        below = fields.get("values", fields.get("data"))
        return _in_node(below, _own_name(node) or name, path, axis) if isinstance(below, Struct | list) else []
    if _is_texts(label) and 1 < len(label) in data.shape:
        columns = data if data.shape[-1] == len(label) else data.T
        return [_named(n or f"{name}[{k}]", node, columns[..., k], axis, path) for k, n in enumerate(label)]
    if data.size == 1 and not (axis and len(axis.values) == 1):
        return []  # a setting
    return [_named(name if named else _own_name(node) or name, node, data, axis, path)]


_MARKS = {"name", "label", "unit", "units"}  # of a struct that is one signal
_KNOWN = {"time", "time_", "x", "t", "quality", "quality_", "data", "data_"}


def _data_of(fields: dict) -> np.ndarray | None:
    return next((fields[f] for f in ("data_", "data", "values", "value") if _is_filled(fields.get(f))), None)


def _named(name: str, node: Struct, data: np.ndarray, axis: Axis | None, path: str) -> Signal:
    short, unit = split_header(name)
    return Signal(short, _unit_of(node) or unit, data, axis, path)


def _time_of(fields: dict, axis: Axis | None) -> Axis | None:
    """The time of a timeseries: a vector of its own or of its TimeInfo, or start, increment and length."""
    info = fields.get("timeinfo")
    info = {f.lower(): n for f, n in info.items()} if isinstance(info, Struct) else {}
    unit = _TIME_UNITS.get(_text_of(info, "units"), _text_of(info, "units")) or "s"
    for node in (fields.get("time"), fields.get("time_"), info.get("time_"), info.get("time"), fields.get("x")):
        if _is_filled(node):
            return Axis(node.ravel(), unit)
    start, step, length = (
        next((float(info[f].flat[0]) for f in names if _is_filled(info.get(f))), None)
        for names in (("start_", "start"), ("increment_", "increment"), ("length",))
    )
    if None in (start, step, length) or not np.isfinite(step):
        return axis
    return Axis(start + step * np.arange(int(length)), unit)


def _own_name(node: Struct) -> str:
    """What a signal calls itself: its label, its name, its title, or the last block on its path that is no port."""
    for field in ("label", "Label", "Name", "name", "title"):
        name = node.get(field)
        if isinstance(name, str) and name.strip("<> ") and name != "unnamed" and "%<" not in name:
            return name.strip("<> ")
    return _last_part(_first_text(node.get("blockName", node.get("BlockPath"))))


def _name_in_capture(node: Struct) -> str:
    """The last part of the name of a captured variable; that of its path where it names only a port."""
    name = _last_part(_first_text(node.get("Name")))
    return name if not _PORT.fullmatch(name) else _last_part(_first_text(node.get("Path"))) or name


def _last_part(path: str) -> str:
    parts = [p.strip().strip("\"'{}") for p in re.split(r"[/\\](?![^\[]*\])", path)]  # not that of [L/min]
    parts = [p for p in parts if p]
    while len(parts) > 1 and _PORT.fullmatch(parts[-1]):
        parts.pop()
    return parts[-1] if parts else ""


def _first_text(node) -> str:
    """The first path that a node of any shape holds."""
    if isinstance(node, str):
        return node
    below = node.values() if isinstance(node, Struct) else node if isinstance(node, list) else ()
    return next((text for text in map(_first_text, below) if text), "")


def _unit_of(node: Struct) -> str | None:
    info = node.get("DataInfo")
    unit = _text_of(info, "units") if isinstance(info, Struct) else ""
    return unit or _text_of(node, "unit") or _text_of(node, "units") or None


def _text_of(fields, name: str) -> str:
    node = next((n for f, n in fields.items() if f.lower() == name), "")
    return _first_text(node).strip()


def _is_texts(node) -> bool:
    return isinstance(node, list) and len(node) > 0 and all(isinstance(n, str) for n in node)


def _is_filled(node) -> bool:
    return isinstance(node, np.ndarray) and node.size > 0 and node.dtype.names is None


def _vector(node) -> np.ndarray:
    return node.ravel() if isinstance(node, np.ndarray) else np.empty(0)


def _with_time_inside(signal: Signal) -> list[Signal]:
    """A matrix whose first row (Simulink's To File) or column (From Workspace) is time, as time and signals."""
    values = signal.values
    if signal.unusable or values.ndim != 2 or min(values.shape) < 2 or values.dtype.kind not in "fiu":
        return [signal]
    both = all(rows.shape[1] > 2 and _grows(rows[0]) for rows in (values, values.T))
    if both and max(values.shape) < 2 * min(values.shape):
        return [replace(signal, unusable="its first row and its first column may both be the time. Save it longer.")]
    for rows in (values, values.T) if values.shape[1] > values.shape[0] else (values.T, values):
        if rows.shape[1] > 2 and _grows(rows[0]):
            axis = Axis(rows[0])
            names = [f"[{k}]" if len(rows) > 2 else "" for k in range(len(rows) - 1)]
            return [
                replace(signal, name=signal.name + n, path=signal.path + n, values=row, axis=axis)
                for n, row in zip(names, rows[1:], strict=True)
            ]
    return [signal]
