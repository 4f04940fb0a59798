"""A page about learning runs: read from their folders, drawn, and written as HTML."""
