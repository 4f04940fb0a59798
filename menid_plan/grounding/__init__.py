"""From a lifted domain and a problem to what holds and happens in a state."""
