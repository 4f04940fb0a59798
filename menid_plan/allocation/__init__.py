"""Where to act next: what a test teaches, and what an execution earns and teaches, by the second."""
