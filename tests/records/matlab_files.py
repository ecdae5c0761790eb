"""MAT files as MATLAB lays them out, from one description: dict = struct, list = array of structs, tuple = cell."""

from __future__ import annotations

import numpy as np

_CLASS = {"f8": "double", "f4": "single", "b1": "logical", "u1": "uint8", "i2": "int16", "i4": "int32", "i8": "int64"}


def write_v5(path, variables: dict, **options) -> None:
    import scipy.io

    scipy.io.savemat(path, {name: _for_scipy(node) for name, node in variables.items()}, **options)


def _for_scipy(node):
    if isinstance(node, dict):
        return {name: _for_scipy(below) for name, below in node.items()}
    if isinstance(node, list):
        structs = np.empty((1, len(node)), dtype=[(name, object) for name in node[0]])
        for k, struct in enumerate(node):
            for name, below in struct.items():
                structs[0, k][name] = _for_scipy(below)
        return structs
    if isinstance(node, tuple):
        cell = np.empty((1, len(node)), dtype=object)
        for k, below in enumerate(node):
            cell[0, k] = _for_scipy(below)
        return cell
    return node


def write_v73(path, variables: dict) -> None:
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, node in variables.items():
            _put(file, file, name, node)
    with open(path, "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + b"\x00\x02IM")


def _put(file, group, name: str, node) -> None:
    import h5py

    if isinstance(node, dict):
        struct = group.create_group(name)
        _describe(struct, "struct", node)
        for field, below in node.items():
            _put(file, struct, field, below)
    elif isinstance(node, list):
        struct = group.create_group(name)
        _describe(struct, "struct", node[0])
        for field in node[0]:
            references = [_refer(file, one[field]) for one in node]
            struct.create_dataset(field, data=np.array(references, h5py.ref_dtype)[:, None], dtype=h5py.ref_dtype)
    elif isinstance(node, tuple):
        references = np.array([_refer(file, below) for below in node], h5py.ref_dtype)[:, None]
        group.create_dataset(name, data=references, dtype=h5py.ref_dtype).attrs["MATLAB_class"] = np.bytes_("cell")
    else:
        _put_array(group, name, node)


def _describe(struct, kind: str, fields) -> None:
    import h5py

    struct.attrs["MATLAB_class"] = np.bytes_(kind)
    names = np.empty(len(fields), dtype=object)
    names[:] = [np.frombuffer(field.encode(), "S1") for field in fields]
    struct.attrs.create("MATLAB_fields", names, dtype=h5py.vlen_dtype(np.dtype("S1")))


def _refer(file, node):
    below = file.require_group("#refs#")
    name = f"r{len(below)}"
    _put(file, below, name, node)
    return below[name].ref


def _put_array(group, name: str, node) -> None:
    is_text = isinstance(node, str)
    values = np.frombuffer(node.encode("utf-16-le"), "<u2")[None, :] if is_text else np.atleast_2d(np.asarray(node))
    if values.dtype.kind == "c":
        values = np.rec.fromarrays([values.real, values.imag], names="real,imag").view(np.ndarray)
    kind = "char" if is_text else _CLASS.get(values.dtype.str[1:], "double")
    if values.size == 0:
        item = group.create_dataset(name, data=np.array(values.shape[::-1], "u8"))
        item.attrs["MATLAB_empty"] = np.uint8(1)
    elif values.dtype == bool:
        item = group.create_dataset(name, data=values.T.astype("u1"))
    else:
        item = group.create_dataset(name, data=values.T)
    item.attrs["MATLAB_class"] = np.bytes_(kind)
    if kind in ("char", "logical"):
        item.attrs["MATLAB_int_decode"] = np.int32(2 if is_text else 1)
