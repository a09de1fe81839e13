"""Inductive invariants of protocols with any number of parties, checked with z3.

A model describes a protocol by functions over sorts. Nothing says how many elements a sort has. An action
is a guard and a change of the functions, for parameters that the environment chooses. An invariant is a
formula about some elements. It is *inductive* if it holds in the initial states and if no action leads from
a state that satisfies all invariants to one that violates it. For each action and invariant the solver is
asked for such a step; that there is none proves the invariant for every number of elements and every order
of actions.

The formulas are written once and are read in three ways:

* over unbounded sorts, with quantifiers, for the proofs (`Unbounded`);
* over a few elements, with the quantifiers written out, where the solver always decides: for
  counterexamples and to show that an action is possible (`Bounded`);
* over Python values, for runs of named actions from an initial state (`Concrete`).

Limits are given in the solver's resource units, which do not depend on the speed of the machine.
"""

from __future__ import annotations

import functools
import itertools
import pathlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction

import z3

NUMBERS = ("Int", "Real")
"""Sorts with infinitely many values of their own."""
PROOF_LIMIT = 60_000_000
"""Resource units for one obligation."""
SEARCH_LIMIT = 30_000_000
"""Resource units for one search among few elements."""


# Terms. Each function returns a Python value if its arguments are Python values, and an expression otherwise.


def _flat(terms):
    for term in terms:
        if isinstance(term, (list, tuple)):
            yield from _flat(term)
        else:
            yield term


def all_of(*terms):
    """Returns the conjunction of terms, or of lists of them."""
    kept = []
    for term in _flat(terms):
        if isinstance(term, bool):
            if not term:
                return False
        else:
            kept.append(term)
    if not kept:
        return True
    return kept[0] if len(kept) == 1 else z3.And(kept)


def any_of(*terms):
    """Returns the disjunction of terms, or of lists of them."""
    kept = []
    for term in _flat(terms):
        if isinstance(term, bool):
            if term:
                return True
        else:
            kept.append(term)
    if not kept:
        return False
    return kept[0] if len(kept) == 1 else z3.Or(kept)


def no(term):
    """Returns the negation of a term."""
    return not term if isinstance(term, bool) else z3.Not(term)


def implies(premise, conclusion):
    """Returns the term that the premise implies the conclusion."""
    if isinstance(premise, bool):
        return conclusion if premise else True
    if isinstance(conclusion, bool):
        return True if conclusion else z3.Not(premise)
    return z3.Implies(premise, conclusion)


def choose(test, yes, otherwise):
    """Returns `yes` where the test holds, and `otherwise` elsewhere."""
    if isinstance(test, bool):
        return yes if test else otherwise
    return z3.If(test, yes, otherwise)


def put(function, at, value):
    """Returns a function with another value at one place."""
    at = at if isinstance(at, tuple) else (at,)
    return lambda *xs: choose(all_of([x == a for x, a in zip(xs, at, strict=True)]), value, function(*xs))


def where(function, test, value):
    """Returns a function with another value wherever a test holds; the value may be a function, too."""
    value_at = value if callable(value) else lambda *_: value
    return lambda *xs: choose(test(*xs), value_at(*xs), function(*xs))


def fixed(value):
    """Returns a function without arguments."""
    return lambda: value


# Domains: how sorts, functions and quantifiers are read.


class Unbounded:
    """Reads sorts as sets of any size."""

    def __init__(self):
        self.sorts = {"Bool": z3.BoolSort(), "Int": z3.IntSort(), "Real": z3.RealSort()}
        self.closures: list = []

    def sort(self, name: str):
        if name not in self.sorts:
            self.sorts[name] = z3.DeclareSort(name)
        return self.sorts[name]

    def function(self, name: str, signature: tuple):
        if len(signature) == 1:
            value = z3.Const(name, self.sort(signature[0]))
            self.close(name, signature, fixed(value))
            return fixed(value)
        function = z3.Function(name, *(self.sort(s) for s in signature))
        self.close(name, signature, function)
        return function

    def close(self, name, signature, function):
        """Nothing restricts the values of a function here."""

    def parameter(self, name: str, sort):
        if isinstance(sort, tuple):
            return self.function(name, sort)
        return self.function(name, (sort,))()

    def forall(self, sorts, body):
        xs = [z3.FreshConst(self.sort(s), s[0].lower()) for s in sorts]
        term = body(*xs)
        return term if isinstance(term, bool) else z3.ForAll(xs, term)

    def exists(self, sorts, body):
        xs = [z3.FreshConst(self.sort(s), s[0].lower()) for s in sorts]
        term = body(*xs)
        return term if isinstance(term, bool) else z3.Exists(xs, term)


@functools.cache
def _enumeration(name: str, size: int):
    """Returns a sort with so many elements, and the elements. The solver permits only one of a name."""
    return z3.EnumSort(f"{name}Of{size}", [f"{name.lower()}{i}of{size}" for i in range(size)])


class Bounded(Unbounded):
    """Reads each sort as a set of a few elements, and integers in quantifiers as a few numbers from zero."""

    def __init__(self, sizes: dict, default: int, numbers: int):
        super().__init__()
        self.sizes, self.default, self.numbers = sizes, default, numbers
        self.members: dict = {}

    def elements(self, name: str) -> list:
        if name == "Int":
            return [z3.IntVal(i) for i in range(self.numbers + 1)]
        if name == "Bool":
            return [z3.BoolVal(False), z3.BoolVal(True)]
        if name not in self.members:
            size = self.sizes.get(name, self.default)
            self.sorts[name], self.members[name] = _enumeration(name, size)
        return self.members[name]

    def sort(self, name: str):
        if name not in self.sorts:
            self.elements(name)
        return self.sorts[name]

    def forall(self, sorts, body):
        if "Real" in sorts:
            return super().forall(sorts, body)
        return all_of([body(*xs) for xs in itertools.product(*map(self.elements, sorts))])

    def exists(self, sorts, body):
        if "Real" in sorts:
            return super().exists(sorts, body)
        return any_of([body(*xs) for xs in itertools.product(*map(self.elements, sorts))])


class Concrete:
    """Reads sorts as lists of Python values."""

    def __init__(self, members: dict):
        self.members = members

    def forall(self, sorts, body):
        return all(body(*xs) for xs in itertools.product(*(self.members[s] for s in sorts)))

    def exists(self, sorts, body):
        return any(body(*xs) for xs in itertools.product(*(self.members[s] for s in sorts)))


class State:
    """The functions of a model at one moment. They are read as attributes."""

    def __init__(self, domain, functions: dict):
        self._domain, self._functions = domain, functions

    def __getattr__(self, name: str):
        try:
            return self._functions[name]
        except KeyError:
            raise AttributeError(name) from None

    def but(self, **changes) -> State:
        """Returns the state with some functions replaced."""
        for name in changes:
            if name not in self._functions:
                raise AttributeError(name)
        return State(self._domain, self._functions | changes)

    def every(self, sorts: str, body):
        """Returns the term that a body holds for all elements of sorts, named in one string."""
        return self._domain.forall(sorts.split(), body)

    def some(self, sorts: str, body):
        """Returns the term that a body holds for some elements of sorts."""
        return self._domain.exists(sorts.split(), body)


# Models.


@dataclass
class Invariant:
    """A formula about some elements. One that `is_goal` is what the model is there to show."""

    name: str
    sorts: list
    body: Callable
    is_goal: bool = False


@dataclass
class Action:
    """A step of the protocol or of its environment: for each choice of parameters a guard and the state
    after it."""

    name: str
    sorts: list
    body: Callable


@dataclass
class Model:
    """A protocol with its invariants."""

    name: str
    rigid: dict = field(default_factory=dict)
    state: dict = field(default_factory=dict)
    axioms: Callable = lambda s: []
    initial: Callable = lambda s: []
    invariants: list = field(default_factory=list)
    actions: dict = field(default_factory=dict)
    sizes: dict = field(default_factory=dict)
    bounds: Callable = lambda s: []
    """Terms for searches among few elements only. They see to it that all numbers about which an invariant
    says something are among those for which it is written out."""
    numbers: int = 3

    def invariant(self, name: str, sorts: str, is_goal: bool = False):
        """Registers the function below it as an invariant."""

        def register(body):
            self.invariants.append(Invariant(name, sorts.split(), body, is_goal))
            return body

        return register

    def goal(self, name: str, sorts: str):
        """Registers the function below it as an invariant that is to be shown."""
        return self.invariant(name, sorts, True)

    def action(self, *sorts):
        """Registers the function below it as an action, under its own name."""

        def register(body):
            self.actions[body.__name__] = Action(body.__name__, list(sorts), body)
            return body

        return register

    def signatures(self) -> dict:
        return self.rigid | self.state

    def begin(self, domain) -> State:
        """Returns a state about which nothing is known."""
        functions = {name: domain.function(name, sig) for name, sig in self.signatures().items()}
        return State(domain, functions)


@dataclass
class Result:
    """The answer of the solver to one obligation."""

    invariant: str
    action: str
    is_proved: bool
    answer: str
    millis: float


def _parts(term):
    """Splits a term into conjuncts, also below implications. Each becomes a quantifier of its own, which
    the solver then needs fewer terms to apply."""
    if isinstance(term, bool):
        return [] if term else [z3.BoolVal(False)]
    if z3.is_and(term):
        return [part for child in term.children() for part in _parts(child)]
    if z3.is_implies(term):
        return [z3.Implies(term.arg(0), part) for part in _parts(term.arg(1))]
    return [term]


def _assumed(domain, state: State, invariant: Invariant) -> list:
    """Returns the terms that an invariant holds for all elements."""
    if isinstance(domain, Bounded):
        return [domain.forall(invariant.sorts, lambda *xs: invariant.body(state, *xs))]
    xs = [z3.FreshConst(domain.sort(s), s[0].lower()) for s in invariant.sorts]
    parts = _parts(invariant.body(state, *xs))
    return [z3.ForAll(xs, part) for part in parts] if xs else parts


def _violated(domain, state: State, invariant: Invariant):
    """Returns the term that an invariant fails for some elements."""
    xs = [domain.parameter(f"for_{s.lower()}{i}", s) for i, s in enumerate(invariant.sorts)]
    return no(invariant.body(state, *xs))


def _terms(*terms) -> list:
    """Returns terms that a solver takes."""
    return [z3.BoolVal(term) if isinstance(term, bool) else term for term in _flat(terms)]


def _apply(domain, state: State, action: Action):
    """Applies an action with parameters that may be anything."""
    parameters = [domain.parameter(f"{action.name}_{i}", sort) for i, sort in enumerate(action.sorts)]
    return action.body(state, *parameters)


def _prover(by_models: bool = False) -> z3.Solver:
    solver = z3.Solver()
    # A proof needs no models: instances that match patterns are found faster and suffice.
    solver.set("auto_config", False)
    solver.set("smt.mbqi", by_models)
    solver.set("smt.random_seed", 0)
    solver.set("rlimit", PROOF_LIMIT)
    return solver


def _searcher() -> z3.Solver:
    solver = z3.Solver()
    solver.set("smt.random_seed", 0)
    solver.set("rlimit", SEARCH_LIMIT)
    return solver


def obligations(model: Model):
    """Yields for each obligation the names of invariant and action, and the terms that must contradict each
    other."""
    domain = Unbounded()
    state = model.begin(domain)
    axioms = _terms(model.axioms(state))
    initial = _terms(model.initial(state))
    for invariant in model.invariants:
        yield invariant.name, "initially", axioms + initial + _terms(_violated(domain, state, invariant))
    assumed = [term for invariant in model.invariants for term in _assumed(domain, state, invariant)]
    for action in model.actions.values():
        guard, after = _apply(domain, state, action)
        for invariant in model.invariants:
            refuted = _violated(domain, after, invariant)
            yield invariant.name, action.name, axioms + assumed + _terms(guard, refuted)


def prove(model: Model, smt: pathlib.Path | None = None) -> list:
    """Checks all obligations of a model. Writes each as SMT-LIB text to a directory, if one is given."""
    results = []
    for number, (invariant, action, terms) in enumerate(obligations(model)):
        begun = time.perf_counter()
        solver = _prover()
        solver.add(*terms)
        answer = solver.check()
        if answer != z3.unsat:
            by_models = _prover(by_models=True)
            by_models.add(*terms)
            answer = by_models.check()
        millis = (time.perf_counter() - begun) * 1000
        results.append(Result(invariant, action, answer == z3.unsat, str(answer), millis))
        if smt:
            words = "-".join(invariant.replace(",", "").split())
            name = f"{model.name}-{number:03}-{action}-{words}"
            (smt / f"{name}.smt2").write_text("(set-logic ALL)\n" + solver.to_smt2())
    return results


# Searches among few elements.


@dataclass
class Counterexample:
    """A step that violates an invariant although all invariants held before it."""

    invariant: str
    action: str
    text: str


def _bounded(model: Model, elements: int):
    domain = Bounded(model.sizes, elements, model.numbers)
    state = model.begin(domain)
    return domain, state, _terms(model.axioms(state), model.bounds(state))


def possible(model: Model, elements: int = 3) -> dict:
    """Returns for each action what the solver says about a state of few elements that permits it."""
    domain, state, axioms = _bounded(model, elements)
    assumed = [term for invariant in model.invariants for term in _assumed(domain, state, invariant)]
    found = {}
    for action in model.actions.values():
        guard, after = _apply(domain, state, action)
        solver = _searcher()
        solver.add(*axioms, *_terms(assumed), *_terms(guard, model.bounds(after)))
        found[action.name] = str(solver.check())
    return found


def counterexample(model: Model, only: list | None = None, elements: int = 3) -> Counterexample | None:
    """Returns a step among few elements that violates an invariant. `only` lists pairs of actions and
    invariants."""
    domain, state, axioms = _bounded(model, elements)
    assumed = _terms([term for invariant in model.invariants for term in _assumed(domain, state, invariant)])
    by_name = {invariant.name: invariant for invariant in model.invariants}
    pairs = only or [(action, invariant) for action in model.actions for invariant in by_name]
    for action, invariant in pairs:
        guard, after = _apply(domain, state, model.actions[action])
        solver = _searcher()
        solver.add(*axioms, *assumed, *_terms(guard, _violated(domain, after, by_name[invariant])))
        if solver.check() == z3.sat:
            text = _describe(model, domain, state, after, model.actions[action], invariant, solver.model())
            return Counterexample(invariant, action, text)
    return None


def _describe(model, domain, state, after, action, invariant, found) -> str:
    """Writes out a counterexample: the parameters, the state before the step, and what it changes."""
    lines = [f'{action.name} violates "{invariant}"']
    for i, sort in enumerate(action.sorts):
        if isinstance(sort, str):
            value = found.eval(domain.parameter(f"{action.name}_{i}", sort), model_completion=True)
            lines.append(f"  {sort} {value}")
    for name, signature in model.signatures().items():
        rows = []
        for xs in itertools.product(*(domain.elements(s) for s in signature[:-1] if s != "Real")):
            if "Real" in signature[:-1]:
                continue
            before = found.eval(getattr(state, name)(*xs), model_completion=True)
            later = getattr(after, name)(*xs)
            later = later if not z3.is_expr(later) else found.eval(later, model_completion=True)
            change = "" if str(before) == str(later) else f" -> {later}"
            if change or str(before) not in ("False", "0"):
                rows.append(f"{', '.join(map(str, xs))}: {before}{change}".lstrip(": "))
        if rows:
            lines.append(f"  {name}  " + "; ".join(rows))
    return "\n".join(lines)


# Runs.


class RunError(Exception):
    """A guard of a run was false."""


class Run:
    """A run of a model over Python values: named actions one after the other, from an initial state."""

    def __init__(self, model: Model, members: dict, functions: dict):
        self.model = model
        self.domain = Concrete(members)
        defaults = {"Bool": False, "Int": 0, "Real": Fraction(0)}
        given = {}
        for name, signature in model.signatures().items():
            value = defaults.get(signature[-1])
            if value is None:
                value = members[signature[-1]][0]
            given[name] = functions.get(name, lambda *_, value=value: value)
        self.state = State(self.domain, given)
        self.taken: list = []
        for number, term in enumerate(
            [*_flat([model.axioms(self.state)]), *_flat([model.initial(self.state)])]
        ):
            if term is not True:
                raise RunError(f"assumption {number} is false in the initial state")

    def do(self, name: str, *parameters):
        """Takes an action. Its guard must be true."""
        guard, after = self.model.actions[name].body(self.state, *parameters)
        if guard is not True:
            raise RunError(f"step {len(self.taken) + 1}: {name}{parameters}")
        before, changed = self.state._functions, after._functions
        kept = {}
        for key, function in changed.items():
            kept[key] = function if function is before[key] else functools.cache(function)
        self.state = State(self.domain, kept)
        self.taken.append(name)

    def broken(self, names: list | None = None) -> list:
        """Returns the invariants that are false, each with the elements for which it is."""
        found = []
        for invariant in self.model.invariants:
            if names is not None and invariant.name not in names:
                continue
            for xs in itertools.product(*(self.domain.members[s] for s in invariant.sorts)):
                if invariant.body(self.state, *xs) is not True:
                    found.append((invariant.name, xs))
                    break
        return found


@dataclass
class Refusal:
    """How a defect is refused."""

    defect: str
    by: str
    invariant: str
    text: str


@dataclass
class Part:
    """A model and its defects."""

    name: str
    title: str
    build: Callable
    refusals: dict
    """For each defect the pairs of actions and invariants among which the solver is to find a
    counterexample."""
    found: dict = field(default_factory=dict)
    """Those of the defects that the proof has found in the code, which is without them now, and what they
    were."""
    runs: dict = field(default_factory=dict)
    """For some defects a run, made by a function of the defect, after which what is to be shown is false.
    Without the defect the run must be impossible."""
    complete_run: Callable | None = None
    """A run that takes every action, after which all invariants are true."""
    elements: int = 3

    def refuse(self, defect: str) -> Refusal | None:
        """Refuses a defect by a run or, if none is written, by a counterexample. Returns `None` if that
        fails."""
        if defect in self.runs:
            return self._refuse_by_run(defect, self.runs[defect])
        found = counterexample(self.build(defect), self.refusals[defect], self.elements)
        return found and Refusal(defect, "counterexample", found.invariant, found.text)

    def _refuse_by_run(self, defect: str, begin: Callable) -> Refusal | None:
        try:
            begin(None)
            return None
        except RunError:
            pass
        run = begin(defect)
        broken = run.broken([invariant.name for invariant in run.model.invariants if invariant.is_goal])
        if not broken:
            return None
        invariant, elements = broken[0]
        text = f"{' '.join(run.taken)}: false for {', '.join(map(str, elements))}"
        return Refusal(defect, f"run of {len(run.taken)} steps", invariant, text)

    def impossible(self) -> list:
        """Returns the actions that no state of few elements permits and that the complete run does not take
        either. Everything would be proved of these."""
        found = possible(self.build(), self.elements)
        run = self.complete_run() if self.complete_run else None
        taken = run.taken if run else []
        missed = [name for name, answer in found.items() if answer != "sat" and name not in taken]
        if run:
            missed += [name for name in found if name not in taken]
            missed += [f"false after the complete run: {invariant}" for invariant, _ in run.broken()]
        return missed
