"""Numbers for readers that keep them as fractions of 32-bit integers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction

# More digits would overflow such fractions, which nobody would be told.
DIGITS = 6
# Fractions that a column of probabilities may be written in.
MOST_PARTS = 10_000
# From here on a whole number overflows.
TOO_LARGE = 2**31
# What is rounded by a larger share than this is told.
NEAR = 1e-3


@dataclass(slots=True)
class Numbers:
    """Writes numbers; ``rounded`` has for those that became something else what they became."""

    rounded: dict[str, str] = field(default_factory=dict)

    def text(self, value: float) -> str:
        """A number that is not negative, in decimals."""
        digits = DIGITS if value < 100 else max(DIGITS - 1 - int(math.log10(value)), 0)
        text = f"{value:.{digits}f}"
        text = text.rstrip("0").rstrip(".") if "." in text else text
        self._note(value, text)
        return text

    def shares(self, chances: Sequence[float], *, whole: bool) -> list[str]:
        """Probabilities as texts whose sum is at most 1, and exactly 1 with ``whole``.

        None becomes 0. As fractions where decimals won't do and all have a small common denominator.
        """
        unit = 10**DIGITS
        counts = [max(round(chance * unit), int(chance > 0)) for chance in chances]
        if any(abs(n / unit - chance) > 1e-12 for n, chance in zip(counts, chances, strict=True)):
            fractions = [Fraction(chance).limit_denominator(1000) for chance in chances]
            parts = math.lcm(*(fraction.denominator for fraction in fractions))
            exact = all(abs(f - c) < 1e-12 for f, c in zip(fractions, chances, strict=True))
            if exact and parts <= MOST_PARTS and sum(fractions) <= 1:
                return [str(fraction) for fraction in fractions]
        largest = counts.index(max(counts))
        excess = sum(counts) - unit
        if excess > 0 or whole:
            counts[largest] -= excess
        texts = [self.text(n / unit) for n in counts]
        for chance, text in zip(chances, texts, strict=True):
            self._note(chance, text)
        return texts

    def _note(self, value: float, text: str) -> None:
        if abs(float(text) - value) > NEAR * value:
            self.rounded[f"{value:g}"] = text
        elif value >= TOO_LARGE:
            self.rounded[text] = "what 32 bits make of it"
