"""Servers that let planners of others act in an environment."""
