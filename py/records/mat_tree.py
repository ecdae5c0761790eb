"""What a MAT file of any version holds, as one tree: structs, lists, texts and arrays in MATLAB's shape.

Versions 4 to 7 are read by scipy, 7.3 by h5py, and files with objects (timeseries, Dataset, timetable) by mat-io.
"""

from __future__ import annotations

import importlib.util
import io
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .mat_elements import check_elements

HEADER_BYTES = 512  # MATLAB's own text before the HDF5 part of a v7.3 file
_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_NODES, _DEPTH = 1_000_000, 32  # of what people write; more is made to do harm
_DENSEST = 1100  # times as large as its file may data be: deflate reaches 1032
_WITHOUT_DATA = 4096  # bytes that any file may hold


class Struct(dict):
    """A struct or an object of MATLAB: field -> node. ``kind`` is its class."""

    def __init__(self, fields=(), kind: str = "struct"):
        super().__init__(fields)
        self.kind = kind


class Unread:
    """What was not read; ``why`` is a sentence without file and name."""

    def __init__(self, why: str):
        self.why = why


def read_tree(path: Path, content: bytes) -> Struct:
    """Variable -> node: `Struct`, list (a cell, an array of structs), text, array, or `Unread`."""
    starts = content[:8], content[HEADER_BYTES : HEADER_BYTES + 8]
    is_hdf5 = _HDF5_SIGNATURE in starts or b"MATLAB 7.3" in content[:16]
    if not is_hdf5:
        check_elements(content)
    objects = b"#subsystem#" in content if is_hdf5 else _has_subsystem(content)
    if objects and _has_matio():
        try:
            return _read_matio(path)
        except Exception:  # it raises many kinds; what holds no objects can be read without it
            pass
    return _Hdf5(content).variables() if is_hdf5 else _read_scipy(content, objects)


def _has_matio() -> bool:
    return importlib.util.find_spec("matio") is not None


def _read_matio(path: Path) -> Struct:
    import matio

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what it cannot read stays what it is
        return Struct(_nodes(matio.load_from_mat(str(path), add_table_attrs=True)))


def _has_subsystem(content: bytes) -> bool:
    """Does a v5 file hold objects? Bytes 116 to 124 of its header say where (MAT-file format, 1-5)."""
    offset = content[116:124]
    return len(content) > 128 and content[126:128] in (b"IM", b"MI") and offset not in (b"\0" * 8, b" " * 8)


def _read_scipy(content: bytes, objects: bool) -> Struct:
    import scipy.io

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", scipy.io.matlab.MatReadWarning)  # objects all come under one name
        loaded = scipy.io.loadmat(io.BytesIO(content), chars_as_strings=True, struct_as_record=True)
    loaded.pop("None", None)
    tree = Struct(_nodes({k: v for k, v in loaded.items() if not k.startswith("__")}))
    if objects:
        for _, stream in scipy.io.matlab.varmats_from_mat(io.BytesIO(content)):
            opaque = scipy.io.loadmat(stream).get("None")
            if isinstance(opaque, scipy.io.matlab.MatlabOpaque):
                tree[_text(opaque["s0"][0])] = _object(_text(opaque["s2"][0]))
    return tree


def _text(value) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _object(kind: str) -> Unread:
    if _has_matio():
        return Unread(f"it is an object of MATLAB ({kind}) that mat-io cannot read. Save its values as plain arrays.")
    return Unread(
        f"it is an object of MATLAB ({kind}), which the package mat-io reads. Install the extra: "
        "pip install 'hydrotwin[mat]'."
    )


def _nodes(variables: dict) -> dict:
    adapter = _Adapter()
    return {name: adapter.node(value) for name, value in variables.items()}


class _Adapter:
    """From what scipy and mat-io give to nodes; an object that holds itself is read once."""

    def __init__(self):
        self._objects: dict[int, object] = {}

    def node(self, value):
        if hasattr(value, "properties") and hasattr(value, "classname"):
            return self._object(value)
        if hasattr(value, "columns") and hasattr(value, "index"):
            return _frame(value)
        if isinstance(value, Mapping):
            return Struct({str(k): self.node(v) for k, v in value.items()})
        if not isinstance(value, np.ndarray):
            return value if isinstance(value, str) else Unread(f"it is a {type(value).__name__}. Save it as an array.")
        if value.dtype.names and "s2" in value.dtype.names and "arr" in value.dtype.names:
            return _object(_text(value["s2"].flat[0]))
        if value.dtype.names:
            kind = getattr(value, "classname", None) or "struct"
            many = [Struct({f: self.node(one[f]) for f in value.dtype.names}, kind) for one in value.flat]
            return many[0] if len(many) == 1 else many
        if value.dtype.kind == "O":
            return [self.node(one) for one in value.ravel(order="F")]
        if value.dtype.kind in "UST":
            texts = [_text(v) for v in value.ravel(order="F")]
            return texts[0] if len(texts) == 1 else (texts or "")
        return value

    def _object(self, value):
        if id(value) not in self._objects:
            self._objects[id(value)] = Unread("it is an object that holds itself. Save its values as arrays.")
            fields = value.properties
            if not isinstance(fields, dict):
                return _object(str(value.classname))
            fields = {f: self.node(v) for f, v in fields.items()}
            saved = fields.get("any")  # what a class of MATLAB returns that saves itself in its own way
            self._objects[id(value)] = Struct(saved if isinstance(saved, Struct) else fields, str(value.classname))
        return self._objects[id(value)]


def _frame(frame) -> Struct:
    """A table or a timetable, whose index is its time."""
    units = frame.attrs.get("varUnits", [])
    fields = {str(name): _values(frame[name]) for name in frame.columns}
    if frame.index.dtype.kind in "mM":
        fields = {"time": frame.index.to_numpy(), **fields}
    if len(units) == len(frame.columns):
        fields["units"] = Struct({str(n): str(u) for n, u in zip(frame.columns, units, strict=True)})
    return Struct(fields, "table")


def _values(series) -> np.ndarray | list:
    values = series.to_numpy()
    return list(values) if values.dtype.kind == "O" else values


class _Hdf5:
    """The tree of a v7.3 file: groups are structs, references lead to cells and arrays of structs."""

    def __init__(self, content: bytes):
        self._content, self._left = content, _NODES

    def variables(self) -> Struct:
        import h5py

        with h5py.File(io.BytesIO(self._content), "r") as file:
            self._file = file
            return Struct({k: self._member(file, k, 0) for k in file if not k.startswith("#")})

    def _member(self, group, name: str, depth: int):
        import h5py

        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            return Unread("it is stored in another file. Export it as a whole.")
        return self._node(group[name], depth)

    def _node(self, item, depth: int):
        self._left -= 1
        if depth > _DEPTH or self._left < 0:
            raise ValueError("nested more deeply than a recording is")
        kind = _text(item.attrs.get("MATLAB_class", b""))
        if "MATLAB_object_decode" in item.attrs:
            return _object(kind)
        if "MATLAB_sparse" in item.attrs:
            return Unread("it is a sparse matrix. Save it in full: full(x).")
        if hasattr(item, "keys"):
            return self._struct(item, depth)
        if item.is_virtual or item.external:
            return Unread("it is stored in another file. Export it as a whole.")
        if item.size and item.nbytes > max(_DENSEST * len(self._content), _WITHOUT_DATA):
            raise ValueError(f"{item.name} claims {item.nbytes:.3g} bytes")
        if "MATLAB_empty" in item.attrs:
            return {"char": "", "cell": []}.get(kind, np.empty((0, 0)))
        values = item[()]
        if _holds_references(item):
            return [self._node(self._file[r], depth + 1) for r in values.ravel()]  # the order of MATLAB
        array, unit = _hdf5_array(values, kind), item.attrs.get("unit", item.attrs.get("units"))
        if {"scale_factor", "add_offset"} & set(item.attrs):  # packed numbers, after the CF conventions
            factor, offset = item.attrs.get("scale_factor", 1.0), item.attrs.get("add_offset", 0.0)
            array = array * float(np.ravel(factor)[0]) + float(np.ravel(offset)[0])
        return array if unit is None else Struct({"value": array, "unit": _text(unit)})

    def _struct(self, group, depth: int) -> Struct | list:
        """A struct; an array of structs where its fields are references that belong to no cell."""
        order = [b"".join(f).decode() for f in group.attrs.get("MATLAB_fields", ()) if hasattr(f, "__len__")]
        names = [f for f in order if f in group] or list(group)
        fields = {name: self._member(group, name, depth + 1) for name in names}
        lengths = {len(fields[n]) if _holds_references(group[n], b"") else -1 for n in names}
        if len(lengths) != 1 or -1 in lengths:
            return Struct(fields)
        return [Struct({n: v[k] for n, v in fields.items()}) for k in range(lengths.pop())]


def _holds_references(item, of_class: bytes | None = None) -> bool:
    import h5py

    is_class = of_class is None or item.attrs.get("MATLAB_class", b"") == of_class
    return isinstance(item, h5py.Dataset) and h5py.check_ref_dtype(item.dtype) is h5py.Reference and is_class


def _hdf5_array(values, kind: str):
    if kind == "char":
        rows = np.atleast_2d(np.asarray(values).T).astype("<u2")
        texts = [row.tobytes().decode("utf-16-le", errors="replace") for row in rows]
        return texts[0] if len(texts) == 1 else texts
    values = np.asarray(values)
    if values.dtype.names and {"real", "imag"} <= set(values.dtype.names):
        values = values["real"] + 1j * values["imag"]
    if values.dtype.kind in "SO":
        return [_text(v) for v in values.ravel()]
    return values.T
