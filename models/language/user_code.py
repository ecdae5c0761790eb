"""Code of a user, run where the language asks for it: what it raises becomes a sentence with file, line and remedy.

A quantity of a model is a symbol: it has a value only when the model runs. Python cannot decide, count or convert with
it; CasADi's functions say the same for symbols.
"""

from __future__ import annotations

import ast
import builtins
import functools
import inspect
import linecache
import re
import sys
import sysconfig
import textwrap
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import casadi as ca
import numpy as np

from .errors import DeclarationError, HydrotwinError, nearest

_FOREIGN = tuple(  # folders of code that no user wrote; hydrotwin's own parts count as a user's, where they are wrong
    str(Path(file).parent) for file in (__file__, ca.__file__, np.__file__)
)
_HYDROTWIN, _MODELS = str(Path(sys.modules["hydrotwin"].__file__).parent), str(Path(__file__).parents[1])
_STANDARD = sysconfig.get_paths()["stdlib"]

if hasattr(ca.GlobalOptions, "setNumpyMode"):
    ca.GlobalOptions.setNumpyMode(-1)  # np.where and the like on quantities, as CasADi always understood them, unwarned

_LIBRARIES = tuple({sysconfig.get_paths()[name] for name in ("purelib", "platlib")})
_PLACED = re.compile(r".*?: line \d+: ")
_KNOWN = "a quantity has a value only when the model runs"

# what Python does with a number -> what to write for a quantity
_CALLS = {
    "max": "ca.fmax(a, b)", "min": "ca.fmin(a, b)", "amax": "ca.fmax(a, b)", "amin": "ca.fmin(a, b)",
    "maximum": "ca.fmax(a, b)", "minimum": "ca.fmin(a, b)", "clip": "ca.fmin(ca.fmax(x, low), high)",
    "abs": "ca.fabs(x)", "round": "ca.floor(x + 0.5)", "int": "ca.floor(x)", "float": "the quantity itself",
    "trunc": "ca.sign(x) * ca.floor(ca.fabs(x))", "bool": "the comparison itself, in ca.if_else",
    "sorted": "ca.fmin(a, b) and ca.fmax(a, b)", "any": "ca.logic_or(a, b)", "all": "ca.logic_and(a, b)",
    "float64": "the quantity itself", "asarray": "the quantity itself", "complex": "the quantity itself",
    "where": "ca.if_else(condition, a, b)", "piecewise": "ca.if_else(condition, a, b)",
    "select": "ca.if_else(condition, a, b)", "pow": "x**y", "dist": "ca.sqrt(ca.sumsqr(x))",
    "radians": "x * math.pi / 180", "degrees": "x * 180 / math.pi", "exp2": "2**x", "cbrt": "ca.sign(x) * "
    "ca.fabs(x)**(1/3)", "isclose": "ca.fabs(a - b) < tolerance", "isnan": "nothing: a quantity is never NaN",
    "range": "a number of Python (a class attribute such as count = 3), for a model cannot change its size",
    "mod": "ca.fmod(a, b)", "absolute": "ca.fabs(x)", "sqr": "x**2", "square": "x**2", "power": "x**y",
    "ln": "ca.log(x)", "interp": "ca.pw_lin(x, [x_1, x_2], [y_1, y_2])",
    "len": "a number of Python (a class attribute such as count = 3), for a quantity is one number",
}  # fmt: skip
_GENERAL = "what CasADi has for it: ca.if_else(condition, a, b), ca.fmax(a, b), ca.logic_and(a, b), ca.sqrt(x)"
_ARRAYS = ("setting an array element with a sequence", "object arrays are not supported", "only length-1 arrays")
_MIXED = re.compile(
    r"unsupported operand type\(s\) for (?:[-+*/%@]|//|\*\*)(?:=| or pow\(\))?: '(.+)' and '(.+)'"
    r"|'[<>]=?' not supported between instances of '(.+)' and '(.+)'|can't multiply sequence by non-int"
)
_ARGUMENT = re.compile(r"([\w.]+)\(\) (?:got an unexpected keyword argument '(\w+)'|missing \d+ required)")
_PARTNERS = {  # what meets a quantity in an operation -> the next step
    "int": "A whole number so large is none that a model can hold: write one below 1e308.",
    "NoneType": "Write a number or a quantity for None.",
    "str": "Write the number without quotes.",
    "complex": "Write the real and the imaginary part as two quantities.",
    "Decimal": "Write float(..) around that number.",
    "Fraction": "Write float(..) around that number.",
    "MX": "Write quantities of the component, self.NAME, for what is made with ca.MX.",
}
_DECLARED = ("Parameter", "State", "Input", "Output", "Variable", "Port")
_DECLARED_HERE = (
    "A declaration has a value only inside equations(), as self.NAME of a part declared in the class body; a "
    "parameter that follows others is Parameter(lambda c: 2 * c.other, ...)."
)
_STATEMENTS = {
    ast.If: "y = ca.if_else(condition, a, b) for 'if condition: y = a, else: y = b'",
    ast.IfExp: "ca.if_else(condition, a, b) for 'a if condition else b'",
    ast.While: "the closed form: a model has no loop whose length depends on a quantity",
    ast.Assert: "the bounds of a Parameter, or the start of a State; no run is watched: look at its output",
    ast.For: "a number of Python to count to, and one quantity with a name of its own for each",
    ast.Subscript: "quantities with names of their own (x_1, x_2): each is one number",
    ast.Match: "ca.if_else(condition, a, b)",
}


class Here:
    """A text that begins with ``file: line n: `` of the nearest caller outside the language, once it is told."""

    def __init__(self, text: str = ""):
        self.text = text

    def __str__(self) -> str:
        frame = sys._getframe(1)
        while frame is not None and _is_foreign(frame.f_code.co_filename):
            frame = frame.f_back
        return f"{place(frame.f_code.co_filename, frame.f_lineno) if frame else ''}{self.text}"


def place(file: str, number: int) -> str:
    """``file: line n: ``, the file as seen from the folder that Python runs in."""
    path = Path(file)
    return f"{path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path}: line {number}: "


def place_of_code(function) -> str:
    """Where a function of a user begins."""
    code = getattr(function, "__code__", None)
    return place(code.co_filename, code.co_firstlineno) if code else ""


def place_of(statements) -> tuple[str, int] | None:
    """File and line where a generator of equations stands at the moment; None where it is no generator."""
    while (inner := getattr(statements, "gi_yieldfrom", None)) is not None and hasattr(inner, "gi_frame"):
        statements = inner
    frame = getattr(statements, "gi_frame", None)
    return (frame.f_code.co_filename, frame.f_lineno) if frame else None


@contextmanager
def running(where: str) -> Iterator[None]:
    """Run a user's code for ``where`` (a path in the model, or a file): what it raises names file, line and remedy.

    Raises
    ------
    DeclarationError : instead of anything that is no error of hydrotwin; those get their line.
    """
    try:
        yield
    except HydrotwinError as error:
        if not (at := _at(error)) or _PLACED.match(str(error)):
            raise
        raise type(error)(f"{place(at.filename, at.lineno)}{error}") from None
    except SyntaxError:
        raise
    except (Exception, SystemExit) as error:
        raise as_sentence(error, where) from error


def as_sentence(error: BaseException, where: str) -> DeclarationError:
    """What went wrong, where, and what to write instead."""
    at = _at(error)
    first = str(error).strip().split("\n")[0]
    raised = f"{type(error).__name__}: {first}" if first else type(error).__name__
    text = _for_a_quantity(error, at) or f"does not run ({raised}). {_for_python(error)}"
    if at and where.endswith(".py"):
        return DeclarationError(f"{place(at.filename, at.lineno)}{text}")
    return DeclarationError(f"{place(at.filename, at.lineno) if at else ''}{where}: {text}")


def _at(error: BaseException) -> traceback.FrameSummary | None:
    """The deepest line that is neither the language's nor a library's; of an installed model, its own."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if f.lineno and not _is_foreign(f.filename)]
    own = [f for f in frames if f.filename.startswith(_MODELS) or not _is_library(f.filename)]
    return (own or frames or [None])[-1]


def _is_library(file: str) -> bool:
    return file.startswith(_LIBRARIES) or "site-packages" in file or "dist-packages" in file


def _is_foreign(file: str) -> bool:
    standard = file.startswith(_STANDARD) and "site-packages" not in file
    ours = file.startswith(_HYDROTWIN) and not file.startswith(_MODELS)
    return standard or ours or file.startswith(("<", *_FOREIGN))


_lock, _depth = threading.Lock(), 0
_as_float = ca.SX.__float__


@contextmanager
def numbers_refused() -> Iterator[None]:
    """CasADi makes NaN of ``float(x)`` and with it of ``math.sqrt(x)``: while equations are written, nobody may."""
    global _depth
    with _lock:
        if _depth == 0:
            ca.SX.__float__ = _float_of_a_number
        _depth += 1
    try:
        yield
    finally:
        with _lock:
            _depth -= 1
            if _depth == 0:
                ca.SX.__float__ = _as_float


def _float_of_a_number(symbol: ca.SX) -> float:
    if not symbol.is_constant():
        raise TypeError(f"SX '{symbol}' is a quantity of the model, no number")
    return _as_float(symbol)


# -- what to write instead ---------------------------------------------------------------------------------------------
def _for_a_quantity(error: BaseException, at: traceback.FrameSummary | None) -> str:
    """The sentence for what Python cannot do with a quantity; "" where that was not it."""
    text = str(error)
    symbolic = any(word in text for word in ("truth value of a CasADi", "SX", "casadi/core", *_ARRAYS))
    if not symbolic or "object has no attribute" in text or "overloaded" in text:
        return ""
    if mixed := _MIXED.match(text):
        other = next((t for t in mixed.groups() if t and t != "SX"), "str")  # what multiplies is a text or a list
        return f"{_source(at)}a quantity and {other.rpartition('.')[2]} do not go together. {_mended(other)}"
    found = _construct(at) if at else None
    if found is None:
        return f"{_source(at)}Python cannot decide or compute with a quantity here: {_KNOWN}. Write {_GENERAL}."
    written = ast.unparse(found).split("\n")[0]
    return f"'{written}' cannot be decided or computed by Python: {_KNOWN}. Write {_instead(found)}."


def _mended(other: str) -> str:
    """What to write where a quantity met something of the type ``other``."""
    if other.endswith(_DECLARED):
        return _DECLARED_HERE
    return _PARTNERS.get(other.rpartition(".")[2], "Write a number or another quantity for it.")


def _source(at: traceback.FrameSummary | None) -> str:
    """``'what is written': `` where the line is known."""
    written = linecache.getline(at.filename, at.lineno) if at and at.lineno == at.end_lineno else ""
    written = written.encode()[at.colno : at.end_colno].decode(errors="replace").strip() if written else ""
    return f"'{written}': " if written else ""


def _construct(at: traceback.FrameSummary) -> ast.AST | None:
    """The innermost part of the line that decides, counts or calls."""
    source = "".join(linecache.getlines(at.filename))
    try:
        tree = ast.parse(source)
    except SyntaxError:
        return None
    begin = (at.lineno, at.colno if at.colno is not None else 0)
    end = (at.end_lineno or at.lineno, at.end_colno if at.end_colno is not None else 10**6)
    fitting = [n for n in ast.walk(tree) if _covers(n, begin, end) and _instead(n)]
    return min(fitting, key=_extent, default=None)


def _covers(node: ast.AST, begin: tuple[int, int], end: tuple[int, int]) -> bool:
    head = node
    if isinstance(node, ast.If | ast.While | ast.Assert):
        head = node.test
    elif isinstance(node, ast.For):
        head = node.iter
    elif isinstance(node, ast.Match):
        head = node.subject
    if getattr(head, "lineno", None) is None:
        return False
    return (head.lineno, head.col_offset) <= begin and end <= (head.end_lineno, head.end_col_offset)


def _extent(node: ast.AST) -> tuple[int, int, int]:
    lines = node.end_lineno - node.lineno
    return lines, node.end_col_offset - node.col_offset, isinstance(node, ast.stmt)


def _instead(node: ast.AST) -> str:
    """What to write for one construct of Python; "" for one that may stay."""
    if isinstance(node, ast.BoolOp):
        word = "and" if isinstance(node.op, ast.And) else "or"
        return f"ca.logic_{word}(a, b) for 'a {word} b'"
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        return "ca.logic_not(a) for 'not a'"
    if isinstance(node, ast.Compare) and len(node.ops) > 1:
        return "ca.logic_and(low < x, x < high) for 'low < x < high'"
    if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.In | ast.NotIn):
        return "ca.logic_or(x == a, x == b) for 'x in (a, b)'"
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitAnd | ast.BitOr | ast.BitXor):
        return {"BitAnd": "ca.logic_and(a, b)", "BitOr": "ca.logic_or(a, b)", "BitXor": "x**y"}[type(node.op).__name__]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Invert):
        return "ca.logic_not(a) for '~a'"
    if isinstance(node, ast.Call):
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        return _CALLS.get(name) or (f"ca.{name}(...)" if _is_of_casadi(node.func, name) else "")
    return _STATEMENTS.get(type(node), "")


def _is_of_casadi(function: ast.expr, name: str) -> bool:
    """``math.sqrt``, ``np.sqrt`` or ``sqrt``, for which CasADi has its own."""
    module = getattr(getattr(function, "value", None), "id", "")
    return module not in ("ca", "casadi", "self") and name in ca.__dict__ and hasattr(ca.SX, name)


def _for_python(error: BaseException) -> str:
    """The next step for an error that has nothing to do with symbols."""
    text = str(error)
    if isinstance(error, NameError):
        name = getattr(error, "name", "") or next(iter(re.findall(r"'(\w+)'", text)), "")
        if isinstance(error, UnboundLocalError):
            return f"Give '{name}' a value before that line, whichever branch is taken."
        imports = {"ca": "import casadi as ca", "casadi": "import casadi", "np": "import numpy as np"}
        if name in imports:
            return f"Write '{imports[name]}' at the top of the file."
        return f"Define '{name}' or import it; quantities of a component are written self.{name}."
    if isinstance(error, AttributeError) and isinstance(module := getattr(error, "obj", None), ModuleType):
        if instead := _CALLS.get(error.name):
            return f"Write {instead}."
        return nearest(error.name, [name for name in dir(module) if not name.startswith("_")])
    if isinstance(error, TypeError) and (said := _ARGUMENT.match(text)):
        return _for_arguments(error, *said.groups())
    if "overloaded" in text or "'SX' object has no attribute" in text:
        return f"A function of CasADi takes other arguments, or a quantity has no such attribute. Write {_GENERAL}."
    if isinstance(error, AttributeError) and hasattr(getattr(error, "obj", None), "changes"):
        names = [name for name in dir(error.obj) if not name.startswith("_")]
        return f"{type(error.obj).__name__} declares no '{error.name}'. {nearest(error.name, names)}"
    if isinstance(error, RecursionError):
        return "Something calls itself without end: break the circle."
    if isinstance(error, ImportError) and ("circular" in text or "hydrotwin_user_" in text):
        return "Two files import each other, or it has no such name: move what both need into a third file."
    if any(f"{word}'" in text for word in _DECLARED):
        return _DECLARED_HERE
    return "Correct the file."


def _for_arguments(error: TypeError, called: str, unknown: str | None) -> str:
    """How something is called that was called otherwise: the nearest argument, or all of them."""
    step = error.__traceback__
    while step.tb_next:
        step = step.tb_next
    known = {**vars(builtins), **step.tb_frame.f_globals, **step.tb_frame.f_locals}
    first, *rest = called.removesuffix(".__init__").split(".")
    found = functools.reduce(lambda one, name: getattr(one, name, None), rest, known.get(first))
    try:
        arguments = inspect.signature(found).parameters
    except (TypeError, ValueError):
        return "Correct the file."
    if unknown:
        return nearest(unknown, arguments)
    needed = [name for name, a in arguments.items() if a.default is a.empty and a.kind is not a.VAR_KEYWORD]
    return f"Write {first}({', '.join([*needed, '..'])})."


def unsaid(kind: type, base: type) -> Iterator[str]:
    """What ``kind`` writes and does not yield, and what it replaces without calling it; sentences with the line.

    base : the class whose ``equations`` say nothing.
    """
    for name in ("equations", "initial_equations"):
        method = vars(kind).get(name)
        if method is None or not (code := getattr(method, "__code__", None)):
            continue
        lines, first = linecache.getlines(code.co_filename), code.co_firstlineno
        try:
            tree = ast.parse(textwrap.dedent("".join(inspect.getblock(lines[first - 1 :]))))
        except (SyntaxError, IndexError):
            continue
        for node in ast.walk(tree):
            if _is_equation(node):
                at = place(code.co_filename, first + node.lineno - 1)
                yield f"{at}'{ast.unparse(node.value)}' is written and not yielded. Write 'yield' before it."
        replaced = next((b for b in kind.__mro__[1:] if name in vars(b) and b is not base), None)
        if replaced and "super" not in code.co_names:
            yield (
                f"{place_of_code(method)}{kind.__name__}.{name} replaces that of {replaced.__name__}. Begin it with "
                f"'yield from super().{name}()' if its equations shall hold."
            )


def _is_equation(node: ast.AST) -> bool:
    """``a == b`` or ``connect(a, b)`` as a statement, or returned."""
    if not isinstance(node, ast.Expr | ast.Return):
        return False
    if isinstance(node.value, ast.Call):
        return isinstance(node, ast.Expr) and getattr(node.value.func, "id", "") == "connect"
    return isinstance(node.value, ast.Compare) and isinstance(node.value.ops[0], ast.Eq)
