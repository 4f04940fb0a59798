"""What was seen: experiences, the rules that explain them, and the file that keeps them."""
