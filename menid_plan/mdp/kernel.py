"""The compiled search for reachable states: breadth first, no call into Python for a state.

States are expanded by `expand`. Alone it numbers what it finds. Where several threads expand a stretch
each, they only read what was found before, and what is new gets its number from `settle`, in the order
in which one thread alone would have found it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from menid_plan.compiled import kernel
from menid_plan.mdp.program import LANES, extend_block

# Why expand came back.
DONE, FULL, NO_ROOM, CONFLICT, UNKNOWN = range(5)

# What may happen with a slot: its outcome never happens, happens, or nobody knows; or it is noise
# that happens, and leads nowhere or to the sink.
NEVER, HAPPENS, MISSING, STAYS, FALLS = range(5)

# Instead of a state's number: the sink, and below it what is not numbered yet.
SINK_STATE = -1
NEW = -2


@kernel(inline=True)
def matches(extended: Any, begin: int, end: int, entry: Any) -> bool:
    """Whether an extended state is in the cube of some entries."""
    for i in range(begin, end):  # noqa: SIM110 - Numba has no generators
        if (extended[entry[i, 0]] & entry[i, 1]) != entry[i, 2]:
            return False
    return True


@kernel(inline=True)
def watching(
    owner: int, extended: Any, mask: Any, group: Any, field_group: Any, first: Any, item: Any,
    always: Any, always_first: Any, field: Any, look: Any,
) -> int:  # fmt: skip
    """Write to ``look`` the conditions of an owner that are worth a look; how many there are."""
    count = 0
    for i in range(always_first[owner], always_first[owner + 1]):
        look[count] = always[i]
        count += 1
    for w in range(len(extended)):
        watched = mask[owner, w]
        bits = extended[w] & watched
        while bits:
            lowest = bits & (~bits + np.uint64(1))
            bits ^= lowest
            at = group[owner, w] + np.int64(ones(watched & (lowest - np.uint64(1))))
            for i in range(first[at], first[at + 1]):
                look[count] = item[i]
                count += 1
    for index in range(len(field)):
        if field_group[owner, index] >= 0:
            code = extended[field[index, 0]] >> field[index, 1] & field[index, 2]
            at = field_group[owner, index] + np.int64(code)
            for i in range(first[at], first[at + 1]):
                look[count] = item[i]
                count += 1
    return count


@kernel(inline=True)
def hash_words(keys: Any, row: int, count: int, salt: Any) -> Any:
    """A hash of a row's words: multilinear, so that none waits for another (Lemire and Kaser 2014).

    The finaliser is that of SplitMix64 (Steele et al. 2014).
    """
    h = np.uint64(0)
    for i in range(count):
        h += (keys[row, i] & np.uint64(0xFFFFFFFF)) * salt[2 * i]
        h += (keys[row, i] >> np.uint64(32)) * salt[2 * i + 1]
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return h ^ (h >> np.uint64(31))


@kernel(inline=True)
def place_of(table: Any, states: Any, keys: Any, row: int, words: int, salt: Any) -> Any:
    """Where in the table the number of a row's state is (plus 1; 0: free), or where it belongs.

    Without salt the table has a place for every word that a state can be.
    """
    if len(salt) == 0:
        return keys[row, 0]
    size = np.uint64(len(table) - 1)
    at = hash_words(keys, row, words, salt) & size
    while True:
        number = int(table[at])
        if number == 0:
            return at
        different = np.uint64(0)
        for i in range(words):
            different |= states[number - 1, i] ^ keys[row, i]
        if different == 0:
            return at
        at = (at + np.uint64(1)) & size


@kernel(inline=True)
def ones(bits: Any) -> Any:
    """How many bits of a word are set (Warren, Hacker's Delight, 2002)."""
    b = bits - ((bits >> np.uint64(1)) & np.uint64(0x5555555555555555))
    b = (b & np.uint64(0x3333333333333333)) + ((b >> np.uint64(2)) & np.uint64(0x3333333333333333))
    b = (b + (b >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (b * np.uint64(0x0101010101010101)) >> np.uint64(56)


@kernel("void(i4[::1], u8[:, ::1], i8, u8[::1])")
def rehash(table: Any, states: Any, found: int, salt: Any) -> None:
    """Fill an empty table with the states found so far."""
    size = np.uint64(len(table) - 1)
    words = states.shape[1]
    for number in range(found):
        at = hash_words(states, number, words, salt) & size
        while table[at] > 0:
            at = (at + np.uint64(1)) & size
        table[at] = number + 1


@kernel("i8(i4[::1], u8[:, ::1], i8, u8[::1], u8[:, ::1], i8, i4[::1])")
def settle(
    table: Any, states: Any, found: int, salt: Any, new: Any, count: int, number: Any
) -> int:
    """Number states, those that are new in order from ``found`` on; returns how many there are now.

    number[i] becomes that of new[i]. There must be room in the table and among the states.
    """
    words = states.shape[1]
    for i in range(count):
        at = place_of(table, states, new, i, words, salt)
        if table[at] == 0:
            for j in range(words):
                states[found, j] = new[i, j]
            found += 1
            table[at] = found
        number[i] = table[at] - 1
    return found


@kernel("void(i8, i4[::1], i4[::1], i4[::1])")
def put_numbers(count: int, found_state: Any, number: Any, next_state: Any) -> None:
    """Copy where transitions lead, with the numbers that settle has given."""
    for i in range(count):
        to = found_state[i]
        next_state[i] = to if to > NEW else number[NEW - to]


@kernel(
    "i8(i8, u8[:, ::1], i4[:, ::1], u8[:, ::1], i4[:, ::1], u4[:, ::1],"
    " i4[::1], u8[:, :, ::1], u4[::1], u4[:, ::1], u8[:, ::1], u8[:, ::1],"
    " u8[:, ::1], u4[:, ::1], i4[:, ::1], u4[::1], u4[::1], u4[::1], u4[::1],"
    " u8[:, ::1], u4[:, ::1], i4[:, ::1], u4[::1], u4[::1], u4[::1], u4[::1],"
    " u4[::1], f8[::1], i4[::1], u1[::1], i4[::1], u8[:, ::1], u8[::1], i8, i8, i8,"
    " i8[::1], i8[::1], b1[::1], f8[::1], i4[::1], i4[::1], i4[::1], u8[:, ::1], i8[::1],"
    " u8[::1], u8[::1], u8[::1], u8[::1], u4[::1], u8[:, ::1], i8[::1], u8[::1], u8[::1],"
    " u8[::1], u8[:, ::1])"
)
def expand(
    # What is known of the problem (see grounding.tables.Tables).
    words: int, entry: Any, ops: Any, literal: Any, segments: Any, rule: Any, rule_action: Any,
    outcome_change: Any, outcome_effects: Any, effect: Any, change: Any, field: Any,
    rule_mask: Any, rule_group: Any, rule_field: Any, rule_first: Any, rule_item: Any,
    rule_always: Any, rule_always_first: Any,
    effect_mask: Any, effect_group: Any, effect_field: Any, effect_first: Any, effect_item: Any,
    effect_always: Any, effect_always_first: Any,
    reward_entries: Any, reward_value: Any, goal_entries: Any, follow: Any,
    # What was found before, and which states to expand; alone, until so many are waiting (else 0).
    table: Any, states: Any, salt: Any, first: int, last: int, alone: int,
    # What is found: counts = [next state to expand, rows, transitions, new states, all states].
    counts: Any, state_row: Any, goal: Any, state_reward: Any,
    row_rule: Any, row_transition: Any, next_state: Any, new: Any, clash: Any,
    # Room to work in: the extended words, a bit for each rule, twice words, conditions to look at, the
    # successors of a state and which transitions lead there; and for the program all extended bits,
    # 64 words, the planes of a count, the extended words of 64 states.
    extended: Any, due: Any, delete: Any, add: Any, look: Any, successors: Any, leads: Any,
    sliced: Any, column: Any, planes: Any, block: Any,
) -> int:  # fmt: skip
    """Expand the states from counts[0] to last, as far as there are and have room; says why it stopped.

    A state is expanded whole or not at all. Offsets in state_row and row_transition count from the
    first state of the stretch. Where a transition leads to what is not among the states, it gets
    NEW - i, for the i-th of ``new``.
    """
    state, rows, transitions, fresh = counts[0], counts[1], counts[2], counts[3]
    found = counts[4]
    rules, outcomes = len(rule_action), len(outcome_change)
    end = DONE
    block_first = block_end = state
    while state < last and state < found:
        if alone > 0:
            if found - state >= alone:
                break
            if found + outcomes > len(states) or (
                len(salt) > 0 and 2 * (found + outcomes) > len(table)
            ):
                end = NO_ROOM
                break
        if (
            rows + rules > len(row_rule)
            or transitions + outcomes > len(next_state)
            or fresh + outcomes > len(new)
        ):
            end = FULL
            break
        if len(ops) == 1:
            for i in range(words):
                extended[i] = states[state, i]
        else:
            if state >= block_end:
                block_end = min(state + LANES, last, found)
                block_first = state
                extend_block(
                    states, state, block_end - state, words, ops, literal, segments, sliced, column,
                    planes, block,
                )  # fmt: skip
            for i in range(len(extended)):
                extended[i] = block[state - block_first, i]
        paid = 0.0
        for i in range(len(reward_value)):
            if matches(extended, reward_entries[i], reward_entries[i + 1], entry):
                paid += reward_value[i]
        at_goal = goal_entries[0] >= 0 and matches(
            extended, goal_entries[0], goal_entries[1], entry
        )
        state_reward[state - first] = paid
        goal[state - first] = at_goal
        looks = 0
        if not at_goal:
            looks = watching(
                0, extended, rule_mask, rule_group, rule_field, rule_first, rule_item, rule_always,
                rule_always_first, field, look,
            )  # fmt: skip
        for i in range(len(due)):
            due[i] = 0
        for i in range(looks):
            bit = np.uint64(look[i])
            due[bit >> np.uint64(6)] |= np.uint64(1) << (bit & np.uint64(63))
        previous = -1
        waiting = 0
        for w_due in range(len(due)):
            while due[w_due]:
                next_due = due[w_due] & (~due[w_due] + np.uint64(1))
                due[w_due] ^= next_due
                r = 64 * w_due + int(ones(next_due - np.uint64(1)))
                if not matches(extended, rule[r, 0], rule[r + 1, 0], entry):
                    continue
                if previous >= 0 and rule_action[r] == rule_action[previous]:
                    clash[0], clash[1], clash[2] = state, previous, r
                    return CONFLICT
                previous = r
                first_slot = np.int64(rule[r, 2]) - np.int64(rule[r, 1])
                for o in range(rule[r, 1], rule[r + 1, 1]):
                    known = follow[first_slot + o]
                    if known == NEVER:
                        continue
                    if known == MISSING:
                        clash[0], clash[1], clash[2] = state, r, r
                        return UNKNOWN
                    number = state
                    if known == FALLS:
                        number = SINK_STATE
                    elif known == HAPPENS:
                        moved = False
                        if outcome_effects[o] == outcome_effects[o + 1]:
                            for i in range(words):
                                to = extended[i] & ~outcome_change[o, 0, i]
                                to |= outcome_change[o, 1, i]
                                successors[waiting, i] = to
                                moved |= to != extended[i]
                        else:
                            for i in range(words):
                                delete[i] = outcome_change[o, 0, i]
                                add[i] = outcome_change[o, 1, i]
                            looks = watching(
                                o, extended, effect_mask, effect_group, effect_field, effect_first,
                                effect_item, effect_always, effect_always_first, field, look,
                            )  # fmt: skip
                            for i in range(looks):
                                e = look[i]
                                if matches(extended, effect[e, 0], effect[e + 1, 0], entry):
                                    for c in range(effect[e, 1], effect[e + 1, 1]):
                                        delete[change[c, 0]] |= change[c, 1]
                                        add[change[c, 0]] |= change[c, 2]
                            for i in range(words):
                                to = (extended[i] & ~delete[i]) | add[i]
                                successors[waiting, i] = to
                                moved |= to != extended[i]
                        if moved:
                            leads[waiting] = transitions
                            waiting += 1
                    next_state[transitions] = number
                    transitions += 1
                row_rule[rows] = r
                rows += 1
                row_transition[rows] = transitions
        # All at once: looking one up need not wait for the memory that the one before waits for.
        for i in range(waiting):
            place = place_of(table, states, successors, i, words, salt)
            number = int(table[place]) - 1
            if number < 0 and alone > 0:
                number = found
                for w in range(words):
                    states[found, w] = successors[i, w]
                found += 1
                table[place] = found
            elif number < 0:
                number = NEW - fresh
                for w in range(words):
                    new[fresh, w] = successors[i, w]
                fresh += 1
            next_state[leads[i]] = number
        state += 1
        state_row[state - first] = rows
    counts[0], counts[1], counts[2], counts[3] = state, rows, transitions, fresh
    counts[4] = found
    return end


@kernel(
    "void(i8[::1], i4[::1], i4[::1], i4[::1], i8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8[::1],"
    " f8[::1])"
)
def pay(
    state_row: Any, row_transition: Any, next_state: Any, row_kind: Any, kind_first: Any,
    kind_probability: Any, kind_reward: Any, kind_cost: Any, arrival: Any, state_reward: Any,
    row_reward: Any,
) -> None:  # fmt: skip
    """Write what each row pays on average.

    A mean that is nothing but what rounding leaves of terms that cancel is 0.
    """
    for state in range(len(state_row) - 1):
        for row in range(state_row[state], state_row[state + 1]):
            cost = kind_cost[row_kind[row]]
            paid = state_reward[state] - cost
            size = abs(state_reward[state]) + abs(cost)
            begin, end = np.uint64(row_transition[row]), np.uint64(row_transition[row + 1])
            of_kind = np.uint64(kind_first[row_kind[row]]) - begin
            for entry in range(begin, end):
                chance = kind_probability[of_kind + entry]
                on_outcome = kind_reward[of_kind + entry]
                on_arrival = arrival[next_state[entry]]
                paid += chance * (on_outcome + on_arrival)
                size += chance * (abs(on_outcome) + abs(on_arrival))
            row_reward[row] = paid if abs(paid) > 4e-16 * size else 0.0
