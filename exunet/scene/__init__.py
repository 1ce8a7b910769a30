"""Text to a checked case, every fault with file and line."""
