"""Planners of others: which there are, and how they are run."""
