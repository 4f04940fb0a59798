"""Generated domains and problems that are free of errors, for property tests."""

from __future__ import annotations

from dataclasses import dataclass, field

from hypothesis import strategies as st

from menid_plan.model.domain import (
    OBJECT,
    DerivedPredicate,
    Domain,
    Environment,
    Object,
    Param,
    Predicate,
    Problem,
    StateReward,
    Type,
)
from menid_plan.model.expressions import Arithmetic, Expression, Minus, Number, ParamName
from menid_plan.model.formulas import (
    And,
    Atom,
    Constant,
    Count,
    Equality,
    Exists,
    ForAll,
    Formula,
    GroundAtom,
    Implies,
    Not,
    Or,
    Term,
    Truth,
    TypedVariable,
    Variable,
)
from menid_plan.model.rules import (
    NOISE,
    Action,
    Block,
    ConditionalEffect,
    Effect,
    Literal,
    Outcome,
    Reference,
    Rule,
    UniversalEffect,
)

Draw = st.DrawFn
Types = tuple[str, ...]

docs = st.one_of(
    st.just(""),
    st.lists(st.text("abc äé#:{}", max_size=12).map(str.rstrip), min_size=1, max_size=2)
    .map("\n".join)
    .filter(bool),
)


@dataclass
class World:
    """What has been generated so far."""

    parents: dict[str, str] = field(default_factory=dict)
    predicates: dict[str, tuple[Types, ...]] = field(default_factory=dict)
    derived: dict[str, tuple[Types, ...]] = field(default_factory=dict)
    objects: dict[str, str] = field(default_factory=dict)
    params: list[str] = field(default_factory=list)
    environments: tuple[str, ...] = ()

    def ancestors(self, name: str) -> set[str]:
        found = {name, OBJECT}
        while name != OBJECT:
            name = self.parents[name]
            found.add(name)
        return found

    def fits(self, given: Types, asked: Types) -> bool:
        return all(self.ancestors(g) & set(asked) for g in given)


@st.composite
def types_of(draw: Draw, world: World) -> Types:
    names = [OBJECT, *world.parents]
    return tuple(draw(st.lists(st.sampled_from(names), min_size=1, max_size=2, unique=True)))


@st.composite
def variables(draw: Draw, world: World, scope: dict[str, Types]) -> tuple[TypedVariable, ...]:
    count = draw(st.integers(1, 2))
    return tuple(TypedVariable(f"v{len(scope) + i}", draw(types_of(world))) for i in range(count))


def scope_with(scope: dict[str, Types], declared: tuple[TypedVariable, ...]) -> dict[str, Types]:
    return {**scope, **{v.name: v.types for v in declared}}


def terms(world: World, scope: dict[str, Types], asked: Types) -> list[Term]:
    found: list[Term] = [Variable(n) for n, types in scope.items() if world.fits(types, asked)]
    found += [Constant(n) for n, type_ in world.objects.items() if world.fits((type_,), asked)]
    return found


@st.composite
def atoms(
    draw: Draw, world: World, scope: dict[str, Types], predicates: dict[str, tuple[Types, ...]]
) -> Atom | None:
    choices = {
        name: [terms(world, scope, asked) for asked in arguments]
        for name, arguments in predicates.items()
    }
    usable = [name for name, arguments in choices.items() if all(arguments)]
    if not usable:
        return None
    name = draw(st.sampled_from(usable))
    return Atom(name, tuple(draw(st.sampled_from(options)) for options in choices[name]))


@st.composite
def formulas(
    draw: Draw,
    world: World,
    scope: dict[str, Types],
    depth: int = 2,
    predicates: dict[str, tuple[Types, ...]] | None = None,
) -> Formula:
    usable = {**world.predicates, **world.derived} if predicates is None else predicates
    kinds = ["atom", "atom", "equality", "truth"]
    if depth > 0:
        kinds += ["not", "and", "or", "implies", "exists", "forall", "count"]
    kind = draw(st.sampled_from(kinds))
    if kind == "atom":
        return draw(atoms(world, scope, usable)) or Truth(True)
    if kind == "equality":
        options = terms(world, scope, (OBJECT,))
        if not options:
            return Truth(False)
        return Equality(draw(st.sampled_from(options)), draw(st.sampled_from(options)))
    if kind == "truth":
        return Truth(draw(st.booleans()))
    if kind in ("exists", "forall", "count"):
        declared = draw(variables(world, scope))
        body = draw(formulas(world, scope_with(scope, declared), depth - 1, usable))
        if kind == "exists":
            return Exists(declared, body)
        if kind == "forall":
            return ForAll(declared, body)
        comparison = draw(st.sampled_from(["=", "!=", "<", "<=", ">", ">="]))
        return Count(declared, body, comparison, draw(st.integers(0, 3)))
    below = formulas(world, scope, depth - 1, usable)
    if kind == "not":
        return Not(draw(below))
    if kind == "implies":
        return Implies(draw(below), draw(below))
    parts = draw(st.lists(below, min_size=2, max_size=3))
    # `a and (b and c)` is read as written, but `(a and b) and c` needs its parentheses too.
    return And(tuple(parts)) if kind == "and" else Or(tuple(parts))


@st.composite
def expressions(draw: Draw, world: World, depth: int = 2) -> Expression:
    kinds = ["number", "number"] + ["param"] * bool(world.params)
    if depth > 0:
        kinds += ["minus", "sum", "quotient"]
    kind = draw(st.sampled_from(kinds))
    if kind == "number":
        return Number(draw(st.sampled_from([0.0, 1.0, 2.5, 10.0, 0.001, 1e-7, 123456.789])))
    if kind == "param":
        return ParamName(draw(st.sampled_from(world.params)))
    below = expressions(world, depth - 1)
    if kind == "minus":
        return Minus(draw(below))
    if kind == "sum":
        operator = draw(st.sampled_from(["+", "-", "*"]))
        return Arithmetic(operator, draw(below), draw(below))
    return Arithmetic("/", draw(below), Number(draw(st.sampled_from([2.0, 0.5]))))


@st.composite
def literals(draw: Draw, world: World, scope: dict[str, Types]) -> tuple[Literal, ...]:
    count = draw(st.integers(1, 2))
    found = [draw(atoms(world, scope, world.predicates)) for _ in range(count)]
    return tuple(Literal(atom, draw(st.booleans())) for atom in found if atom is not None)


@st.composite
def effects(draw: Draw, world: World, scope: dict[str, Types]) -> tuple[Effect, ...]:
    found: list[Effect] = []
    for kind in draw(st.lists(st.sampled_from(["literal", "if", "forall"]), max_size=3)):
        if kind == "literal":
            found.extend(draw(literals(world, scope)))
            continue
        declared = draw(variables(world, scope)) if kind == "forall" else ()
        inner = scope_with(scope, declared)
        body = draw(literals(world, inner))
        condition = draw(formulas(world, inner, 1))
        if not body:
            continue
        if kind == "if":
            found.append(ConditionalEffect(condition, body))
        else:
            found.append(UniversalEffect(declared, condition, body))
    return tuple(found)


@st.composite
def columns(draw: Draw, rows: int) -> list[Expression]:
    """Cells that sum to 1."""
    cuts = sorted(draw(st.lists(st.integers(0, 20), min_size=rows - 1, max_size=rows - 1)))
    parts = [b - a for a, b in zip([0, *cuts], [*cuts, 20], strict=True)]
    style = draw(st.sampled_from(["decimal", "fraction", "difference"]))
    if style == "decimal":
        return [Number(part / 20) for part in parts]
    if style == "fraction":
        return [Arithmetic("/", Number(float(part)), Number(20.0)) for part in parts]
    return [Arithmetic("-", Number(1.0), Number(1 - part / 20)) for part in parts]


@st.composite
def rules(
    draw: Draw, world: World, name: str, parameters: tuple[TypedVariable, ...], otherwise: bool
) -> Rule:
    scope = scope_with({}, parameters)
    per: Types = ()
    if parameters and draw(st.booleans()):
        per = tuple(draw(st.permutations([v.name for v in parameters]))[: draw(st.integers(1, 2))])
    references = []
    condition: Formula = Truth(True)
    if not otherwise:
        for _ in range(draw(st.integers(0, 2))):
            declared = draw(variables(world, scope))
            scope = scope_with(scope, declared)
            references.append(Reference(declared, draw(formulas(world, scope, 1))))
        condition = draw(st.one_of(st.just(Truth(True)), formulas(world, scope)))
    names = [*(f"o{i}" for i in range(draw(st.integers(1, 3)))), NOISE]
    known = world.environments or ("target",)
    heads: Types = tuple(draw(st.lists(st.sampled_from(known), unique=True)))
    width = len(heads) or draw(st.integers(0, 1))
    table = [draw(columns(len(names))) for _ in range(width)]
    outcomes = tuple(
        Outcome(
            outcome,
            tuple(column[i] for column in table),
            () if outcome == NOISE else draw(effects(world, scope)),
            draw(st.one_of(st.none(), expressions(world))) if width or outcome != NOISE else None,
            draw(docs) if width or outcome != NOISE else "",
        )
        for i, outcome in enumerate(names)
    )
    blocks: dict[str, list[Block]] = {"probabilities": [], "observed": []}
    free = [e for e in known if e not in heads] if width else list(known)
    for kind in blocks:
        if kind == "observed" and not per:
            values: list[Types] = [()]
        else:
            values = [()] if kind == "probabilities" else []
            values += [tuple(f"x{i}{j}" for j in range(len(per))) for i in range(2)] if per else []
        for value in values:
            usable = known if value or kind == "observed" else free if heads or not width else []
            chosen = tuple(draw(st.lists(st.sampled_from(usable), unique=True))) if usable else ()
            if chosen and draw(st.booleans()):
                blocks[kind].append(draw(block(kind, chosen, value, names)))
    return Rule(
        name, outcomes, per, tuple(references), condition, otherwise, heads,
        tuple(blocks["probabilities"]), tuple(blocks["observed"]), draw(docs),
    )  # fmt: skip


@st.composite
def block(draw: Draw, kind: str, environments: Types, values: Types, names: list[str]) -> Block:
    if kind == "observed":
        rows = [
            (name, tuple(Number(float(draw(st.integers(0, 99)))) for _ in environments))
            for name in names
            if draw(st.booleans())
        ]
    else:
        table = [draw(columns(len(names))) for _ in environments]
        rows = [(name, tuple(c[i] for c in table)) for i, name in enumerate(names)]
    return Block(environments, values, tuple(rows), draw(docs))


@st.composite
def domains(draw: Draw) -> Domain:
    world = World()
    types = []
    for i in range(draw(st.integers(0, 3))):
        parent = draw(st.sampled_from([OBJECT, *world.parents]))
        world.parents[f"t{i}"] = parent
        types.append(Type(f"t{i}", parent, draw(docs)))
    constants = draw(objects(world, "c", draw(st.integers(0, 4))))
    params = []
    for i in range(draw(st.integers(0, 2))):
        params.append(Param(f"p-{i}", draw(expressions(world)), draw(docs)))
        world.params.append(f"p-{i}")
    environments = []
    for i in range(draw(st.integers(0, 3))):
        environments.append(Environment(f"e{i}", "test" if i else "target", draw(docs)))
    world.environments = tuple(e.name for e in environments)
    predicates = []
    for i in range(draw(st.integers(1, 3))):
        arguments = tuple(draw(types_of(world)) for _ in range(draw(st.integers(0, 2))))
        world.predicates[f"q{i}"] = arguments
        predicates.append(Predicate(f"q{i}", arguments, draw(docs)))
    derived = []
    for i in range(draw(st.integers(0, 2))):
        parameters = draw(variables(world, {})) if draw(st.booleans()) else ()
        formula = draw(formulas(world, scope_with({}, parameters)))
        if draw(st.booleans()):  # recursion, in a positive place
            own = Atom(f"d{i}", tuple(Variable(v.name) for v in parameters))
            formula = Or((formula, own))
        derived.append(DerivedPredicate(f"d{i}", parameters, formula, draw(docs)))
        world.derived[f"d{i}"] = tuple(v.types for v in parameters)
    rewards = []
    for _ in range(draw(st.integers(0, 1))):
        declared = draw(variables(world, {})) if draw(st.booleans()) else ()
        condition = draw(formulas(world, scope_with({}, declared)))
        rewards.append(StateReward(draw(expressions(world)), condition, declared, draw(docs)))
    actions = []
    for i in range(draw(st.integers(0, 2))):
        parameters = draw(variables(world, {})) if draw(st.booleans()) else ()
        count = draw(st.integers(1, 2))
        made = tuple(
            draw(rules(world, f"r{j}", parameters, j == 1 and draw(st.booleans())))
            for j in range(count)
        )
        cost = draw(st.one_of(st.none(), expressions(world)))
        actions.append(Action(f"a{i}", made, parameters, cost, draw(docs)))
    return Domain(
        "gen", tuple(types), tuple(constants), tuple(params), tuple(environments),
        tuple(predicates), tuple(derived), tuple(rewards), tuple(actions), draw(docs),
    )  # fmt: skip


@st.composite
def objects(draw: Draw, world: World, prefix: str, count: int) -> list[Object]:
    found = []
    for i in range(count):
        type_ = draw(st.sampled_from([OBJECT, *world.parents]))
        attributes = draw(
            st.lists(
                st.tuples(st.sampled_from(["x", "pascal"]), st.sampled_from([-1135.0, 0.0, 2.5])),
                max_size=2,
                unique_by=lambda pair: pair[0],
            )
        )
        found.append(Object(f"{prefix}{i}", type_, tuple(attributes), draw(docs)))
        world.objects[f"{prefix}{i}"] = type_
    return found


def world_of(domain: Domain) -> World:
    return World(
        {t.name: t.parent for t in domain.types},
        {p.name: p.arguments for p in domain.predicates},
        {d.name: tuple(v.types for v in d.parameters) for d in domain.derived},
        {c.name: c.type for c in domain.constants},
        [p.name for p in domain.params],
        tuple(e.name for e in domain.environments),
    )


@st.composite
def problems(draw: Draw, domain: Domain, max_objects: int = 5) -> Problem:
    world = world_of(domain)
    made = draw(objects(world, "b", draw(st.integers(0, max_objects))))
    init: dict[GroundAtom, None] = {}
    for _ in range(draw(st.integers(0, 4))):
        atom = draw(atoms(world, {}, world.predicates))
        if atom is not None:
            init[GroundAtom(atom.predicate, tuple(t.name for t in atom.arguments))] = None
    goal = draw(st.one_of(st.none(), formulas(world, {})))
    return Problem(
        "task", domain.name, (), tuple(made), tuple(init), goal,
        draw(st.one_of(st.none(), expressions(world))) if goal is not None else None,
        draw(st.one_of(st.none(), st.integers(0, 100))),
        draw(st.one_of(st.none(), st.sampled_from([0.0, 0.5, 0.99, 1.0]))),
        draw(st.one_of(st.none(), expressions(world))),
        draw(docs),
    )  # fmt: skip


@st.composite
def domains_with_problems(draw: Draw) -> tuple[Domain, Problem]:
    domain = draw(domains())
    return domain, draw(problems(domain))


__all__ = ["domains", "domains_with_problems", "problems"]
