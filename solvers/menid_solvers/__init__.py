"""Solvers for menid-plan, found through the entry-point group ``menid_plan.solvers``."""
