"""The net as a part of somebody else's simulation: ports that a host moves, and what they do to it."""
