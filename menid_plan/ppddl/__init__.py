"""PPDDL, the probabilistic language of planning competitions, read and turned into MENID."""
