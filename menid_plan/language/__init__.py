"""The MENID text: reading, checking, formatting and writing it."""
