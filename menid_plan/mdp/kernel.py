"""The compiled search for reachable states: breadth first, no call into Python for a state."""

from __future__ import annotations

from typing import Any

import numpy as np

from menid_plan.compiled import kernel

# Why the kernel came back.
DONE, BATCH, STATES_FULL, ROWS_FULL, TRANSITIONS_FULL, TABLE_FULL, CONFLICT, UNKNOWN, LIMIT = range(
    9
)

# What may happen with a slot: its outcome never happens, happens, or nobody knows.
NEVER, HAPPENS, MISSING = 0, 1, 2

SINK_STATE = -1


@kernel(inline=True)
def matches(extended: Any, begin: int, end: int, word: Any, mask: Any, value: Any) -> bool:
    """Whether an extended state is in the cube of some entries."""
    for entry in range(begin, end):  # noqa: SIM110 - Numba has no generators
        if (extended[word[entry]] & mask[entry]) != value[entry]:
            return False
    return True


@kernel()
def count_bits(extended: Any, begin: int, end: int, word: Any, mask: Any, value: Any) -> int:
    """How many of the bits that some entries look at are as they say."""
    total = 0
    for entry in range(begin, end):
        bits = ~(extended[word[entry]] ^ value[entry]) & mask[entry]
        while bits:
            bits &= bits - np.uint64(1)
            total += 1
    return total


@kernel()
def extend(
    extended: Any, words: int, word: Any, mask: Any, value: Any, op_kind: Any, op_number: Any,
    op_entries: Any, op_word: Any, op_bit: Any, segment_ops: Any, segment_loops: Any,
) -> None:  # fmt: skip
    """Compute the bits behind a state's own, segment by segment."""
    for i in range(words, len(extended)):
        extended[i] = 0
    for segment in range(len(segment_loops)):
        again = True
        while again:
            again = False
            for op in range(segment_ops[segment], segment_ops[segment + 1]):
                begin, end = op_entries[op], op_entries[op + 1]
                if op_kind[op] == 0:
                    holds = matches(extended, begin, end, word, mask, value)
                else:
                    found = count_bits(extended, begin, end, word, mask, value)
                    holds = found == op_number[op] or (op_kind[op] == 2 and found > op_number[op])
                at = op_word[op]
                before = extended[at]
                if holds:
                    extended[at] = before | op_bit[op]
                else:
                    extended[at] = before & ~op_bit[op]
                again |= extended[at] != before
            again &= segment_loops[segment] != 0


@kernel(inline=True)
def hash_words(words: Any, count: int) -> Any:
    """A well-mixed hash of some words (the finaliser of SplitMix64, Steele et al. 2014)."""
    h = np.uint64(0x9E3779B97F4A7C15)
    for i in range(count):
        h ^= words[i]
        h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        h ^= h >> np.uint64(31)
    return h


@kernel(inline=True)
def find_or_add(table: Any, states: Any, found: int, key: Any, words: int) -> int:
    """The number of a state; ``found``, and the state added under it, if it is new."""
    size = np.uint64(len(table) - 1)
    at = hash_words(key, words) & size
    while True:
        number = int(table[at])
        if number < 0:
            table[at] = found
            for i in range(words):
                states[found, i] = key[i]
            return found
        same = True
        for i in range(words):
            if states[number, i] != key[i]:
                same = False
                break
        if same:
            return number
        at = (at + np.uint64(1)) & size


@kernel("void(i4[::1], u8[:, ::1], i8)")
def rehash(table: Any, states: Any, found: int) -> None:
    """Fill an empty table with the states found so far."""
    size = np.uint64(len(table) - 1)
    words = states.shape[1]
    for number in range(found):
        at = hash_words(states[number], words) & size
        while table[at] >= 0:
            at = (at + np.uint64(1)) & size
        table[at] = number


@kernel(inline=True)
def note(counts: Any, state: int, found: int, rows: int, transitions: int) -> None:
    """Write down how far the search is."""
    counts[0] = state
    counts[1] = found
    counts[2] = rows
    counts[3] = transitions


@kernel(
    "i8(i8, i4[::1], u8[::1], u8[::1], u1[::1], i4[::1], i4[::1], i4[::1], u8[::1], i4[::1],"
    " u1[::1], i4[::1], i4[::1], i4[::1], i4[::1], u1[::1], u8[:, ::1], u8[:, ::1], i4[::1],"
    " i4[::1], i4[::1], i4[::1], u8[::1], u8[::1], i4[::1], f8[::1], i4[::1], u1[::1], b1, i8,"
    " i8[::1], i4[::1], u8[:, ::1], i8[::1], b1[::1], f8[::1], i4[::1], i8[::1], i4[::1], i4[::1],"
    " i8, i8[::1], u8[::1], u8[::1], u8[::1], u8[::1])"
)
def explore(
    # What is known of the problem (see grounding.ground.Tables).
    words: int, word: Any, mask: Any, value: Any, op_kind: Any,
    op_number: Any, op_entries: Any, op_word: Any, op_bit: Any, segment_ops: Any,
    segment_loops: Any, rule_entries: Any, rule_outcomes: Any, rule_action: Any,
    outcome_slot: Any, outcome_noise: Any, outcome_delete: Any, outcome_add: Any,
    outcome_effects: Any, effect_entries: Any,
    effect_changes: Any, change_word: Any, change_delete: Any, change_add: Any,
    reward_entries: Any, reward_value: Any, goal_entries: Any,
    slot_state: Any, noise_to_sink: bool, max_states: int,
    # What has been found, and how far: counts = [next to expand, states, rows, transitions].
    counts: Any, table: Any, states: Any, state_row: Any, goal: Any, state_reward: Any,
    row_rule: Any, row_transition: Any, next_state: Any, slot: Any, batch: int, clash: Any,
    # Room to work in: extended_words, and three times words.
    extended: Any, successor: Any, delete: Any, add: Any,
) -> int:  # fmt: skip
    """Expand states until something is full, or ``batch`` of them are done; says why it stopped.

    A state is expanded whole or not at all, so that the search goes on after an array has grown.
    """
    state, found, rows, transitions = counts[0], counts[1], counts[2], counts[3]
    last = state + batch
    rules, outcomes = len(rule_action), len(outcome_slot)
    while state < found:
        if found > max_states:
            note(counts, state, found, rows, transitions)
            return LIMIT
        if state == last:
            note(counts, state, found, rows, transitions)
            return BATCH
        first_row, first_transition = rows, transitions
        for i in range(words):
            extended[i] = states[state, i]
        extend(
            extended, words, word, mask, value, op_kind, op_number, op_entries, op_word, op_bit,
            segment_ops, segment_loops,
        )  # fmt: skip
        paid = 0.0
        for i in range(len(reward_value)):
            if matches(extended, reward_entries[i], reward_entries[i + 1], word, mask, value):
                paid += reward_value[i]
        state_reward[state] = paid
        goal[state] = goal_entries[0] >= 0 and matches(
            extended, goal_entries[0], goal_entries[1], word, mask, value
        )
        if found + outcomes > len(states):
            note(counts, state, found, first_row, first_transition)
            return STATES_FULL
        if 2 * (found + outcomes) > len(table):
            note(counts, state, found, first_row, first_transition)
            return TABLE_FULL
        if rows + rules > len(row_rule):
            note(counts, state, found, first_row, first_transition)
            return ROWS_FULL
        if transitions + outcomes > len(next_state):
            note(counts, state, found, first_row, first_transition)
            return TRANSITIONS_FULL
        previous = -1
        for rule in range(rules if not goal[state] else 0):
            if not matches(extended, rule_entries[rule], rule_entries[rule + 1], word, mask, value):
                continue
            if previous >= 0 and rule_action[rule] == rule_action[previous]:
                clash[0], clash[1], clash[2] = state, previous, rule
                note(counts, state, found, first_row, first_transition)
                return CONFLICT
            previous = rule
            for outcome in range(rule_outcomes[rule], rule_outcomes[rule + 1]):
                known = slot_state[outcome_slot[outcome]]
                if known == 0:
                    continue
                if known == 2:
                    clash[0], clash[1], clash[2] = state, rule, rule
                    note(counts, state, found, first_row, first_transition)
                    return UNKNOWN
                if outcome_noise[outcome]:
                    number = SINK_STATE if noise_to_sink else state
                else:
                    for i in range(words):
                        delete[i] = outcome_delete[outcome, i]
                        add[i] = outcome_add[outcome, i]
                    for effect in range(outcome_effects[outcome], outcome_effects[outcome + 1]):
                        if matches(
                            extended, effect_entries[effect], effect_entries[effect + 1], word,
                            mask, value,
                        ):  # fmt: skip
                            for change in range(effect_changes[effect], effect_changes[effect + 1]):
                                delete[change_word[change]] |= change_delete[change]
                                add[change_word[change]] |= change_add[change]
                    moved = False
                    for i in range(words):
                        successor[i] = (extended[i] & ~delete[i]) | add[i]
                        moved |= successor[i] != extended[i]
                    number = state
                    if moved:
                        number = find_or_add(table, states, found, successor, words)
                        if number == found:
                            found += 1
                next_state[transitions] = number
                slot[transitions] = outcome_slot[outcome]
                transitions += 1
            row_rule[rows] = rule
            rows += 1
            row_transition[rows] = transitions
        state += 1
        state_row[state] = rows
    note(counts, state, found, rows, transitions)
    return DONE


@kernel(
    "void(i8[::1], i8[::1], i4[::1], i4[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8[::1],"
    " i4[::1], f8[::1], f8[::1])"
)
def fill(
    state_row: Any, row_transition: Any, next_state: Any, slot: Any, slot_chance: Any,
    slot_reward: Any, arrival: Any, state_reward: Any, action_cost: Any, row_action: Any,
    probability: Any, row_reward: Any,
) -> None:  # fmt: skip
    """Write each transition's probability, and what each row pays on average."""
    for state in range(len(state_row) - 1):
        for row in range(state_row[state], state_row[state + 1]):
            paid = state_reward[state] - action_cost[row_action[row]]
            for entry in range(row_transition[row], row_transition[row + 1]):
                chance = slot_chance[slot[entry]]
                probability[entry] = chance
                paid += chance * (slot_reward[slot[entry]] + arrival[next_state[entry]])
            row_reward[row] = paid
