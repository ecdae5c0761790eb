"""Composable kernels: sums of products of base kernels, in numpy to train and in CasADi to run.

    k(a, b) = sum_t s2_t prod_f k_f(a / l_f, b / l_f)        s2_t: variance of a term, l_f: ARD lengths of a factor

    rbf       exp(-h)                                 h = |a - b|^2 / 2
    matern32  (1 + r) exp(-r),            r = sqrt(6 h)
    matern52  (1 + r + r^2 / 3) exp(-r),  r = sqrt(10 h)
    linear    a'b

``kernel="linear+rbf*matern32"`` is read by `parsed`: names, ``+``, ``*`` and parentheses, nothing else.

Source: Rasmussen, Williams, Gaussian Processes for Machine Learning (2006), chapter 4; Duvenaud, Lloyd, Grosse,
Tenenbaum, Ghahramani, Structure Discovery in Nonparametric Regression, ICML 2013 (sums of products).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import DeclarationError, nearest

BASES = ("linear", "rbf", "matern32", "matern52")  # the order is that of the numbers in block files
MOST_FACTORS = 8  # of a kernel: each has a length for every feature, which recordings must tell
TINY = 1e-20  # under the root of a squared distance: keeps its derivative finite
_TOKENS = re.compile(r"\s*([a-z0-9]+|[+*()])")


@dataclass(frozen=True)
class Kernel:
    """A sum of ``terms``, each a product of base kernels by name."""

    terms: tuple[tuple[str, ...], ...]

    @property
    def factors(self) -> tuple[tuple[int, str], ...]:
        """All factors as (number of the term, base), in order."""
        return tuple((t, base) for t, term in enumerate(self.terms) for base in term)

    def __str__(self) -> str:
        return "+".join("*".join(term) for term in self.terms)

    def table(self) -> np.ndarray:
        """(factors, 2): number of the term, number of the base in `BASES`; for the block file."""
        return np.array([[t, BASES.index(base)] for t, base in self.factors], dtype=float)

    @classmethod
    def of_table(cls, table: np.ndarray) -> Kernel:
        """The kernel whose `table` this is."""
        terms = [[] for _ in range(int(table[:, 0].max()) + 1)]
        for t, base in table.astype(int):
            terms[t].append(BASES[base])
        return cls(tuple(tuple(term) for term in terms))


def parsed(text: str, verb: str) -> Kernel:
    """The kernel that ``text`` writes, multiplied out.

    Raises `DeclarationError` for an unknown name, a formula that does not parse, or more than `MOST_FACTORS` factors.
    """
    tokens, at = [], 0
    while at < len(str(text).rstrip()):
        found = _TOKENS.match(text, at)
        if not found:
            raise DeclarationError(f"{verb}: kernel '{text}' has '{text[at]}' in it. Use names, +, * and parentheses.")
        tokens.append(found.group(1))
        at = found.end()
    reader = _Reader(tokens, str(text), verb)
    terms = reader.sum()
    if reader.left:
        reader.fail()
    if sum(map(len, terms)) > MOST_FACTORS:
        raise DeclarationError(
            f"{verb}: kernel '{text}' has {sum(map(len, terms))} factors when multiplied out. At most {MOST_FACTORS} "
            "can be told apart from recordings. Leave some out."
        )
    return Kernel(tuple(tuple(sorted(term, key=BASES.index)) for term in terms))


@dataclass
class _Reader:
    """Reads sums of products from tokens, the first one next; answers lists of terms."""

    left: list[str]
    text: str
    verb: str

    def sum(self) -> list[list[str]]:
        terms = self.product()
        while self.left[:1] == ["+"]:
            self.left.pop(0)
            terms = terms + self.product()
        return terms

    def product(self) -> list[list[str]]:
        terms = self.factor()
        while self.left[:1] == ["*"]:
            self.left.pop(0)
            other = self.factor()
            terms = [a + b for a in terms for b in other]
            if len(terms) > MOST_FACTORS:
                break
        return terms

    def factor(self) -> list[list[str]]:
        token = self.left.pop(0) if self.left else ""
        if token == "(":
            terms = self.sum()
            if not self.left or self.left.pop(0) != ")":
                self.fail()
            return terms
        if token in ("", "+", "*", ")"):
            self.fail()
        if token not in BASES:
            raise DeclarationError(f"{self.verb}: no kernel '{token}'. {nearest(token, BASES)}")
        return [[token]]

    def fail(self) -> None:
        raise DeclarationError(
            f"{self.verb}: kernel '{self.text}' is no sum of products. Write it like 'linear+rbf' or 'linear*matern32'."
        )


@dataclass(frozen=True, eq=False)
class Hyper:
    """Hyper-parameters of a kernel: variances (terms,), lengths (factors, d)."""

    kernel: Kernel
    variances: np.ndarray
    lengths: np.ndarray

    def values(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """k(a, b), (n, m), for a (n, d) and b (m, d)."""
        return self._sum([base_value(base, *pair) for (_, base), pair in self._pairs(a, b)], (len(a), len(b)))

    def diagonal(self, a: np.ndarray) -> np.ndarray:
        """k(a, a) of every row, (n,)."""
        parts = [
            np.sum((a / length) ** 2, axis=1) if base == "linear" else np.ones(len(a))
            for (_, base), length in zip(self.kernel.factors, self.lengths, strict=True)
        ]
        return self._sum(parts, (len(a),))

    def slopes(self, points: np.ndarray, z: np.ndarray, weights: np.ndarray, columns: int) -> np.ndarray:
        """Derivative of weights' k(points, z) by the first ``columns`` features at every row of z: (n, columns)."""
        pairs = list(self._pairs(points, z))
        parts, derivatives = zip(*(base_both(base, *pair) for (_, base), pair in pairs), strict=True)
        total = np.zeros((len(z), columns))
        for f, ((t, base), (p, at)) in enumerate(pairs):
            W = self.variances[t] * weights[:, None] * self._others(parts, f)
            length = self.lengths[f, :columns]
            if base == "linear":
                total += (W.T @ p[:, :columns]) / length
                continue
            W = W * derivatives[f]
            total += (W.sum(axis=0)[:, None] * at[:, :columns] - W.T @ p[:, :columns]) / length
        return total

    def gradient(self, a: np.ndarray, b: np.ndarray, G: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivative of sum(G * k(a, b)) by the logarithms of variances and lengths, for G (n, m)."""
        pairs = list(self._pairs(a, b))
        parts, derivatives = zip(*(base_both(base, *pair) for (_, base), pair in pairs), strict=True)
        by_variance, by_length = np.zeros(len(self.variances)), np.zeros_like(self.lengths)
        for t in range(len(self.variances)):
            own = [p for p, (k, _) in zip(parts, self.kernel.factors, strict=True) if k == t]
            by_variance[t] = self.variances[t] * np.vdot(G, own[0] if len(own) == 1 else np.prod(own, axis=0))
        for f, ((t, base), (p, q)) in enumerate(pairs):
            W = self.variances[t] * G * self._others(parts, f)
            if base == "linear":
                by_length[f] = -2.0 * np.sum(p * (W @ q), axis=0)
                continue
            W = W * derivatives[f]
            squares = W.sum(axis=1) @ p**2 + W.sum(axis=0) @ q**2 - 2.0 * np.sum(p * (W @ q), axis=0)
            by_length[f] = -squares
        return by_variance, by_length

    def diagonal_gradient(self, a: np.ndarray, g: float) -> tuple[np.ndarray, np.ndarray]:
        """Derivative of g sum(diagonal(a)) by the logarithms of variances and lengths."""
        pairs = list(zip(self.kernel.factors, self.lengths, strict=True))
        parts = [np.sum((a / le) ** 2, axis=1) if base == "linear" else np.ones(len(a)) for (_, base), le in pairs]
        by_variance, by_length = np.zeros(len(self.variances)), np.zeros_like(self.lengths)
        for t in range(len(self.variances)):
            product = np.prod([p for p, (k, _) in zip(parts, self.kernel.factors, strict=True) if k == t], axis=0)
            by_variance[t] = g * self.variances[t] * product.sum()
        for f, ((t, base), length) in enumerate(pairs):
            if base == "linear":
                others = self.variances[t] * self._others(parts, f) * np.ones(len(a))
                by_length[f] = -2.0 * g * others @ (a / length) ** 2
        return by_variance, by_length

    def _pairs(self, a, b):
        for factor, length in zip(self.kernel.factors, self.lengths, strict=True):
            yield factor, (a / length, b / length)

    def _sum(self, parts: Sequence[np.ndarray], shape) -> np.ndarray:
        total = np.zeros(shape)
        for t, variance in enumerate(self.variances):
            product = variance
            for part, (k, _) in zip(parts, self.kernel.factors, strict=True):
                product = product * part if k == t else product
            total += product
        return total

    def _others(self, parts: Sequence[np.ndarray], f: int):
        """The product of the other factors of the same term."""
        own = self.kernel.factors[f][0]
        product = 1.0
        for g, (t, _) in enumerate(self.kernel.factors):
            product = product * parts[g] if t == own and g != f else product
        return product


def base_value(base: str, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """A base kernel (n, m) for points over its lengths."""
    return base_both(base, a, b)[0]


def base_both(base: str, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """A base kernel (n, m) for points over its lengths, and its derivative by h where it is stationary."""
    if base == "linear":
        return a @ b.T, None
    h = half_squares(a, b)
    if base == "rbf":
        value = np.exp(np.negative(h, out=h), out=h)
        return value, -value
    r = np.sqrt((6.0 if base == "matern32" else 10.0) * h)
    decay = np.exp(-r)
    if base == "matern32":
        return (1.0 + r) * decay, -3.0 * decay
    return (1.0 + r + r * r / 3.0) * decay, -5.0 / 3.0 * (1.0 + r) * decay


def half_squares(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Half of the squared distances (n, m) of rows."""
    h = 0.5 * np.sum(a * a, axis=1)[:, None] + 0.5 * np.sum(b * b, axis=1)[None] - a @ b.T
    return np.maximum(h, 0.0, out=h)


def in_casadi(hyper: Hyper, points: np.ndarray, z):
    """k(points, z), (P, 1), for ``points`` (P, d) numbers and ``z`` (d, 1) a CasADi expression."""
    total, parts = 0.0, {}
    for (t, base), length in zip(hyper.kernel.factors, hyper.lengths, strict=True):
        scaled, at = points / length, z / ca.DM(length)
        dot = ca.mtimes(ca.DM(scaled), at)
        value = dot
        if base != "linear":
            h = ca.fmax(ca.DM(0.5 * np.sum(scaled**2, axis=1)) + 0.5 * ca.sumsqr(at) - dot, 0.0)
            value = stationary(base, h)
        parts[t] = parts[t] * value if t in parts else value
    for t, part in parts.items():
        total = total + float(hyper.variances[t]) * part
    return total


def stationary(base: str, h):
    """A stationary base kernel as a CasADi expression of half the squared distance."""
    r = ca.sqrt((6.0 if base == "matern32" else 10.0) * h + TINY)
    polynomial = 1.0 + r + (r * r / 3.0 if base == "matern52" else 0.0)
    return ca.exp(-h) if base == "rbf" else polynomial * ca.exp(-r)


def diagonal_in_casadi(hyper: Hyper, z):
    """k(z, z) for ``z`` (d, 1) a CasADi expression."""
    parts = {}
    for (t, base), length in zip(hyper.kernel.factors, hyper.lengths, strict=True):
        value = ca.sumsqr(z / ca.DM(length)) if base == "linear" else 1.0
        parts[t] = parts.get(t, 1.0) * value
    return sum(float(hyper.variances[t]) * part for t, part in parts.items())
