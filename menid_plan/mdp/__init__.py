"""Markov decision processes as sparse arrays: their form, exploration, and checks."""
