"""Studies of the paper and of this project: from settings to a table and a figure."""
