"""What a bank of the hard-drive scenes says: how often each action frees the board, by environment.

    python benchmarks/outcomes.py [BANK]

BANK is a store that `menid hdd record` wrote; by default the one that comes with the project. Then, for
the places of the lever and each pair of environments: how many places differ by more than 0.2, and the
rank correlation (Spearman 1904).
"""

from __future__ import annotations

import sys
from collections import defaultdict
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from menid_plan.experience.store import Store
from menid_plan.grounding.state import SINK, State

ROOT = Path(__file__).parent.parent


def end(state: State) -> str:
    """What has become of the board."""
    names = {atom.predicate for atom in state}
    return "freed" if "on-table" in names else "loose" if "loose" in names else "seated"


def main(path: Path) -> None:
    counts: dict[tuple[str, str, str], dict[str, int]] = defaultdict(lambda: defaultdict(int))
    with Store.read(path) as store:
        for e in store:
            assert e.after is not SINK
            counts[end(e.state), str(e.action), e.environment][end(e.after)] += 1
    environments = sorted({environment for _, _, environment in counts})
    head = "".join(f"{name:>22}" for name in environments)
    freed: dict[str, list[float]] = defaultdict(list)
    for begin in ("seated", "loose"):
        print(f"{'board ' + begin + ', then freed / loose':38}{head}")
        for action in dict.fromkeys(a for b, a, _ in counts if b == begin):
            cells = [counts[begin, action, environment] for environment in environments]
            shares = [
                [cell[what] / max(sum(cell.values()), 1) for what in ("freed", "loose")]
                for cell in cells
            ]
            if begin == "seated" and action.startswith("lever"):
                for environment, share in zip(environments, shares, strict=True):
                    freed[environment].append(share[0])
            # What changes nothing anywhere needs no line.
            if any(share != [0.0, float(begin == "loose")] for share in shares):
                texts = (
                    f"{out:.2f} / {loose:.2f} of {sum(cell.values())}"
                    for (out, loose), cell in zip(shares, cells, strict=True)
                )
                print(f"{action:38}{''.join(f'{text:>22}' for text in texts)}")
    for name, values in freed.items():
        share = np.array(values)
        often, seldom = (share > 0.8).sum(), (share < 0.2).sum()
        print(
            f"lever, {name}: {often} places free the board in more than 0.8, {seldom} in less than 0.2,"
            f" {len(share) - often - seldom} between"
        )
    for one, other in combinations(environments, 2):
        a, b = np.array(freed[one]), np.array(freed[other])
        print(
            f"lever, {one} and {other}: {(abs(a - b) > 0.2).sum()} places differ by more than 0.2,"
            f" rank correlation {spearmanr(a, b).statistic:.2f}"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "domains" / "hdd" / "bank.sqlite")
