"""Domains and problems as frozen values; see `domain`, `rules`, `formulas`, `expressions`, `text`."""
