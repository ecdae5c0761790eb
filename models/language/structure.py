"""Which equation determines which unknown, and in which order: matching and strongly connected components."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, maximum_bipartite_matching


def match(incidence: Sequence[set[int]], unknowns: int) -> tuple[np.ndarray, list[int], list[int]]:
    """A maximum matching: unknown of each equation (-1: none), the unmatched unknowns and unmatched equations.

    ``incidence[i]`` holds the unknowns that appear in equation i.
    """
    rows = np.repeat(np.arange(len(incidence)), [len(s) for s in incidence])
    columns = np.array([j for s in incidence for j in sorted(s)], dtype=int)
    graph = csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(incidence), unknowns))
    unknown_of = maximum_bipartite_matching(graph, perm_type="column")
    taken = set(unknown_of[unknown_of >= 0].tolist())
    return (
        unknown_of,
        [j for j in range(unknowns) if j not in taken],
        [i for i, j in enumerate(unknown_of) if j < 0],
    )


def ordered_blocks(incidence: Sequence[set[int]], unknown_of: np.ndarray) -> list[list[int]]:
    """Equations grouped into blocks that must be solved together, each after the blocks it needs."""
    equation_of = {int(j): i for i, j in enumerate(unknown_of)}
    needs = [{equation_of[j] for j in unknowns if j != unknown_of[i]} for i, unknowns in enumerate(incidence)]
    rows = np.repeat(np.arange(len(needs)), [len(s) for s in needs])
    columns = np.array([k for s in needs for k in sorted(s)], dtype=int)
    graph = csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(needs), len(needs)))
    count, label = connected_components(graph, directed=True, connection="strong")
    blocks: list[list[int]] = [[] for _ in range(count)]
    for i, block in enumerate(label):
        blocks[block].append(i)
    before = [{label[k] for i in members for k in needs[i]} - {b} for b, members in enumerate(blocks)]
    done: set[int] = set()
    order: list[int] = []

    def visit(start: int) -> None:
        stack = [(start, iter(sorted(before[start])))]
        done.add(start)
        while stack:
            block, rest = stack[-1]
            following = next((k for k in rest if k not in done), None)
            if following is None:
                stack.pop()
                order.append(block)
            else:
                done.add(following)
                stack.append((following, iter(sorted(before[following]))))

    for block in range(count):
        if block not in done:
            visit(block)
    return [blocks[b] for b in order]
