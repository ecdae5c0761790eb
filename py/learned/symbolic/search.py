"""Genetic programming for one target with pyoperon, and an archive of the best over all generations and seeds.

Two sets of operators, both pyoperon's. The default (`Rules`): tournaments, the best of parents and offspring live on,
subtree crossover, seven mutations, and some Levenberg-Marquardt steps on all constants of every offspring, which keeps
what they find. That of the C-EHA paper, section 3 (`PAPER`): roulette wheel; the best 25 % pass unchanged (the worst
75 % are replaced); crossover 80 %, mutation 3 % (a new random subtree); at most 20 nodes in both. An offspring to which
neither happens is drawn again, so that nothing but the elite is copied. A leaf is a constant or a variable with a
factor; a factor is no node of its own. pyoperon computes in single precision, here in one thread.

Sources: Burlacu, Kronberger, Kommenda, GECCO Companion (2020) 1562-1570 (operon); Kommenda et al., Genetic Programming
and Evolvable Machines 21 (2020) 471-501 (least squares on the constants).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pyoperon as op

from .block import (
    ADD,
    CONSTANT,
    COSINE,
    DIVIDE,
    EXP,
    LOG,
    MULTIPLY,
    SINE,
    SQRT,
    SQUARE,
    SUBTRACT,
    TANH,
    VARIABLE,
    Formula,
)

ELITE = 0.25  # of the paper
DEPTH = 10  # of a tree, where not its nodes alone bound it
FIRST_NODES = 10  # of the trees of the first generation
STRETCH = 10  # generations between two looks at the clock and the keyboard
PER_LENGTH = 3  # formulas of one length that the archive keeps
NONE = 1e38  # error from which on pyoperon means that a formula has no value
FUNCTIONS = {
    "add": (op.NodeType.Add, ADD),
    "sub": (op.NodeType.Sub, SUBTRACT),
    "mul": (op.NodeType.Mul, MULTIPLY),
    "div": (op.NodeType.Div, DIVIDE),
    "sin": (op.NodeType.Sin, SINE),
    "cos": (op.NodeType.Cos, COSINE),
    "tanh": (op.NodeType.Tanh, TANH),
    "exp": (op.NodeType.Exp, EXP),
    "log": (op.NodeType.Logabs, LOG),
    "sqrt": (op.NodeType.Sqrtabs, SQRT),
    "square": (op.NodeType.Square, SQUARE),
}
_CODES = dict(FUNCTIONS.values())


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
    """How a search breeds, and when it ends: generations, an error that is good enough, or ``patience`` without gain.

    functions : of `FUNCTIONS`. rows : samples, drawn at random, that formulas are judged on: few, so that many can be.
    scaled : judged by 1 - R2 after a factor and a shift, else by the plain sum of squares.
    tournament : individuals of which the best becomes a parent; 0: roulette, the elite of the paper and no other
    mutation than a new subtree. local : Levenberg-Marquardt steps on the constants of every offspring.
    """

    functions: tuple[str, ...] = ("add", "sub", "mul", "div", "sin", "cos", "tanh", "square")
    nodes: int = 20
    rows: int = 300
    scaled: bool = True
    tournament: int = 5
    local: int = 3
    crossover: float = 1.0
    mutation: float = 0.25
    population: int = 250
    generations: int = 100
    good_enough: float = 2e-7  # single precision tells 1 - R2 no better
    patience: int = 30
    least_gain: float = 1e-3  # of the best error, over ``patience`` generations


PAPER = Rules(
    functions=("add", "sub", "mul", "cos", "sin", "tanh"),
    rows=3000,
    scaled=False,
    tournament=0,
    local=0,
    crossover=0.8,
    mutation=0.03,
    population=1000,
    good_enough=0.0,
)


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

    def front(self) -> list[Found]:
        """The best of every length that is better than all shorter ones, the shortest first."""
        answer: list[Found] = []
        for nodes in sorted(self.found):
            if not answer or self.found[nodes][0].error < answer[-1].error:
                answer.append(self.found[nodes][0])
        return answer

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

    def __init__(self, features: np.ndarray, target: np.ndarray, rules: Rules, seed: int):
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
        symbols = (*(FUNCTIONS[name][0] for name in rules.functions), op.NodeType.Constant, op.NodeType.Variable)
        self.problem.ConfigurePrimitiveSet(sum(int(s) for s in symbols))
        self.symbols = self.problem.PrimitiveSet  # a copy: taken after it was configured
        self.creator = op.BalancedTreeCreator(self.symbols, self.inputs, 0.0)
        self.values = op.NormalCoefficientInitializer()
        self.values.ParameterizeDistribution(0, 1)
        self.table = op.DispatchTable()
        self.metric = op.R2() if rules.scaled else op.SSE()
        self.evaluator = op.Evaluator(self.problem, self.table, self.metric, rules.scaled)
        self.evaluator.Budget = 2**60
        self.order = op.SingleObjectiveComparison(0)
        depth = DEPTH if rules.tournament else rules.nodes
        self.crossover = op.SubtreeCrossover(0.9, depth, rules.nodes)
        self.mutations = self._mutations(depth, rules)
        self.mutation = self.mutations[0]
        if rules.tournament:
            self.selector = op.TournamentSelector(self.order)
            self.selector.TournamentSize = rules.tournament
            self.reinserter = op.KeepBestReinserter(self.order)
            self.mutation = op.MultiMutation()
            for one in self.mutations:
                self.mutation.Add(one, 1.0)
        else:
            self.selector = op.ProportionalSelector(self.order)
            self.reinserter = op.ReplaceWorstReinserter(self.order)
        self.optimizer = op.LMOptimizer(self.table, self.problem, rules.local, 0)
        self.local = op.CoefficientOptimizer(self.optimizer)
        self.generator = op.BasicOffspringGenerator(
            self.evaluator, self.crossover, self.mutation, self.selector, self.selector, self.local
        )
        self.first = op.UniformLengthTreeInitializer(self.creator)
        self.first.ParameterizeDistribution(1, min(rules.nodes, FIRST_NODES) if rules.tournament else rules.nodes)
        self.first.MinDepth, self.first.MaxDepth = 1, 1000
        self.config = op.GeneticAlgorithmConfig(
            generations=STRETCH,
            max_evaluations=2**60,
            local_iterations=rules.local,
            population_size=rules.population,
            pool_size=rules.population - (0 if rules.tournament else round(ELITE * rules.population)),
            p_crossover=rules.crossover,
            p_mutation=rules.mutation,
            p_local=1.0 if rules.local else 0.0,
            p_lamarck=1.0 if rules.local else 0.0,
            epsilon=1e-12,
            seed=seed,
            max_time=2**40,
        )
        self.search = op.GeneticProgrammingAlgorithm(
            self.config, self.problem, self.first, self.values, self.generator, self.reinserter
        )
        self.random = op.RandomGenerator(np.uint64(seed))

    def _mutations(self, depth: int, rules: Rules) -> list:
        """A new subtree, and for tournaments changed values, other variables and functions, more and fewer nodes."""
        new = op.ReplaceSubtreeMutation(self.creator, self.values, depth, rules.nodes)
        if not rules.tournament:
            return [new]
        one, all_ = op.NormalOnePointMutation(), op.NormalMultiPointMutation()
        for values in (one, all_):
            values.ParameterizeDistribution(0, 1)
        more = op.InsertSubtreeMutation(self.creator, self.values, depth, rules.nodes)
        other = op.ChangeVariableMutation(self.inputs), op.ChangeFunctionMutation(self.symbols)
        return [new, one, all_, *other, more, op.RemoveSubtreeMutation(self.symbols)]

    @property
    def evaluations(self) -> int:
        """Of the residuals and of their slopes, those of the steps on the constants among them."""
        return self.evaluator.ResidualEvaluations + self.evaluator.JacobianEvaluations

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
    until: float = np.inf,
    output: str = "",
    progress: Callable | None = None,
) -> list[float]:
    """Run one search into ``archive``; answers the best error of every generation.

    features (n, nf), target (n,). until : `time.monotonic()` at which to stop. ``progress`` gets a `SearchProgress`
    for every generation, in this thread. Ctrl-C passes through after at most `STRETCH` generations; the
    archive holds what was found.
    """
    population = _Population(features, target, rules, seed)
    history: list[float] = []
    started, spent, generations = time.monotonic(), time.process_time(), 0
    while True:
        seen = _run_stretch(population, target, archive, seed, generations, rules.scaled)
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
            archive.evaluations = before + population.evaluations
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
        if errors[k] < NONE and archive.wants(tree.Length, errors[k]):
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
