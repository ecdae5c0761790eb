"""A second device for machines without a GPU: tensors that say they are elsewhere and refuse to meet those on the CPU.

Their values are held beside them on the CPU, so a training runs to its end; they call themselves "meta", a device that
every torch knows. As on a GPU, only numbers (tensors without dimension) may come from the CPU, and only ``cpu()`` or
``item()`` brings a value back.
"""

from __future__ import annotations

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map

ELSEWHERE = torch.device("meta")


class Held(torch.Tensor):
    """A tensor elsewhere; ``held`` are its values."""

    @staticmethod
    def __new__(cls, held: torch.Tensor):
        return torch.Tensor._make_wrapper_subclass(
            cls, held.size(), strides=held.stride(), storage_offset=held.storage_offset(), dtype=held.dtype,
            device=ELSEWHERE, requires_grad=False,
        )  # fmt: skip

    def __init__(self, held: torch.Tensor):
        self.held = held

    __torch_function__ = torch._C._disabled_torch_function_impl

    @classmethod
    def __torch_dispatch__(cls, operation, types, args=(), kwargs=None):
        raise AssertionError(f"{operation} met a tensor elsewhere outside `AnotherDevice`")


class AnotherDevice(TorchDispatchMode):
    """Within it torch has the device `ELSEWHERE`; ``operations`` counts what was computed there."""

    def __init__(self):
        super().__init__()
        self.operations = 0

    def __torch_dispatch__(self, operation, types, args=(), kwargs=None):
        kwargs = dict(kwargs or {})
        given = [t for t in tree_flatten((args, kwargs))[0] if isinstance(t, torch.Tensor)]
        there = any(isinstance(t, Held) for t in given)
        target = kwargs.get("device", ELSEWHERE if there else None)
        copies = operation._schema.name in ("aten::_to_copy", "aten::copy_")
        strangers = [t for t in given if not isinstance(t, Held) and t.dim()]
        if there and strangers and not copies:
            raise AssertionError(f"{operation}: tensors of the CPU met tensors elsewhere")
        if kwargs.get("device") == ELSEWHERE:
            kwargs["device"] = torch.device("cpu")
        answer = operation(*tree_map(_values, args), **tree_map(_values, kwargs))
        if target != ELSEWHERE:
            return answer
        self.operations += 1
        if operation._schema.name.endswith("_") and isinstance(args[0], Held):
            return args[0]
        return tree_map(lambda t: Held(t) if isinstance(t, torch.Tensor) else t, answer)


def _values(item):
    return item.held if isinstance(item, Held) else item
