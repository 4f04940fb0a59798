"""Families of models that grow: each as MENID and, of the same states and transitions, as PRISM.

Both texts are written as one would write them by hand. PRISM has integers where MENID has one atom
for each value, and no recursion; its expressions are those that are fastest for Storm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Model:
    """One model: its texts, and what is asked of it in either language.

    ``sign`` turns Storm's value into ours: costs are negative rewards here.
    """

    name: str
    size: int
    domain: str
    problem: str
    prism: str
    formula: str
    objective: str
    sign: int

    @property
    def text(self) -> str:
        """Domain and problem in one file."""
        return self.domain + "\n" + self.problem


# ---------------------------------------------------------------------------------- machines


def machines(
    size: int, discount: float = 1.0, faults: int | None = None, derived: bool = False
) -> Model:
    """A ring of machines: all sets of at most so many broken ones (by default 2^size states).

    With ``derived`` the domain asks by derived predicates what it otherwise asks directly.
    """
    broken = size if faults is None else faults
    domain = """\
# Bring all the machines of a ring into working order.
domain machines

type machine
predicate next(machine, machine)
predicate broken(machine)

# Hammering at one machine may put the next one out of order.
action repair(m: machine) cost 1 {
  rule beside-one-that-works {
    the n: machine where next(m, n)
    when broken(m) and not broken(n)
    outcomes {
      fixed:  0.75  not broken(m)
      shaken: 0.15  not broken(m), broken(n)
      failed: 0.10  nothing
    }
  }
  rule beside-a-broken-one {
    the n: machine where next(m, n)
    when broken(m) and broken(n)
    outcomes {
      fixed:  0.9  not broken(m)
      failed: 0.1  nothing
    }
  }
}

# The gentle way.
action overhaul(m: machine) cost 1.3 {
  rule overhaul {
    when broken(m)
    outcomes { done: 1  not broken(m) }
  }
}
"""
    if derived:
        domain = domain.replace(
            "predicate broken(machine)\n",
            "predicate broken(machine)\n"
            "derived works(m: machine) = not broken(m)\n"
            "derived idle(m: machine) = not works(m)\n"
            "derived beside(m: machine) = exists n: machine (next(m, n) and idle(n))\n",
        )
        domain = domain.replace(
            "when broken(m) and not broken(n)", "when idle(m) and not beside(m)"
        )
        domain = domain.replace("when broken(m) and broken(n)", "when idle(m) and beside(m)")
        domain = domain.replace("when broken(m)\n", "when idle(m)\n")
    ring = ", ".join(f"next(m{i}, m{(i + 1) % size})" for i in range(size))
    problem = f"""\
problem ring for machines
object m0..m{size - 1}: machine
init {ring}
init {", ".join(f"broken(m{i})" for i in range(broken))}
goal forall m: machine (not broken(m))
"""
    if discount < 1.0:
        problem += f"discount {discount}\n"
    lines = ["mdp", f"formula done = {' & '.join(f'!b{i}' for i in range(size))};", "module ring"]
    lines += [f"  b{i}: bool init {str(i < broken).lower()};" for i in range(size)]
    for i in range(size):
        n = (i + 1) % size
        fixed = f"(b{i}'=false)"
        lines += [
            f"  [repair] b{i} & !b{n} -> 0.75: {fixed} + 0.15: {fixed} & (b{n}'=true) + 0.1: true;",
            f"  [repair] b{i} & b{n} -> 0.9: {fixed} + 0.1: true;",
            f"  [overhaul] b{i} -> {fixed};",
        ]
    lines += ["endmodule", 'label "goal" = done;']
    lines += ['rewards "cost"', "  [repair] true: 1;", "  [overhaul] true: 1.3;", "endrewards"]
    formula = 'R{"cost"}min=? [F "goal"]'
    if discount < 1.0:
        formula = f'R{{"cost"}}min=? [Cdiscount={discount}]'
    objective = "goal-then-reward" if discount == 1.0 else "reward"
    return Model("machines", size, domain, problem, _text(lines), formula, objective, -1)


# -------------------------------------------------------------------------------------- walk


def walk(size: int) -> Model:
    """A fair walk on a line until either end: some (size / 2)^2 steps."""
    domain = """\
# Stagger along a line until one of its ends is reached.
domain walk

type cell
predicate next(cell, cell)
predicate end(cell)
predicate at(cell)

action walk cost 1 {
  rule walk {
    the c: cell where at(c)
    the l: cell where next(l, c)
    the r: cell where next(c, r)
    outcomes {
      left:  0.5  not at(c), at(l)
      right: 0.5  not at(c), at(r)
    }
  }
}

# Two cells at once, for the price of three.
action run cost 3 {
  rule run {
    the c: cell where at(c)
    the l: cell where next(l, c)
    the r: cell where next(c, r)
    the k: cell where next(k, l)
    the s: cell where next(r, s)
    outcomes {
      left:  0.5  not at(c), at(k)
      right: 0.5  not at(c), at(s)
    }
  }
}
"""
    middle = size // 2
    problem = f"""\
problem line for walk
object c0..c{size}: cell
init {", ".join(f"next(c{i}, c{i + 1})" for i in range(size))}
init end(c0), end(c{size}), at(c{middle})
goal exists c: cell (at(c) and end(c))
"""
    prism = f"""\
mdp
module line
  x: [0..{size}] init {middle};
  [walk] x > 0 & x < {size} -> 0.5: (x'=x-1) + 0.5: (x'=x+1);
  [run] x > 1 & x < {size - 1} -> 0.5: (x'=x-2) + 0.5: (x'=x+2);
endmodule
label "goal" = x = 0 | x = {size};
rewards "cost"
  [walk] true: 1;
  [run] true: 3;
endrewards
"""
    formula = 'R{"cost"}min=? [F "goal"]'
    return Model("walk", size, domain, problem, prism, formula, "goal-then-reward", -1)


# ------------------------------------------------------------------------------------- sheet


def sheet(size: int) -> Model:
    """A walk on size x size cells until a corner; the choice is along which axis, mostly."""
    domain = """\
# A ship without a keel tries to drift into a corner of a square basin.
domain sheet

type line
predicate next(line, line)
predicate corner(line)
predicate column(line)
predicate row(line)

action across cost 1 {
  rule across {
    outcomes {
      west:  0.4  forall a, b: line where column(a) and next(b, a) { not column(a), column(b) }
      east:  0.4  forall a, b: line where column(a) and next(a, b) { not column(a), column(b) }
      south: 0.1  forall a, b: line where row(a) and next(b, a) { not row(a), row(b) }
      north: 0.1  forall a, b: line where row(a) and next(a, b) { not row(a), row(b) }
    }
  }
}

action along cost 1 {
  rule along {
    outcomes {
      west:  0.1  forall a, b: line where column(a) and next(b, a) { not column(a), column(b) }
      east:  0.1  forall a, b: line where column(a) and next(a, b) { not column(a), column(b) }
      south: 0.4  forall a, b: line where row(a) and next(b, a) { not row(a), row(b) }
      north: 0.4  forall a, b: line where row(a) and next(a, b) { not row(a), row(b) }
    }
  }
}
"""
    last = size - 1
    problem = f"""\
problem basin for sheet
object l0..l{last}: line
init {", ".join(f"next(l{i}, l{i + 1})" for i in range(last))}
init corner(l0), column(l{last}), row(l{last})
goal exists l: line (corner(l) and column(l) and row(l))
"""
    west, east = "(x'=max(0,x-1))", f"(x'=min({last},x+1))"
    south, north = "(y'=max(0,y-1))", f"(y'=min({last},y+1))"
    prism = f"""\
mdp
formula done = x = 0 & y = 0;
module basin
  x: [0..{last}] init {last};
  y: [0..{last}] init {last};
  [] !done -> 0.4: {west} + 0.4: {east} + 0.1: {south} + 0.1: {north};
  [] !done -> 0.1: {west} + 0.1: {east} + 0.4: {south} + 0.4: {north};
endmodule
label "goal" = done;
rewards "cost"
  [] true: 1;
endrewards
"""
    formula = 'R{"cost"}min=? [F "goal"]'
    return Model("sheet", size, domain, problem, prism, formula, "goal-then-reward", -1)


# -------------------------------------------------------------------------------------- ring

_LIVE = {
    # As it is meant: a recursive derived predicate.
    "derived": """\
derived live(s: station) = not down(s) and
    (source(s) or exists t: station (line(s, t) and live(t)))
""",
    # The same without recursion, for those who know that it is a ring.
    "inlined": "",
}


def ring(size: int, faults: int = 3, live: str = "derived") -> Model:
    """A ring main of size stations of which some are down: all sets of at most so many faults.

    With ``live`` = "inlined" the recursion is replaced by what it comes to on a ring, written out in
    every condition.
    """
    if live == "derived":
        near = "exists t: station (line(s, t) and live(t))"
        alive = "live(z)"
    else:
        # Alive is what has no fault before it, or none behind it.
        alive = (
            "(forall y: station (upto(y, z) implies not down(y))"
            " or forall y: station (upto(z, y) implies not down(y)))"
        )
        near = f"exists z: station (line(s, z) and {alive})"
    dark = f"count z: station ({alive}) < {size // 2}"
    spare = f"count z: station ({alive}) >= {size // 3}"
    domain = f"""\
# A ring of stations that feed each other, from one source. Crews work where current arrives, and
# anywhere with a generator that a third of the stations can spare.
domain ring-main

type station
predicate line(station, station)
predicate after(station, station)
{"" if live == "derived" else "predicate upto(station, station)"}
predicate source(station)
predicate down(station)
{_LIVE[live]}
# While less than half of the stations have current.
reward -1 when {dark}

action repair(s: station) cost 1 {{
  rule overload {{
    the n: station where after(s, n)
    when down(s) and not (down(n) or source(n))
      and ({near} or {spare})
    outcomes {{
      repaired: 0.7  not down(s)
      passed:   0.2  not down(s), down(n)
      failed:   0.1  nothing
    }}
  }}
  rule safe {{
    the n: station where after(s, n)
    when down(s) and (down(n) or source(n))
      and ({near} or {spare})
    outcomes {{
      repaired: 0.9  not down(s)
      failed:   0.1  nothing
    }}
  }}
}}
"""
    pairs = [(i, (i + 1) % size) for i in range(size)]
    lines = ", ".join(f"line(s{i}, s{j}), line(s{j}, s{i})" for i, j in pairs)
    problem = f"""\
problem ring for ring-main
object s0..s{size - 1}: station
init {lines}
init {", ".join(f"after(s{i}, s{j})" for i, j in pairs)}
init source(s0), {", ".join(f"down(s{i})" for i in range(1, faults + 1))}
goal forall s: station (not down(s))
"""
    if live != "derived":
        order = ", ".join(f"upto(s{i}, s{j})" for j in range(size) for i in range(j + 1))
        problem += f"init {order}\n"
    first = "".join(f"d{i} ? {i} : (" for i in range(1, size)) + f"{size}" + ")" * (size - 1)
    last = "".join(f"d{i} ? {i} : (" for i in range(size - 1, 0, -1)) + "0" + ")" * (size - 1)
    text = [
        "mdp",
        f"formula first = {first};",
        f"formula last = {last};",
        f"formula done = {' & '.join(f'!d{i}' for i in range(1, size))};",
        f"formula alive = first > last ? {size} : first + {size - 1} - last;",
        "module ring",
    ]
    text += [f"  d{i}: bool init {'true' if i <= faults else 'false'};" for i in range(1, size)]
    for i in range(1, size):
        repaired, near = f"(d{i}'=false)", f"({i} <= first | {i} >= last | alive >= {size // 3})"
        whole = f"0.9: {repaired} + 0.1: true;"
        if i == size - 1:
            text += [f"  [] d{i} & {near} -> {whole}"]
        else:
            text += [
                f"  [] d{i} & !d{i + 1} & {near} -> 0.7: {repaired} + "
                f"0.2: {repaired} & (d{i + 1}'=true) + 0.1: true;",
                f"  [] d{i} & d{i + 1} & {near} -> {whole}",
            ]
    text += ["endmodule", 'label "goal" = done;', 'rewards "cost"', "  [] true: 1;"]
    text += [f"  alive < {size // 2}: 1;", "endrewards"]
    formula = 'R{"cost"}min=? [F "goal"]'
    return Model("ring", size, domain, problem, _text(text), formula, "goal-then-reward", -1)


# ----------------------------------------------------------------------------------- courier


def courier(size: int) -> Model:
    """A robot on size x size cells with holes; it may slip, and drop what it has to carry."""
    domain = """\
# Fetch a thing and carry it to the exit, over a slippery floor with holes.
domain courier

type cell, direction
constant north, east, south, west: direction
predicate next(cell, direction, cell)
predicate left-of(direction, direction)
predicate hole(cell)
predicate exit(cell)
predicate at(cell)
predicate lies(cell)
predicate held

action move(d: direction) cost 1 {
  rule with-empty-hands {
    the c: cell where at(c)
    the t: cell where next(c, d, t)
    when not held and not hole(c)
    outcomes {
      moved:         0.8  not at(c), at(t)
      slipped-left:  0.1
          forall s: direction, n: cell
          where left-of(s, d) and next(c, s, n) { not at(c), at(n) }
      slipped-right: 0.1
          forall s: direction, n: cell
          where left-of(d, s) and next(c, s, n) { not at(c), at(n) }
    }
  }
  rule laden {
    the c: cell where at(c)
    the t: cell where next(c, d, t)
    when held and not hole(c)
    outcomes {
      moved:         0.76  not at(c), at(t)
      slipped-left:  0.1
          forall s: direction, n: cell
          where left-of(s, d) and next(c, s, n) { not at(c), at(n) }
      slipped-right: 0.1
          forall s: direction, n: cell
          where left-of(d, s) and next(c, s, n) { not at(c), at(n) }
      dropped:       0.04  not at(c), at(t), not held, lies(c)
    }
  }
}

action pick cost 1 {
  rule pick {
    the c: cell where at(c)
    when lies(c) and not hole(c)
    outcomes {
      grasped: 0.90  not lies(c), held
      broken:  0.02  not lies(c)
      missed:  0.08  nothing
    }
  }
}
"""
    steps = {"north": (0, 1), "east": (1, 0), "south": (0, -1), "west": (-1, 0)}
    order = list(steps)
    last = size - 1
    cells = [(x, y) for x in range(size) for y in range(size)]
    next_to = [
        f"next(c{x}-{y}, {d}, c{x + i}-{y + j})"
        for x, y in cells
        for d, (i, j) in steps.items()
        if 0 <= x + i < size and 0 <= y + j < size
    ]
    turns = [f"left-of({order[i - 1]}, {d})" for i, d in enumerate(order)]
    holes = [f"hole(c{x}-{y})" for x, y in cells if _hole(x, y)]
    far = (size // 2, last)
    while _hole(*far):
        far = (far[0], far[1] - 1)
    problem = f"""\
problem floor for courier
object {", ".join(f"c{x}-{y}" for x, y in cells)}: cell
init {", ".join(next_to)}
init {", ".join(turns + holes)}
init at(c0-0), lies(c{far[0]}-{far[1]}), exit(c{last}-0)
goal exists c: cell (at(c) and exit(c)) and held
"""

    def stepped(d: str) -> str:
        i, j = steps[d]
        if i:
            return f"(x'={f'min({last},x+1)' if i > 0 else 'max(0,x-1)'})"
        return f"(y'={f'min({last},y+1)' if j > 0 else 'max(0,y-1)'})"

    room = {"north": f"y < {last}", "east": f"x < {last}", "south": "y > 0", "west": "x > 0"}
    text = [
        "mdp",
        "formula hole = mod(3 * x + 5 * y, 11) = 4;",
        f"formula done = h = 1 & x = {last} & y = 0;",
        "module cells",
        f"  x: [0..{last}] init 0;",
        f"  y: [0..{last}] init 0;",
        f"  u: [0..{last}] init {far[0]};",
        f"  v: [0..{last}] init {far[1]};",
        "  // Lies at (u, v), is held, is broken.",
        "  h: [0..2] init 0;",
    ]
    for i, d in enumerate(order):
        left, right = stepped(order[i - 1]), stepped(order[(i + 1) % 4])
        text += [
            f"  [] h != 1 & {room[d]} & !hole -> 0.8: {stepped(d)} + 0.1: {left} + 0.1: {right};",
            f"  [] h = 1 & {room[d]} & !hole & !done -> 0.76: {stepped(d)} + 0.1: {left} + "
            f"0.1: {right} + 0.04: {stepped(d)} & (h'=0) & (u'=x) & (v'=y);",
        ]
    gone = "(u'=0) & (v'=0)"
    text += [
        "  [] h = 0 & x = u & y = v & !hole -> "
        f"0.9: (h'=1) & {gone} + 0.02: (h'=2) & {gone} + 0.08: true;",
        "endmodule",
        'label "goal" = done;',
    ]
    return Model(
        "courier", size, domain, problem, _text(text), 'Pmax=? [F "goal"]', "goal-probability", 1
    )


def _hole(x: int, y: int) -> bool:
    return (3 * x + 5 * y) % 11 == 4


def _text(lines: list[str]) -> str:
    return "\n".join(lines) + "\n"


FAMILIES: dict[str, Callable[[int], Model]] = {
    "machines": machines,
    "walk": walk,
    "sheet": sheet,
    "ring": ring,
    "courier": courier,
}
