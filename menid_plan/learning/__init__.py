"""From counts to probabilities: estimators, how sure they are, and where to act next."""
