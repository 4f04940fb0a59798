"""The command `menid`: one file per command, thin."""
