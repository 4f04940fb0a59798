"""Start-up: `menid check` of the hard-drive domain against importing Lark, whole processes.

    python benchmarks/startup.py [RUNS]

The runs alternate, so that the machine's mood hits both; the ratio of the medians is what counts.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parent.parent
MENID = Path(sys.executable).with_name("menid")


def seconds(command: list[str]) -> float:
    start = time.perf_counter()
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return time.perf_counter() - start


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 15
    check = [str(MENID), "check", "domains/hdd/domain.menid"]
    lark = [sys.executable, "-c", "import lark"]
    for command in (check, lark):  # warms the parser's cache and the file system's
        seconds(command)
    pairs = [(seconds(check), seconds(lark)) for _ in range(runs)]
    ours, theirs = (statistics.median(column) for column in zip(*pairs, strict=True))
    print(f"menid check domains/hdd/domain.menid: {ours * 1000:.0f} ms (median of {runs})")
    print(f'python -c "import lark":              {theirs * 1000:.0f} ms')
    print(f"ratio: {ours / theirs:.2f}")


if __name__ == "__main__":
    main()
