"""Kernels over the graph of an MDP: components, end components, and sure reachability.

All read the arrays of `menid_plan.mdp.model.MDP` and a mask of the rows that count; entries of
probability 0 are no edges.
"""

from __future__ import annotations

import numpy as np

from menid_plan.compiled import kernel
from menid_plan.mdp.model import Bools, Floats, Ints, SmallInts

SOON = 4096  # states

_GRAPH = "i8[::1], i4[::1], i4[::1], i4[::1], i8[::1], f8[::1], b1[::1]"


@kernel(f"i8({_GRAPH}, b1, i4[::1], i4[:, ::1], i8[:, ::1])")
def strong_components(
    state_row: Ints,
    row_transition: SmallInts,
    next_state: SmallInts,
    row_kind: SmallInts,
    kind_first: Ints,
    kind_probability: Floats,
    row_counts: Bools,
    every: bool,
    component: SmallInts,
    room: SmallInts,
    places: Ints,
) -> int:
    """Number the strongly connected components so that edges never lead to a higher number.

    Writes component (int32[n]) and returns how many there are. Tarjan 1972, without recursion;
    ``every``: all rows count, and nothing has probability 0, so that rows need not be told apart.
    ``room`` (int32[3, n]) and ``places`` (int64[2, n]) are to work in.
    """
    n = len(state_row) - 1
    low, path, stack = room[0], room[1], room[2]
    row_at, entry_at = places[0], places[1]  # where the visit of a state goes on
    # The order of discovery of the earliest state on the stack that is known to be reached; 0 for
    # unseen states. A state whose component is known has the highest of all, which lowers nothing.
    low[:] = 0
    done = n + 1
    seen = 0
    found = 0
    height = 0
    for root in range(n):
        if low[root] != 0:
            continue
        depth = 0
        path[0] = root
        s = root
        seen += 1
        index = seen
        low_s = seen
        low[s] = seen
        stack[0] = s
        height = 1
        r = state_row[s]
        e = np.int64(row_transition[r])
        if every:  # all the entries of the state as if of its last row
            r = max(r, state_row[s + 1] - 1)
        while depth >= 0:
            last = state_row[s + 1]
            child = -1
            while r < last:
                end = np.int64(row_transition[r + 1])
                if row_counts[r]:
                    of_kind = kind_first[row_kind[r]] - row_transition[r] - 1  # e is one further
                    while e < end:
                        t = next_state[e]
                        e += 1
                        low_t = low[t]
                        if low_t == 0:
                            if every or kind_probability[of_kind + e] > 0.0:
                                child = t
                                break
                        elif low_t < low_s and (every or kind_probability[of_kind + e] > 0.0):
                            low_s = low_t
                    if child >= 0:
                        break
                r += 1
                e = end
            if child >= 0:
                row_at[s] = r
                entry_at[s] = e
                low[s] = low_s
                component[s] = index
                depth += 1
                path[depth] = child
                s = child
                seen += 1
                index = seen
                low_s = seen
                low[s] = seen
                stack[height] = s
                height += 1
                r = state_row[s]
                e = np.int64(row_transition[r])
                if every:  # all the entries of the state as if of its last row
                    r = max(r, state_row[s + 1] - 1)
                continue
            low[s] = low_s
            if low_s == index:
                while True:
                    height -= 1
                    t = stack[height]
                    component[t] = found
                    low[t] = done
                    if t == s:
                        break
                found += 1
            depth -= 1
            if depth >= 0:
                below = low_s
                s = path[depth]
                low_s = min(low[s], below) if low[path[depth + 1]] != done else low[s]
                index = component[s]  # kept there until the component is known
                r = row_at[s]
                e = entry_at[s]
    return found


@kernel(f"void({_GRAPH}, i8[::1], i4[::1])")
def predecessors(
    state_row: Ints,
    row_transition: SmallInts,
    next_state: SmallInts,
    row_kind: SmallInts,
    kind_first: Ints,
    kind_probability: Floats,
    row_counts: Bools,
    first: Ints,
    row: SmallInts,
) -> None:
    """Which rows lead to a state: row[first[s] : first[s + 1]], a row once for each entry.

    Writes first (int64[n + 1]) and row (int32[t]).
    """
    n = len(state_row) - 1
    first[:] = 0
    for s in range(n):
        for r in range(state_row[s], state_row[s + 1]):
            if row_counts[r]:
                begin, end = np.uint64(row_transition[r]), np.uint64(row_transition[r + 1])
                of_kind = np.uint64(kind_first[row_kind[r]]) - begin
                for e in range(begin, end):
                    if kind_probability[of_kind + e] > 0.0:
                        first[next_state[e] + 1] += 1
    for s in range(n):
        first[s + 1] += first[s]
    for s in range(n):
        for r in range(state_row[s], state_row[s + 1]):
            if row_counts[r]:
                begin, end = np.uint64(row_transition[r]), np.uint64(row_transition[r + 1])
                of_kind = np.uint64(kind_first[row_kind[r]]) - begin
                for e in range(begin, end):
                    if kind_probability[of_kind + e] > 0.0:
                        t = next_state[e]
                        row[first[t]] = r
                        first[t] += 1
    for s in range(n, 0, -1):
        first[s] = first[s - 1]
    first[0] = 0


@kernel("void(i8[::1], i8[::1], i4[::1], i4[::1], b1[::1], b1[::1], i8[::1], i4[::1])")
def attract_rows(
    state_row: Ints,
    first: Ints,
    row: SmallInts,
    row_state: SmallInts,
    row_counts: Bools,
    gone: Bools,
    left: Ints,
    queue: SmallInts,
) -> None:
    """Take out every row that may lead to a gone state, and every state left without a row.

    Changes row_counts and gone in place; a state that had no rows at all stays unless it is gone.
    """
    n = len(state_row) - 1
    left[:] = 0  # room of n, as queue
    for s in range(n):
        for r in range(state_row[s], state_row[s + 1]):
            if row_counts[r]:
                left[s] += 1
    tail = 0
    for s in range(n):
        if gone[s]:
            queue[tail] = s
            tail += 1
    head = 0
    while head < tail:
        t = queue[head]
        head += 1
        for k in range(first[t], first[t + 1]):
            r = row[k]
            if row_counts[r]:
                row_counts[r] = False
                s = row_state[r]
                left[s] -= 1
                if left[s] == 0 and not gone[s]:
                    gone[s] = True
                    queue[tail] = s
                    tail += 1


@kernel("void(i8[::1], i4[::1], i4[::1], b1[::1], b1[::1], i4[::1])")
def reach(
    first: Ints,
    row: SmallInts,
    row_state: SmallInts,
    row_counts: Bools,
    found: Bools,
    queue: SmallInts,
) -> None:
    """Add to found every state from which a found one can be reached by rows that count."""
    n = len(found)
    tail = 0
    for s in range(n):
        if found[s]:
            queue[tail] = s
            tail += 1
    head = 0
    while head < tail:
        t = queue[head]
        head += 1
        for k in range(first[t], first[t + 1]):
            r = row[k]
            s = row_state[r]
            if row_counts[r] and not found[s]:
                found[s] = True
                queue[tail] = s
                tail += 1


@kernel(f"i8({_GRAPH}, i4[::1], b1[::1])")
def rows_that_leave(
    state_row: Ints,
    row_transition: SmallInts,
    next_state: SmallInts,
    row_kind: SmallInts,
    kind_first: Ints,
    kind_probability: Floats,
    row_counts: Bools,
    component: SmallInts,
    gone: Bools,
) -> int:
    """Take out the rows that may leave their component; gone: the states then without a row.

    Returns how many rows were taken out.
    """
    taken = 0
    for s in range(len(state_row) - 1):
        left = 0
        for r in range(state_row[s], state_row[s + 1]):
            if not row_counts[r]:
                continue
            begin, end = np.uint64(row_transition[r]), np.uint64(row_transition[r + 1])
            of_kind = np.uint64(kind_first[row_kind[r]]) - begin
            for e in range(begin, end):
                if kind_probability[of_kind + e] > 0.0 and component[next_state[e]] != component[s]:
                    row_counts[r] = False
                    taken += 1
                    break
            if row_counts[r]:
                left += 1
        gone[s] = left == 0
    return taken


@kernel("void(i8[::1], b1[::1], i4[::1])")
def lowest_rows(state_row: Ints, row_counts: Bools, policy: SmallInts) -> None:
    """policy[s] = the lowest row that counts, -1 if there is none."""
    for s in range(len(state_row) - 1):
        policy[s] = -1
        for r in range(state_row[s], state_row[s + 1]):
            if row_counts[r]:
                policy[s] = r
                break


@kernel(f"b1({_GRAPH}, i8, b1[::1])")
def sweep_reach(
    state_row: Ints,
    row_transition: SmallInts,
    next_state: SmallInts,
    row_kind: SmallInts,
    kind_first: Ints,
    kind_probability: Floats,
    row_counts: Bools,
    sweeps: int,
    found: Bools,
) -> bool:
    """Add to found the states from which a found one can be reached, by sweeps; True if done."""
    n = len(state_row) - 1
    for sweep in range(sweeps):
        changed = False
        for k in range(n):
            s = n - 1 - k if sweep % 2 == 0 else k
            if found[s]:
                continue
            for r in range(state_row[s], state_row[s + 1]):
                if row_counts[r]:
                    begin, end = np.uint64(row_transition[r]), np.uint64(row_transition[r + 1])
                    of_kind = np.uint64(kind_first[row_kind[r]]) - begin
                    for e in range(begin, end):
                        if found[next_state[e]] and kind_probability[of_kind + e] > 0.0:
                            found[s] = True
                            break
                if found[s]:
                    changed = True
                    break
        if not changed:
            return True
    return False


@kernel(f"b1({_GRAPH}, i8, b1[::1])")
def sweep_attract(
    state_row: Ints,
    row_transition: SmallInts,
    next_state: SmallInts,
    row_kind: SmallInts,
    kind_first: Ints,
    kind_probability: Floats,
    row_counts: Bools,
    sweeps: int,
    gone: Bools,
) -> bool:
    """What attract_rows does, by sweeps; True if done, else what is taken out is right so far."""
    n = len(state_row) - 1
    for sweep in range(sweeps):
        changed = False
        for k in range(n):
            s = n - 1 - k if sweep % 2 == 0 else k
            had = False
            left = False
            for r in range(state_row[s], state_row[s + 1]):
                if not row_counts[r]:
                    continue
                had = True
                begin, end = np.uint64(row_transition[r]), np.uint64(row_transition[r + 1])
                of_kind = np.uint64(kind_first[row_kind[r]]) - begin
                for e in range(begin, end):
                    if gone[next_state[e]] and kind_probability[of_kind + e] > 0.0:
                        row_counts[r] = False
                        break
                if row_counts[r]:
                    left = True
            if had and not left and not gone[s]:
                gone[s] = True
                changed = True
        if not changed:
            return True
    return False


@kernel(f"i8({_GRAPH}, i8, i4[::1], i4[:, ::1])")
def one_component(
    state_row: Ints,
    row_transition: SmallInts,
    next_state: SmallInts,
    row_kind: SmallInts,
    kind_first: Ints,
    kind_probability: Floats,
    row_counts: Bools,
    sweeps: int,
    component: SmallInts,
    room: SmallInts,
) -> int:
    """Number the components as strong_components does, if all states with rows are in one.

    0 if they are not, or if some sweeps do not show it.
    """
    n = len(state_row) - 1
    onward, back = room[0], room[1]  # is reached from the first state with rows, and reaches it
    first = -1
    for s in range(n):
        onward[s] = 0
        back[s] = 0
        component[s] = 0
        for r in range(state_row[s], state_row[s + 1]):
            if row_counts[r]:
                component[s] = 1
                break
        if component[s] == 1 and first < 0:
            first = s
    if first < 0:
        for s in range(n):
            component[s] = s
        return n
    back[first] = 1
    # Where nothing found soon after the first state leads back to it, probably nothing does.
    returns = n <= SOON
    for s in range(min(n, SOON)):
        if returns:
            break
        for r in range(state_row[s], state_row[s + 1]):
            if row_counts[r]:
                for e in range(np.uint64(row_transition[r]), np.uint64(row_transition[r + 1])):
                    if next_state[e] == first and s != first:
                        returns = True
    if not returns:
        return 0
    missing = True
    for sweep in range(sweeps):
        if not missing:
            break
        missing = False
        changed = False
        for k in range(n):
            s = n - 1 - k if sweep % 2 == 0 else k
            if component[s] == 0 or back[s] == 1:
                continue
            for r in range(state_row[s], state_row[s + 1]):
                if row_counts[r] and back[s] == 0:
                    begin, end = np.uint64(row_transition[r]), np.uint64(row_transition[r + 1])
                    of_kind = np.uint64(kind_first[row_kind[r]]) - begin
                    for e in range(begin, end):
                        if back[next_state[e]] == 1 and kind_probability[of_kind + e] > 0.0:
                            back[s] = 1
                            break
            if back[s] == 0:
                missing = True
            else:
                changed = True
        if missing and not changed:
            return 0
    if missing:
        return 0
    onward[first] = 1
    missing = True
    for _ in range(2):
        if not missing:
            break
        for s in range(n):
            if component[s] == 1 and onward[s] == 1:
                for r in range(state_row[s], state_row[s + 1]):
                    if row_counts[r]:
                        begin, end = np.uint64(row_transition[r]), np.uint64(row_transition[r + 1])
                        of_kind = np.uint64(kind_first[row_kind[r]]) - begin
                        for e in range(begin, end):
                            if kind_probability[of_kind + e] > 0.0:
                                onward[next_state[e]] = 1
        missing = False
        for s in range(n):
            missing |= component[s] == 1 and onward[s] == 0
    if missing:
        return 0
    number = 0
    for s in range(n):  # states without rows are components of their own, and come first
        if component[s] == 0:
            component[s] = number
            number += 1
        else:
            component[s] = -1
    for s in range(n):
        if component[s] < 0:
            component[s] = number
    return number + 1


@kernel(
    "void(i8[::1], i4[::1], i4[::1], i4[::1], i8[::1], f8[::1], i8[::1], i4[::1], i4[::1], b1[::1],"
    " b1[::1], i4[::1], i4[::1], i4[::1])"
)
def steer(
    state_row: Ints,
    row_transition: SmallInts,
    next_state: SmallInts,
    row_kind: SmallInts,
    kind_first: Ints,
    kind_probability: Floats,
    first: Ints,
    row: SmallInts,
    row_state: SmallInts,
    row_counts: Bools,
    target: Bools,
    policy: SmallInts,
    distance: SmallInts,
    queue: SmallInts,
) -> None:
    """Set the policy so that the targets come nearer: the lowest row with a nearer next state.

    Only states from which the rows that count lead to a target are changed, and no target is.
    """
    n = len(target)
    distance[:] = n  # room of n, as queue
    tail = 0
    for s in range(n):
        if target[s]:
            distance[s] = 0
            queue[tail] = s
            tail += 1
    head = 0
    while head < tail:
        t = queue[head]
        head += 1
        for k in range(first[t], first[t + 1]):
            r = row[k]
            s = row_state[r]
            if row_counts[r] and distance[s] == n:
                distance[s] = distance[t] + 1
                queue[tail] = s
                tail += 1
    for s in range(n):
        if distance[s] == n or distance[s] == 0:
            continue
        chosen = -1
        for r in range(state_row[s], state_row[s + 1]):
            if chosen >= 0 or not row_counts[r]:
                continue
            begin, end = np.uint64(row_transition[r]), np.uint64(row_transition[r + 1])
            of_kind = np.uint64(kind_first[row_kind[r]]) - begin
            for e in range(begin, end):
                if kind_probability[of_kind + e] > 0.0 and distance[next_state[e]] < distance[s]:
                    chosen = r
                    break
        policy[s] = chosen
