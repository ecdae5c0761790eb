"""Genetic programming for one target with pyoperon: generations, elitism, roulette, and an archive over all of them.

The operators are those of the C-EHA paper, section 3: roulette wheel; the best 25 % pass unchanged (the worst 75 % are
replaced); crossover 80 %, mutation 3 % (a new random subtree); at most 20 nodes in both. An offspring to which neither
happens is drawn again, so that nothing but the elite is copied. A leaf is a constant or a variable with a factor; a
factor is no node of its own. pyoperon computes in single precision.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pyoperon as op

from .block import ADD, CONSTANT, COSINE, MULTIPLY, SINE, SUBTRACT, TANH, VARIABLE, Formula

NODES = 20
ELITE = 0.25
CROSSOVER, MUTATION = 0.8, 0.03
STRETCH = 10  # generations between two looks at the clock and the keyboard
PER_LENGTH = 3  # formulas of one length that the archive keeps
_CODES = {
    op.NodeType.Add: ADD,
    op.NodeType.Sub: SUBTRACT,
    op.NodeType.Mul: MULTIPLY,
    op.NodeType.Cos: COSINE,
    op.NodeType.Sin: SINE,
    op.NodeType.Tanh: TANH,
}


@dataclass(frozen=True)
class Found:
    """A formula of the archive: its error (SSE, or 1 - R2 when scaled), nodes, seed and generation."""

    formula: Formula
    error: float
    nodes: int
    seed: int
    generation: int


@dataclass(frozen=True)
class SearchProgress:
    """After one generation: the best error so far of this output and seed; evaluations since the start."""

    output: str
    seed: int
    generation: int
    best: float
    evaluations: int
    seconds: float


@dataclass(frozen=True)
class Rules:
    """When a search ends: generations, an error that is good enough, or no gain over ``patience`` generations."""

    population: int = 1000
    generations: int = 100
    good_enough: float = 0.0
    patience: int = 30
    least_gain: float = 1e-3  # of the best error, over ``patience`` generations


@dataclass
class Archive:
    """The best formulas of every length over all generations and seeds."""

    found: dict[int, list[Found]] = field(default_factory=dict)
    best: float = np.inf
    seconds: float = 0.0  # of the processor, spent in the search
    evaluations: int = 0
    stopped: str = ""

    def all(self) -> list[Found]:
        """Everything kept, the shortest first."""
        return [f for nodes in sorted(self.found) for f in self.found[nodes]]

    def wants(self, nodes: int, error: float) -> bool:
        """Whether a formula of this length and error would be kept."""
        kept = self.found.get(nodes, [])
        if any(abs(error - f.error) <= 1e-5 * abs(f.error) for f in kept):
            return False
        return len(kept) < PER_LENGTH or error < kept[-1].error

    def keep(self, found: Found) -> None:
        """Add a formula and drop the worst of its length."""
        kept = self.found.setdefault(found.nodes, [])
        kept.append(found)
        kept.sort(key=lambda f: f.error)
        del kept[PER_LENGTH:]


class _Population:
    """pyoperon's objects for one search; all are held here, since pyoperon keeps only pointers to them."""

    def __init__(self, features: np.ndarray, target: np.ndarray, scaled: bool, rules: Rules, seed: int):
        self.values_in = np.asfortranarray(np.column_stack([features, target]), dtype=np.float32)
        self.data = op.Dataset(self.values_in)
        columns = sorted(self.data.Variables, key=lambda v: v.Index)
        self.variables = {v.Hash: v.Index for v in columns[:-1]}
        self.problem = op.Problem(self.data)
        self.problem.TrainingRange = op.Range(0, self.data.Rows)
        self.problem.TestRange = op.Range(0, 1)
        self.problem.Target = columns[-1]
        self.inputs = list(self.variables)
        self.problem.InputHashes = self.inputs
        symbols = (*_CODES, op.NodeType.Constant, op.NodeType.Variable)
        self.problem.ConfigurePrimitiveSet(sum(int(s) for s in symbols))
        self.symbols = self.problem.PrimitiveSet  # a copy: taken after it was configured
        self.creator = op.BalancedTreeCreator(self.symbols, self.inputs, 0.0)
        self.values = op.NormalCoefficientInitializer()
        self.values.ParameterizeDistribution(0, 1)
        self.table = op.DispatchTable()
        self.metric = op.R2() if scaled else op.SSE()
        self.evaluator = op.Evaluator(self.problem, self.table, self.metric, scaled)
        self.evaluator.Budget = 2**60
        self.order = op.SingleObjectiveComparison(0)
        self.selector = op.ProportionalSelector(self.order)
        self.reinserter = op.ReplaceWorstReinserter(self.order)
        self.crossover = op.SubtreeCrossover(0.9, NODES, NODES)
        self.mutation = op.ReplaceSubtreeMutation(self.creator, self.values, NODES, NODES)
        self.optimizer = op.LMOptimizer(self.table, self.problem, 0, 0)
        self.local = op.CoefficientOptimizer(self.optimizer)
        self.generator = op.BasicOffspringGenerator(
            self.evaluator, self.crossover, self.mutation, self.selector, self.selector, self.local
        )
        self.first = op.UniformLengthTreeInitializer(self.creator)
        self.first.ParameterizeDistribution(1, NODES)
        self.first.MinDepth, self.first.MaxDepth = 1, 1000
        self.config = op.GeneticAlgorithmConfig(
            generations=STRETCH,
            max_evaluations=2**60,
            local_iterations=0,
            population_size=rules.population,
            pool_size=rules.population - round(ELITE * rules.population),
            p_crossover=CROSSOVER,
            p_mutation=MUTATION,
            p_local=0.0,
            p_lamarck=0.0,
            epsilon=1e-12,
            seed=seed,
            max_time=2**40,
        )
        self.search = op.GeneticProgrammingAlgorithm(
            self.config, self.problem, self.first, self.values, self.generator, self.reinserter
        )
        self.random = op.RandomGenerator(np.uint64(seed))

    def formula(self, tree) -> Formula:
        """A tree as tokens; pyoperon's postfix read backwards is prefix with the operands in order."""
        tokens, constants = [], []
        for node in reversed(tree.Nodes):
            if node.IsVariable:
                tokens += [MULTIPLY, CONSTANT, VARIABLE + self.variables[node.HashValue]]
                constants.append(float(node.Value))
            elif node.IsConstant:
                tokens.append(CONSTANT)
                constants.append(float(node.Value))
            else:
                tokens.append(_CODES[node.Type])
        return Formula(tuple(tokens), tuple(constants))

    def with_scale(self, tree, target: np.ndarray) -> Formula:
        """The tree times a factor plus a shift, by least squares; what the scaled error has judged."""
        values = op.Evaluate(self.table, tree, self.data, self.problem.TrainingRange)
        factor, shift = op.FitLeastSquares(values, target.astype(np.float32))
        f = self.formula(tree)
        return Formula((ADD, CONSTANT, MULTIPLY, CONSTANT, *f.tokens), (float(shift), float(factor), *f.constants))


def search(
    features: np.ndarray,
    target: np.ndarray,
    archive: Archive,
    *,
    seed: int,
    rules: Rules,
    scaled: bool,
    until: float,
    output: str = "",
    progress: Callable | None = None,
) -> list[float]:
    """Run one search into ``archive``; answers the best error of every generation.

    features (n, nf), target (n,) ; scaled : judge by 1 - R2 after a factor and a shift, else by the plain SSE.
    until : `time.monotonic()` at which to stop. ``progress`` gets a `SearchProgress` for every generation, in this
    thread. Ctrl-C passes through after at most `STRETCH` generations; the archive holds what was found.
    """
    population = _Population(features, target, scaled, rules, seed)
    history: list[float] = []
    started, spent, generations = time.monotonic(), time.process_time(), 0
    while True:
        seen = _run_stretch(population, target, archive, seed, generations, scaled)
        seen = seen[1:] if generations else seen  # the first of a later stretch is the last of the one before
        for best, evaluations in seen:
            history.append(min([best, *history[-1:]]))
            step = SearchProgress(output, seed, len(history) - 1, history[-1], evaluations, time.monotonic() - started)
            if progress is not None:
                progress(step)
        generations += STRETCH
        archive.seconds, spent = archive.seconds + time.process_time() - spent, time.process_time()
        archive.best = min(archive.best, history[-1])
        archive.stopped = _reason(history, rules, until)
        if archive.stopped:
            return history


def _run_stretch(population: _Population, target, archive: Archive, seed: int, done: int, scaled: bool):
    """Some generations; per generation the best error and the evaluations so far."""
    seen, trouble, before = [], [], archive.evaluations

    def look():  # in a thread of pyoperon, where an exception would end the process
        try:
            archive.evaluations = before + population.evaluator.CallCount
            best = _collect(population, target, archive, seed, done + len(seen), scaled)
            seen.append((best, archive.evaluations))
        except BaseException as error:
            trouble.append(error)
            population.evaluator.Budget = 1  # ends the run

    population.search.Run(population.random, look, 1, done > 0)
    if trouble:
        raise trouble[0]
    return seen


def _collect(population: _Population, target, archive: Archive, seed: int, generation: int, scaled: bool) -> float:
    """Put what the archive wants into it; answers the best error. The first N individuals are the parents."""
    individuals = population.search.Individuals
    count = population.config.PopulationSize
    errors = np.array([individuals[k].GetFitness(0) for k in range(count)], dtype=float)
    errors = errors + 1.0 if scaled else errors  # pyoperon's R2 is its negative
    for k in np.argsort(errors, kind="stable")[: count // 4]:
        tree = individuals[int(k)].Genotype
        if np.isfinite(errors[k]) and archive.wants(tree.Length, errors[k]):
            formula = population.with_scale(tree, target) if scaled else population.formula(tree)
            archive.keep(Found(formula, float(errors[k]), tree.Length, seed, generation))
    return float(np.nanmin(errors))


def _reason(history: list[float], rules: Rules, until: float) -> str:
    """Which of the three criteria, or the clock, ends the search; empty when none does."""
    if len(history) > rules.generations:
        return "generations"
    if history[-1] <= rules.good_enough:
        return "good enough"
    if len(history) > rules.patience and history[-1] > (1 - rules.least_gain) * history[-1 - rules.patience]:
        return "converged"
    return "time budget" if time.monotonic() > until else ""
